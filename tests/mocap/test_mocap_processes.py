"""``gs mocap read`` as a flight starts it, ``gs mocap play`` of a recorded flight: processes and frames on the wire."""

from __future__ import annotations

import json
import lzma
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

from groundstation.app.mocap.process import reading
from groundstation.app.mocap.reading import SYSTEMS
from groundstation.app.mocap.vrpn import VrpnServer, bodies_of
from groundstation.app.session import Session
from groundstation.core import frames
from groundstation.mavlink.codec import Frame, FrameSplitter
from groundstation.mavlink.mocap_frames import RoomEncoder, room_frames
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.runner import Runner
from groundstation.mocap.bodies import RoomFrame
from tests.app.flights import mission
from tests.sitl.served import free_udp_port

_MAIN = "import sys; sys.argv[0] = 'gs'; from groundstation.app.cli import main; main()"
SECOND_NS = 1_000_000_000
_LOGS = Path(__file__).parents[1] / "reference_logs"
_STAND_IN = '''"""Stands in for the package of that name: two bodies on the pads of lab_pair2, y up, in millimetres."""
import time
from types import SimpleNamespace as Value


def connect(system, config):
    assert (system, config) == ("vicon", {"hostname": "192.0.2.1"})
    return System()


class System:
    def waitForNextFrame(self):
        time.sleep(0.01)

    @property
    def rigidBodies(self):
        level = Value(w=1.0, x=0.0, y=0.0, z=0.0)
        places = {"left": (-500.0, 0.0, 0.0), "cf2": (500.0, 0.0, 0.0)}
        return {name: Value(position=place, rotation=level) for name, place in places.items()}
'''


@contextmanager
def listening() -> Iterator[tuple[socket.socket, str]]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flight:
        flight.bind(("127.0.0.1", 0))
        flight.settimeout(60.0)
        yield flight, f"udpin://127.0.0.1:{flight.getsockname()[1]}"


def heard(flight: socket.socket, rows: dict[int, int], count: int) -> list[RoomFrame]:
    """So many frames, as a flight reads them."""
    splitter, found = FrameSplitter(), []
    for number in range(count):
        pieces = [piece for piece in splitter.feed(flight.recv(65536)) if isinstance(piece, Frame)]
        found += list(room_frames([(piece, number) for piece in pieces], rows))
    return found


def falls_silent(flight: socket.socket) -> bool:
    """Whether there is an end of what comes."""
    flight.settimeout(0.5)
    left = 0
    with suppress(TimeoutError):
        while flight.recv(65536) and left < 10_000:
            left += 1
    return left < 10_000


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The stand-in, for this process and those that it starts."""
    (tmp_path / "motioncapture.py").write_text(_STAND_IN, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "motioncapture", raising=False)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    yield
    sys.modules.pop("motioncapture", None)  # not by monkeypatch, which would put it back


def plan_at(link: str) -> MissionPlan:
    given = f"positioning={{source: mocap, system: vicon, host: 192.0.2.1, link: '{link}', up: y, unit: mm}}"
    return mission("lab_pair2", given, "vehicles.0.body=left")


@pytest.mark.usefixtures("package")
def test_a_flight_reads_the_system_that_its_mission_names_and_ends_that_with_itself() -> None:
    assert "vicon" in SYSTEMS
    with listening() as (flight, link):
        plan = plan_at(link)
        with reading(plan):
            seen = heard(flight, {1: 0, 2: 1}, 3)
        assert falls_silent(flight)  # it has ended: what still lay there was all
    assert seen
    for frame in seen:
        assert frame.row.tolist() == [0, 1]
        assert frame.pos_ned_m == pytest.approx(frames.ned_from_enu(plan.pads_enu_m))


@pytest.mark.usefixtures("package")
def test_what_reads_the_system_is_replaced_when_it_dies_by_one_that_waits_and_sends_nothing_before() -> None:
    with listening() as (flight, link):
        plan = plan_at(link)
        session = Session(Runner(plan, 0), None)
        with reading(plan) as (_, (keeper,)):
            heard(flight, {1: 0, 2: 1}, 3)
            keeper.apply(session, SECOND_NS)
            keeper.apply(session, 7 * SECOND_NS)  # from now on one waits
            first = keeper.pid
            os.kill(first, signal.SIGKILL)
            os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
            assert falls_silent(flight)
            flight.settimeout(60.0)
            keeper.apply(session, 8 * SECOND_NS)
            assert heard(flight, {1: 0, 2: 1}, 3)
            assert keeper.pid != first
            (note,) = [note.text for note in session.take_notes() if note.kind == "alarm"]
            os.kill(keeper.pid, signal.SIGKILL)
            os.waitid(os.P_PID, keeper.pid, os.WEXITED | os.WNOWAIT)
            second = keeper.pid
            keeper.apply(session, 8 * SECOND_NS + 1)  # again so soon: not at once
            assert keeper.pid == second
            keeper.apply(session, 10 * SECOND_NS)
            assert heard(flight, {1: 0, 2: 1}, 3)
    assert "what reads the motion capture (vicon at 192.0.2.1) has gone (killed by signal 9); another one" in note


def test_the_room_of_a_recorded_flight_is_played_again(tmp_path: Path) -> None:
    log = tmp_path / "room.tlog"
    log.write_bytes(lzma.decompress((_LOGS / "room.tlog.xz").read_bytes()))
    shutil.copy(_LOGS / "room.manifest.json", tmp_path)
    vehicles = json.loads((_LOGS / "room.manifest.json").read_text(encoding="utf-8"))["mission"]["vehicles"]
    with listening() as (flight, link):
        words = ["mocap", "play", str(log), "--link", link]
        process = subprocess.Popen(
            [sys.executable, "-c", _MAIN, *words],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        try:
            seen = heard(flight, {vehicle["id"]: row for row, vehicle in enumerate(vehicles)}, 20)
        finally:
            process.send_signal(signal.SIGINT)
            said, _ = process.communicate(timeout=60)
    assert "plays" in said
    assert "Traceback" not in said
    assert len(seen) == 20
    assert np.diff([frame.stamp_ns for frame in seen]).min() > 0
    assert seen[0].row.tolist() == list(range(len(vehicles)))
    pads = np.array([vehicle["pad_m"] for vehicle in vehicles])
    assert np.linalg.norm(seen[0].pos_ned_m - frames.ned_from_enu(pads), axis=1).max() < 0.05


def test_all_that_read_the_system_end_with_the_last_that_holds_them_even_while_they_wait_in_their_library(
    tmp_path: Path,
) -> None:
    silent = "import time\n\n\ndef connect(system, config):\n    print('connected', flush=True)\n    time.sleep(1e6)\n"
    (tmp_path / "motioncapture.py").write_text(silent, encoding="utf-8")
    ends, holds = os.pipe()
    other = os.dup(holds)
    words = ["mocap", "read", "--system", "vicon", "--host", "192.0.2.1", "--kept"]
    with ExitStack() as stack:
        readers = []
        for _ in range(2):  # one, and the one that takes its place
            reader = subprocess.Popen(
                [sys.executable, "-c", _MAIN, *words], stdin=ends, stdout=subprocess.PIPE, text=True,
                env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])},
            )  # fmt: skip
            readers.append(reader)
            assert reader.stdout is not None
            said = stack.enter_context(reader.stdout)
            while said.readline() != "connected\n":
                assert reader.poll() is None
        os.close(ends)
        os.close(holds)  # the flight's; its gateway lives
        with pytest.raises(subprocess.TimeoutExpired):
            readers[0].wait(0.5)
        os.close(other)
        assert [reader.wait(30) for reader in readers] == [-signal.SIGIO, -signal.SIGIO]


def test_a_fake_room_is_read_through_vrpn_by_whoever_reads_real_ones() -> None:
    motioncapture = pytest.importorskip("motioncapture", reason="motioncapture is not installed")
    port = free_udp_port()
    place, turn = np.array([1.0, -2.0, 0.5]), np.array([0.0, 0.0, 0.6, 0.8])
    ends = Event()

    def serve(server: VrpnServer) -> None:
        while not ends.wait(0.01):
            server.send(5_000_000, {"cf1": (place, turn), "cart": (2.0 * place, turn)})

    with closing(VrpnServer(port=port)) as server:
        thread = Thread(target=serve, args=(server,))
        thread.start()
        try:
            system = motioncapture.connect("vrpn", {"hostname": f"127.0.0.1:{port}"})
            seen: dict[str, Any] = {}
            while set(seen) != {"cf1", "cart"}:
                system.waitForNextFrame()
                seen |= dict(system.rigidBodies)
        finally:
            ends.set()
            thread.join()
    assert seen["cart"].position == pytest.approx(2.0 * place)
    rotation = seen["cf1"].rotation
    assert (rotation.x, rotation.y, rotation.z, rotation.w) == pytest.approx((0.0, 0.0, 0.6, 0.8))
    datagram = RoomEncoder().datagram(
        7, [1, None], frames.ned_from_enu(np.array([place, place])), np.full((2, 4), np.nan)
    )
    stamp_us, bodies = bodies_of(datagram, {1: "cf1"})
    assert stamp_us == 7
    assert set(bodies) == {"cf1", "marker2"}
    assert bodies["marker2"][0] == pytest.approx(place)
