"""Whole flights over signed links, against vehicles whose signatures are pymavlink's own."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from groundstation.app.cli import build
from groundstation.app.emulator import world_config
from groundstation.app.key_setup import KeySetup
from groundstation.app.signing import open_gate, read_keys
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter
from groundstation.mavlink.keys import new_key, read_key, read_times, times_path
from groundstation.mavlink.signing import SecretKey, Signing, timestamp_at, timestamp_of
from groundstation.mavlink.station import Outgoing
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.runner import Phase
from groundstation.records.notes import Received, Refused, Sent
from groundstation.records.tlog import read_tlog
from sitl.world import Outgoing as Datagram
from sitl.world import World, WorldConfig
from tests.app.flights import SECOND_NS, Flight, pair


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    path = tmp_path / "team.key"
    new_key(path)
    return path


def _pair(key_file: Path, *changes: str) -> MissionPlan:
    return pair(f"signing.key_file={key_file}", *changes)


def test_a_signed_flight_with_forgers_about_completes_and_is_reproduced_without_the_key(
    tmp_path: Path, key_file: Path
) -> None:
    """Unsigned, foreign and replayed frames come in all the time, from the vehicle's own address.

    Radios speak of themselves too, and somebody without the key tries to stop a vehicle's motors.
    """
    log = tmp_path / "flight.tlog"
    radio, stranger = Encoder(51, 68), Encoder(255, 190)
    tried: list[Phase] = []
    forger = Signing(SecretKey(bytes(32)))
    recorded: list[bytes] = []

    def intrude(flight: Flight) -> tuple[str, bytes] | None:
        number = flight.runner.figures.ticks % 5
        if number == 4:
            if flight.runner.phase is Phase.HOLD:
                tried.append(flight.runner.phase)
                kill = stranger.encode("COMMAND_LONG", target_system=1, target_component=1, command=400, param2=21196.0)
                flight.receive(0, kill, flight.now_ns)
            return "emulator:1", radio.encode("RADIO_STATUS", rssi=7)
        lie = Encoder(1).encode("LOCAL_POSITION_NED", x=50.0, time_boot_ms=flight.now_ns // 1_000_000)
        if number == 0:
            return "emulator:1", lie
        if number == 1:
            return "emulator:1", forger.sign(lie, 0, timestamp_at(1_750_000_000_000_000) + flight.now_ns // 10_000)
        return ("emulator:1", recorded[len(recorded) // 2]) if recorded else None

    def tamper(datagram: Datagram, _flight: Flight) -> list[Datagram]:
        if datagram.vehicle_index == 0:
            recorded.append(datagram.data)
        return [datagram]

    flight = Flight(_pair(key_file), intrude=intrude, tamper=tamper, log=log)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    assert flight.gate is not None
    totals = flight.gate.totals()
    assert min(totals[f"frames {words}"] for words in (
        "without a signature", "with a wrong signature", "with an old time stamp",
    )) > 100  # fmt: skip
    assert [signing.refused for signing in flight.world.signing] == [len(tried), 0]
    assert tried

    secret = bytes.fromhex(key_file.read_text())
    key_file.unlink()
    result = verify_log(log)
    assert (result.mismatches, result.complete) == (0, True)
    assert result.setpoints > 1000

    records = list(read_tlog(log))
    frames = [record.frame for record in records if isinstance(record, Sent | Received)]
    assert all(frame.signed for frame in frames if frame.sysid != radio.sysid)
    assert sum(isinstance(record, Refused) for record in records) == sum(flight.gate.counts.values())
    assert totals["RADIO_STATUS without a signature, let in"] == flight.gate.radio_status > 100
    for file in (log, log.with_suffix(".manifest.json")):
        assert secret not in file.read_bytes()
        assert secret.hex() not in file.read_text(errors="replace")


def test_vehicles_that_know_no_date_are_given_ours_and_fly(key_file: Path) -> None:
    def no_gps(config: WorldConfig) -> WorldConfig:
        return replace(config, vehicles=tuple(replace(vehicle, gps=False) for vehicle in config.vehicles))

    def dateless(unix_us: int) -> None:
        """GPS never tells the date."""

    def prepare(world: World) -> None:
        world.state.known.has_gps[:] = True  # positions as ever: only the date is not known
        for signing in world.signing:
            signing.date = dateless  # type: ignore[method-assign]

    def up(flight: Flight) -> bool:
        return flight.runner.phase is Phase.TAKEOFF

    flight = Flight(_pair(key_file), change=no_gps, prepare=prepare, interrupt_when=up)
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason.startswith("stopped by the operator")
    assert flight.gate is not None
    assert flight.gate.totals()["frames with an old time stamp"] > 0


def test_without_the_key_nothing_is_heard_and_nothing_armed(key_file: Path) -> None:
    def other_key(config: WorldConfig) -> WorldConfig:
        first, second = config.vehicles
        return replace(config, vehicles=(first, replace(second, signing_key=None)))

    flight = Flight(_pair(key_file, "limits.preflight_s=6"), change=other_key)
    assert flight.runner.outcome == "refused"
    assert not flight.world.truth.armed.any()
    assert flight.gate is not None
    (line,) = flight.gate.words(flight.plan.links, {(0, 1): 1, (1, 2): 2})
    assert re.match(r"vehicle 2: \d+ frames without a signature ignored; it does not sign: give it the key", line)


def test_links_may_differ(tmp_path: Path, key_file: Path) -> None:
    other = tmp_path / "other.key"
    new_key(other)
    one, two = "udpin://127.0.0.1:14540", "udpin://127.0.0.1:14541"
    links = [f"vehicles.0.link={one}", f"vehicles.1.link={two}"]
    plan = _pair(key_file, *links, f"signing.links={{'{two}': {{key_file: {other}, link_id: 9}}}}")
    assert read_keys(plan) == [read_key(key_file), read_key(other)]
    assert [plan.link_id(link) for link in (0, 1)] == [0, 9]
    plain = _pair(key_file, *links, f"signing.links={{'{two}': {{key_file: null}}}}")
    assert read_keys(plain) == [read_key(key_file), None]
    assert plain.signed_links == (0,)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["signing={}"], "signing.key_file: is missing"),
        (["signing.key_file=k", "signing.links={'udpin://1.2.3.4:5': {}}"], "no vehicle uses this link"),
        (["signing.key_file=k", "signing.link_id=256"], "signing.link_id: expected a number of at most 255"),
        (["signing.key_file=k", "vehicles.0.link=mavsdk://udpin://127.0.0.1:1"], "MAVSDK sends setpoints by itself"),
        (["signing.secret=k"], "signing.secret: unknown key"),
    ],
)
def test_what_does_not_fit_together_is_refused(changes: list[str], words: str) -> None:
    with pytest.raises(UserError, match=re.escape(words)):
        pair(*changes)


def test_a_flight_with_signatures_plans_for_their_bytes(key_file: Path) -> None:
    links = [f"vehicles.{k}.link=serial:///dev/ttyUSB0:57600" for k in (0, 1)]
    plain, signed = pair(*links), _pair(key_file, *links)
    assert signed.rates[0].pose_hz < plain.rates[0].pose_hz
    assert signed.rates[0].up_bytes_s <= 0.8 * 5760.0 * 1.0001


def test_time_stamps_go_on_after_a_crash_with_the_clock_an_hour_back(key_file: Path) -> None:
    """The first gate is never closed: what it had stored has to be enough."""
    plan, now_us = _pair(key_file), 1_790_000_000_000_000
    stamps = []
    for epoch_us in (now_us, now_us - 3_600_000_000, now_us - 3_600_000_000):
        gate = open_gate(plan, epoch_us, keep_times=True)
        assert gate is not None
        for tick in range(100):
            (item,) = gate.sign([_hello()], tick * SECOND_NS)
            (frame,) = FrameSplitter().feed(item.frames[0])
            assert isinstance(frame, Frame)
            stamps.append(timestamp_of(frame))
    assert all(a < b for a, b in itertools.pairwise(stamps))
    assert stamps[-1] < timestamp_at(now_us) + 300 * 100_000  # and do not run away from the clock either


def _hello() -> Outgoing:
    return Outgoing(0, "p", (Encoder(255, 190).encode("HEARTBEAT", type=6),))


def test_a_key_whose_times_cannot_be_kept_is_not_flown_with(key_file: Path) -> None:
    times_path(key_file).mkdir()
    with pytest.raises(UserError, match="time stamps of earlier flights cannot be read"):
        open_gate(_pair(key_file), 0, keep_times=True)
    times_path(key_file).rmdir()
    times_path(key_file).write_text("{}")
    with pytest.raises(UserError, match="is damaged"):
        open_gate(_pair(key_file), 0, keep_times=True)


def test_a_dry_run_leaves_no_times_behind(key_file: Path) -> None:
    Flight(_pair(key_file, "limits.preflight_s=1"))
    assert not times_path(key_file).exists()


def test_times_that_cannot_be_kept_in_flight_end_nothing_and_are_told(key_file: Path) -> None:
    plan = _pair(key_file)
    gate = open_gate(plan, 1_790_000_000_000_000, keep_times=True)
    assert gate is not None
    file = times_path(key_file)
    file.unlink()
    file.mkdir()
    (item,) = gate.sign([_hello()], 0)
    assert len(item.frames) == 1
    assert "cannot keep the signatures' time stamps" in gate.problem
    file.rmdir()
    gate.close()
    assert read_times(file).sent > 0


def test_keys_are_handed_to_vehicles_that_then_sign(key_file: Path) -> None:
    """Emulated vehicles without a key: disarmed ones take it, and are believed when they sign with it."""
    plan = _pair(key_file)
    unsigned = pair()
    world = World(world_config(unsigned), 1)
    setup = KeySetup(plan, read_keys(plan), 1_750_000_000_000_000)
    world.autopilots[1].armed = True
    for tick in range(1, 400):
        now_ns = tick * SECOND_NS // 50
        if tick == 250:
            assert [vehicle.signs for vehicle in setup.vehicles] == [True, False]
            assert setup.vehicles[1].state == "is armed; disarm it first"
            world.autopilots[1].armed = False
        for sent in world.advance(now_ns):
            setup.receive(plan.link_of_vehicle[sent.vehicle_index], f"v{sent.vehicle_index}", sent.data, now_ns)
        if tick in (100, 248):  # a stranger under the id of the one that is armed: neither it nor its state counts
            other = Encoder(plan.spec.vehicles[1].id)
            words = {"type": 2, "autopilot": 12, "base_mode": 0, "mavlink_version": 3}
            setup.receive(plan.link_of_vehicle[1], "stranger", other.encode("HEARTBEAT", **words), now_ns)
        for out in setup.outgoing(now_ns):
            assert out.peer != "stranger"
            if out.peer.startswith("v"):
                world.receive(int(out.peer[1:]), b"".join(out.frames), now_ns)
    assert setup.done
    assert [vehicle.state for vehicle in setup.vehicles] == ["signs with the key"] * 2


def test_command_line(tmp_path: Path, key_file: Path) -> None:
    application, runner = build("signing"), CliRunner()
    path = tmp_path / "new.key"
    result = runner.invoke(application, ["signing", "new", str(path), "--json"])
    assert json.loads(result.stdout.splitlines()[-1]) == {"key_file": str(path)}
    assert path.read_text().strip() not in result.output
    mission = ["signing", "setup", "--mission", "first_flight2.yaml", "--set", f"signing.key_file={key_file}"]
    link = ["--set", "vehicles.0.link=udpin://0.0.0.0:24641", "--set", "vehicles.1.link=udpin://0.0.0.0:24641"]
    result = runner.invoke(application, mission + link)
    assert isinstance(result.exception, UserError)
    assert "readable for everybody; connect the vehicles by USB" in str(result.exception)
    result = runner.invoke(application, ["signing", "setup", "--mission", "first_flight2.yaml"])
    assert "name the key: signing:" in str(result.exception)
    result = runner.invoke(application, ["signing", "burn"])
    assert "gs signing burn: unknown; known are new, setup" in str(result.exception)
    result = runner.invoke(application, ["signing", "new"])
    assert "expected gs signing new FILE" in str(result.exception)


def test_a_stranger_without_signatures_about_steers_nothing_even_when_the_vehicle_falls_silent() -> None:
    """Unsigned links: spoofed frames from another address, all flight long, and while vehicle 1 is not heard at all."""
    spoof = Encoder(1)
    silent_from: list[int] = []

    def intrude(flight: Flight) -> tuple[str, bytes] | None:
        now_ms = flight.now_ns // 1_000_000
        lies = [
            spoof.encode("HEARTBEAT", type=2, autopilot=12, base_mode=128, custom_mode=393216, system_status=4),
            spoof.encode("LOCAL_POSITION_NED", x=0.0, y=0.0, z=-0.6, time_boot_ms=now_ms),
            spoof.encode("ATTITUDE_QUATERNION", q1=1.0, time_boot_ms=now_ms),
            spoof.encode("TIMESYNC", tc1=10**15, ts1=flight.now_ns),
            spoof.encode("COMMAND_ACK", command=400, result=0),
        ]
        # On the ground it would be called a second vehicle, and nothing armed.
        return ("stranger:1", b"".join(lies)) if flight.runner.phase not in (Phase.CONNECT, Phase.ARM) else None

    def tamper(datagram: Datagram, flight: Flight) -> list[Datagram]:
        if flight.runner.phase is Phase.HOLD and not silent_from:
            silent_from.append(flight.now_ns)
        return [] if silent_from and datagram.vehicle_index == 0 else [datagram]

    flight = Flight(pair(), intrude=intrude, tamper=tamper)
    assert flight.runner.fleet.peer[0] == "emulator:1"
    assert flight.runner.fleet.counts["second sender under a vehicle's id"] > 1000
    assert flight.runner.outcome == "aborted"
    assert not flight.world.truth.airborne[1]
