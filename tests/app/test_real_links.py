"""Whole flights over real links on virtual time: every byte goes through a pty, a TCP connection or a UDP socket.

The far end of each link is a wire with a capacity: what does not fit waits, and is left out when too much waits, as on
a radio. Nothing here sleeps; each tick waits until the bytes that were put in have come out.
"""

from __future__ import annotations

import os
import pty
import select
import socket
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from groundstation.app.emulator import TruthMeter, world_config
from groundstation.app.session import Session
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from groundstation.links.link import Link
from groundstation.links.opening import open_link
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.schema import FormStep
from groundstation.mission.runner import Phase, Runner
from groundstation.records.manifest import Manifest, manifest_path, write_manifest
from groundstation.records.tlog import TlogWriter
from sitl.world import World
from tests.app.flights import SECOND_NS, mission, pair
from tests.sitl.served import free_udp_port

LIMIT_S = 5.0
WAITS_MAX = 4096


@dataclass
class Wire:
    """The far end of a link, with the vehicles behind it.

    Attributes:
        url: for the mission.
        read, write: bytes at the far end.
        descriptor: to wait on.
        bytes_per_s: capacity each way.
        replug: puts a serial far end in again after ``unplug``.
        plugged: whether it is in.
    """

    url: str
    read: Callable[[int], bytes]
    write: Callable[[bytes], int]
    descriptor: int
    bytes_per_s: float = float("inf")
    whole: list[bytes] = field(default_factory=list)
    down: bytearray = field(default_factory=bytearray)
    up: bytearray = field(default_factory=bytearray)
    carried_up: int = 0
    carried_down: int = 0
    left_out: int = 0
    replug: Callable[[], None] = lambda: None
    unplug: Callable[[], None] = lambda: None
    plugged: bool = True
    _credit: float = 0.0

    def put(self, data: bytes) -> None:
        """A vehicle sends."""
        if not self.plugged:
            return
        if self.bytes_per_s == float("inf"):
            self.whole.append(data)
        elif len(self.down) + len(data) > WAITS_MAX:
            self.left_out += 1
        else:
            self.down += data

    def carry_down(self, period_ns: int) -> int:
        """Lets a tick's worth of bytes through, at the link's pace and cut where it happens to be."""
        if self.bytes_per_s == float("inf"):
            total = sum(self.write(data) for data in self.whole)
            assert total == sum(map(len, self.whole))
            self.whole.clear()
            return total
        self._credit = self.bytes_per_s * period_ns / SECOND_NS + self._credit % 1.0
        count = min(int(self._credit), len(self.down))
        piece = bytes(self.down[:count])
        del self.down[:count]
        sent = 0
        while sent < len(piece):
            sent += self.write(piece[sent:])
        self.carried_down += count
        return count

    def take(self, count: int) -> bytes:
        """Waits for what the ground station has sent."""
        data = b""
        while len(data) < count:
            ready, _, _ = select.select([self.descriptor], [], [], LIMIT_S)
            assert ready, f"{self.url}: {len(data)} of {count} bytes came through"
            data += self.read(65536)
        self.carried_up += len(data)
        return data


class Cable:
    """Opens far ends."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self._stack, self._folder = stack, folder
        self._ports = 0

    def serial(self, baud: int) -> Wire:
        """A pty whose near end bears the name of a port; it may be unplugged and come back."""
        self._ports += 1
        name = self._folder / f"tty{self._ports}"
        ends: list[int] = []

        def plug() -> None:
            far, near = pty.openpty()
            tty.setraw(near)
            ends[:] = [far, near]
            name.symlink_to(os.ttyname(near))
            wire.descriptor, wire.plugged = far, True

        def unplug() -> None:
            name.unlink()
            wire.plugged = False
            wire.down.clear()
            while ends:
                os.close(ends.pop())

        wire = Wire(
            f"serial://{name}:{baud}",
            lambda n: os.read(ends[0], n),
            lambda data: os.write(ends[0], data),
            -1,
            baud / 10,
            replug=plug,
            unplug=unplug,
        )
        plug()
        self._stack.callback(lambda: unplug() if wire.plugged else None)
        return wire

    def tcp(self) -> tuple[str, Callable[[Link], Wire]]:
        """A vehicle that listens; the wire exists once the link has connected."""
        listener = self._stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        listener.settimeout(LIMIT_S)
        url = f"tcpout://127.0.0.1:{listener.getsockname()[1]}"

        def connect(link: Link) -> Wire:
            link.service(0)
            connection = self._stack.enter_context(listener.accept()[0])
            link.service(0)
            return Wire(url, connection.recv, connection.send, connection.fileno())

        return url, connect

    def udp(self) -> Wire:
        """A vehicle that sends to a port of ours."""
        port = free_udp_port()
        vehicle = self._stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        vehicle.bind(("127.0.0.1", 0))
        vehicle.connect(("127.0.0.1", port))
        return Wire(f"udpin://127.0.0.1:{port}", vehicle.recv, vehicle.send, vehicle.fileno())


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    with ExitStack() as stack:
        yield Cable(stack, tmp_path)


def _fly(
    plan: MissionPlan,
    wires: dict[str, Wire | Callable[[Link], Wire]],
    log: Path,
    *,
    streams: str | None = None,
    happens: Callable[[Runner, int], None] | None = None,
    limit_s: int = 200,
) -> tuple[Runner, World, TruthMeter]:
    """Flies a mission over links; ``wires`` by address, ``streams`` what the vehicles send unasked.

    ``happens`` is called before every tick; a link that it has unplugged carries nothing until it is open again.
    """
    config = world_config(plan, 1)
    if streams is not None:
        config = replace(config, vehicles=tuple(replace(vehicle, streams=streams) for vehicle in config.vehicles))
    world = World(config, 1)
    meter, runner = TruthMeter(world), Runner(plan, 0)
    period_ns = round(SECOND_NS / plan.spec.rate_hz)
    with ExitStack() as stack:
        links = [stack.enter_context(closing(open_link(url))) for url in plan.links]
        ends = [
            wire if isinstance(wire := wires[url], Wire) else wire(link)
            for url, link in zip(plan.links, links, strict=True)
        ]
        writer = stack.enter_context(TlogWriter(log, 0))
        session = Session(runner, writer)
        now_ns = 0
        while not runner.done:
            now_ns += period_ns
            assert now_ns < limit_s * SECOND_NS, (runner.phase, runner.problems)
            if happens is not None:
                happens(runner, now_ns)
            for sent in world.advance(now_ns):
                ends[plan.link_of_vehicle[sent.vehicle_index]].put(sent.data)
            for number, (link, end) in enumerate(zip(links, ends, strict=True)):
                link.service(now_ns)
                if end.plugged and link.sources():
                    _deliver(session, number, link, end.carry_down(period_ns), now_ns)
            lengths = [0] * len(links)
            for datagram in session.tick(now_ns):
                data = b"".join(datagram.frames)
                lengths[datagram.link] += len(data)
                links[datagram.link].send(datagram.peer, data)
            for number, end in enumerate(ends):
                if lengths[number] and links[number].sources():
                    end.up += end.take(lengths[number])
            for vehicle, link_number in enumerate(plan.link_of_vehicle):
                if ends[link_number].up:
                    world.receive(vehicle, bytes(ends[link_number].up), now_ns)
            for end in ends:
                end.up.clear()
            meter(session, now_ns)
        assert happens is not None or [link.errors for link in links] == [0] * len(links)
    manifest = Manifest(
        mission=plan.record(), epoch_unix_us=0, versions={}, seed=1, dry_run=True, gains_npz=plan.gains_npz
    )
    write_manifest(manifest_path(log), manifest.finished({"outcome": runner.outcome}))
    return runner, world, meter


def _deliver(session: Session, number: int, link: Link, count: int, now_ns: int) -> None:
    """Waits until the bytes that were put in have come out."""
    while count > 0:
        ready, _, _ = select.select(list(link.sources()), [], [], LIMIT_S)
        assert ready, f"{link.url}: {count} bytes are missing"
        for peer, data in link.receive():
            count -= len(data)
            session.deliver(number, peer, data, now_ns)


def _links(*urls: str) -> list[str]:
    return [f"vehicles.{number}.link={url}" for number, url in enumerate(urls)]


def _assert_flown(plan: MissionPlan, flown: tuple[Runner, World, TruthMeter], log: Path) -> None:
    runner, world, meter = flown
    assert (runner.outcome, runner.reason) == ("completed", "")
    assert world.min_distance_airborne_m >= plan.spec.avoidance.radius_m
    step = plan.spec.steps[0]
    assert isinstance(step, FormStep)
    assert meter.formation_error_m <= step.tolerance_m + plan.margin_m
    assert not world.truth.armed.any()
    result = verify_log(log)
    assert (result.mismatches, result.setpoints > 1000) == (0, True)


def test_a_team_on_a_radio_each_at_57600_baud_is_flown_within_the_budget(cable: Cable, tmp_path: Path) -> None:
    one, two = cable.serial(57_600), cable.serial(57_600)
    plan = pair("rate_hz=50", *_links(one.url, two.url), autopilots=("px4", "arducopter"))
    assert all(0.7 * 5760 < rates.down_bytes_s < 5760 and rates.up_bytes_s < 5760 for rates in plan.rates)
    flown = _fly(plan, {one.url: one, two.url: two}, tmp_path / "flight.tlog")
    _assert_flown(plan, flown, tmp_path / "flight.tlog")
    seconds = flown[0].figures.ticks / plan.spec.rate_hz
    for wire in (one, two):
        assert wire.carried_up / seconds < 5760
        assert wire.carried_down / seconds < 5760
    notes = flown[0].fleet.counts
    assert notes["second sender under a vehicle's id"] == 0


def test_two_vehicles_behind_one_radio_share_its_budget(cable: Cable, tmp_path: Path) -> None:
    wire = cable.serial(57_600)
    plan = pair("rate_hz=50", "link_delay_s=0.1", "wind.mean_m_s=3", *_links(wire.url, wire.url))
    (rates,) = plan.rates
    assert 20 < rates.pose_hz < 30
    flown = _fly(plan, {wire.url: wire}, tmp_path / "flight.tlog")
    _assert_flown(plan, flown, tmp_path / "flight.tlog")
    assert wire.carried_up < 5760 * flown[0].figures.ticks / plan.spec.rate_hz


def _unplugged(wire: Wire, phase: Phase, after_s: float, for_s: float) -> Callable[[Runner, int], None]:
    """Unplugs a port some time after a phase has begun, and puts it in again."""
    began: list[int] = []

    def happens(runner: Runner, now_ns: int) -> None:
        if runner.phase is phase and not began:
            began.append(now_ns)
        passed_s = (now_ns - began[0]) / SECOND_NS if began else -1.0
        if wire.plugged and after_s <= passed_s < after_s + for_s:
            wire.unplug()
        elif not wire.plugged and passed_s >= after_s + for_s:
            wire.replug()

    return happens


def test_a_port_that_is_unplugged_before_arming_is_waited_for(cable: Cable, tmp_path: Path) -> None:
    one, two = cable.serial(57_600), cable.serial(57_600)
    plan = pair(*_links(one.url, two.url))
    happens = _unplugged(two, Phase.CONNECT, 2.0, 8.0)
    flown = _fly(plan, {one.url: one, two.url: two}, tmp_path / "flight.tlog", happens=happens)
    _assert_flown(plan, flown, tmp_path / "flight.tlog")


def test_a_port_that_is_unplugged_for_a_moment_in_flight_is_flown_on_with(cable: Cable, tmp_path: Path) -> None:
    one, two = cable.serial(57_600), cable.serial(57_600)
    plan = pair("steps.1.hold.seconds=5", *_links(one.url, two.url))
    happens = _unplugged(two, Phase.HOLD, 1.0, 0.3)
    flown = _fly(plan, {one.url: one, two.url: two}, tmp_path / "flight.tlog", happens=happens)
    _assert_flown(plan, flown, tmp_path / "flight.tlog")


@pytest.mark.parametrize("autopilot", ["px4", "arducopter"])
def test_a_port_that_is_unplugged_for_seconds_in_flight_brings_everybody_down(
    autopilot: str, cable: Cable, tmp_path: Path
) -> None:
    """Its vehicle is told to land when the port is back; the other comes back."""
    one, two = cable.serial(57_600), cable.serial(57_600)
    plan = pair("steps.1.hold.seconds=20", *_links(one.url, two.url), autopilots=("px4", autopilot))
    log = tmp_path / "flight.tlog"
    happens = _unplugged(two, Phase.HOLD, 1.0, 6.0)
    runner, world, _ = _fly(plan, {one.url: one, two.url: two}, log, happens=happens)
    assert runner.outcome == "aborted"
    assert runner.reason.startswith("vehicle 2: no position for 1 s; it lands where it is when nobody is below, the")
    assert not world.truth.armed.any()
    assert world.min_distance_airborne_m >= plan.spec.avoidance.radius_m
    assert verify_log(log).mismatches == 0


@pytest.mark.parametrize("other", ["serial", "udp"])
def test_links_of_different_kinds_are_mixed_in_one_mission(other: str, cable: Cable, tmp_path: Path) -> None:
    wire = cable.udp() if other == "udp" else cable.serial(115_200)
    (tcp, connect) = cable.tcp()
    plan = pair(*_links(wire.url, tcp))
    wires: dict[str, Wire | Callable[[Link], Wire]] = {wire.url: wire, tcp: connect}
    _assert_flown(plan, _fly(plan, wires, tmp_path / "flight.tlog"), tmp_path / "flight.tlog")


def test_eight_vehicles_behind_one_radio_at_57600_baud_are_flown(cable: Cable, tmp_path: Path) -> None:
    """Positions at 10 Hz and little else; the wire has to leave nothing out."""
    wire = cable.serial(57_600)
    plan = mission("px4_cube8", "steps.1.hold.seconds=5", *_links(*[wire.url] * 8))
    (rates,) = plan.rates
    assert rates.lean
    flown = _fly(plan, {wire.url: wire}, tmp_path / "flight.tlog", streams="radio")
    _assert_flown(plan, flown, tmp_path / "flight.tlog")
    seconds = flown[0].figures.ticks / plan.spec.rate_hz
    assert max(wire.carried_up, wire.carried_down) / seconds < 5760
    assert wire.left_out == 0


def test_more_vehicles_than_a_radio_carries_are_refused_with_the_number_that_it_does_carry() -> None:
    url = "serial:///dev/ttyUSB0:57600"
    links = [f"vehicles.{number}.link={url}" for number in range(8)]
    with pytest.raises(UserError) as caught:
        mission("cube8", f"link_bytes_per_s={{'{url}': 3000}}", *links)
    assert f"link {url}: 3000 bytes/s for 8 vehicles leave 3." in str(caught.value)
    assert "Hz for positions, minimum is 8 Hz; 5 would fit: use a faster link (57600 baud do)" in str(caught.value)
