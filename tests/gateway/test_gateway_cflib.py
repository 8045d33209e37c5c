"""``gs gateway crazyflie`` with unmodified cflib over UDP: eight emulated Crazyflies fly lab_cube8, seen by a room."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from groundstation.app.verify import verify_log
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, decode
from tests.app.commands import gs
from tests.sitl.served import free_udp_port, serving

pytest.importorskip("cflib", reason="cflib is not installed")

_MAIN = "import sys; sys.argv[0] = 'gs'; from groundstation.app.cli import main; main()"


def _free_ports(count: int) -> int:
    """The first of so many UDP ports that are free, one behind the other."""
    while True:
        first = free_udp_port()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            for port in range(first + 1, first + count):
                try:
                    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other:
                        other.bind(("127.0.0.1", port))
                except OSError:
                    break
            else:
                return first
            probe.close()


@contextmanager
def gateway(vehicles: int, first: int, port: int, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Runs the gateway until all are connected; ends it as a user would."""
    named = [w for k in range(vehicles) for w in ("-v", f"{k + 1}=udp://127.0.0.1:{first + k}")]
    words = ["gateway", "crazyflie", *named, "--out", f"udpout://127.0.0.1:{port}", "--log-hz", "25", "--cache"]
    process = subprocess.Popen(
        [sys.executable, "-c", _MAIN, *words, str(folder / "cache")],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    said: list[str] = []
    try:
        assert process.stdout is not None
        for line in process.stdout:
            said.append(line)
            if "all are there" in line:
                break
        assert said, "it said nothing"
        assert "all are there" in said[-1], said
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            rest, _ = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert process.returncode == 0, (said, rest)
    assert "Traceback" not in "".join((*said, rest))


@contextmanager
def seen_by_a_room(first: int, link: str) -> Iterator[None]:
    """Runs the mission's emulated team and its fake motion capture system at 100 Hz."""
    words = ["mocap", "fake", "--mission", "lab_cube8", "--port", str(first), "--link", link]
    process = subprocess.Popen(
        [sys.executable, "-c", _MAIN, *words],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        assert "emulates the team of lab_cube8" in process.stdout.readline()
        yield
    finally:
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
    assert process.returncode == 0, rest


def test_eight_fly_the_lab_cube_by_unmodified_cflib_and_the_log_replays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, log = _free_ports(8), tmp_path / "flight.tlog"
    links = [w for k in range(8) for w in ("--set", f"vehicles.{k}.link=udp://127.0.0.1:{first + k}")]
    links += ["--set", f"gateway={{link: 'udpout://127.0.0.1:{free_udp_port()}'}}", "--set", "limits.preflight_s=120"]
    room = f"udpin://127.0.0.1:{free_udp_port()}"
    monkeypatch.chdir(tmp_path)
    with seen_by_a_room(first, room):  # the gateway is begun by the flight itself, in a process of its own
        # A machine with other work answers late: that is reckoned with, as on a slow link.
        slow = ["--set", f"positioning.link={room}", "--set", "link_delay_s=0.15", "--set", "limits.pose_age_s=1"]
        words = ["fly", "--mission", "lab_cube8", "--log", str(log), "--set", "steps.1.hold.seconds=1", *slow, *links]
        code, out, err = gs(words, monkeypatch, capsys)
    assert code == 0, (out, err)
    assert "lab_cube8: completed" in out
    assert verify_log(log).mismatches == 0
    assert "radio links at their worst: " in out
    assert list((tmp_path / ".crazyflie_cache").glob("*.json"))  # tables kept


def test_ctrl_c_lands_whoever_flies_before_the_gateway_ends(tmp_path: Path) -> None:
    first, encoder, splitter = _free_ports(1), Encoder(255, 190), FrameSplitter()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(30.0)

        def landed_states() -> Iterator[int]:
            while True:
                data, peer = station.recvfrom(4096)
                for command, params in (
                    (176, {"param1": 1.0, "param2": 1.0}),
                    (400, {"param1": 1.0}),
                    (22, {"param7": 0.5}),
                ):
                    if asking:
                        frame = encoder.encode("COMMAND_LONG", target_system=1, command=command, **params)
                        station.sendto(frame, peer)
                for piece in splitter.feed(data):
                    if isinstance(piece, Frame):
                        for batch in decode([piece]):
                            if batch.name == "EXTENDED_SYS_STATE":
                                yield int(batch.values[0]["landed_state"])

        asking = True
        with (
            serving("--autopilot", "crazyflie", "--vehicles", "1", "--port", str(first)),
            gateway(1, first, station.getsockname()[1], tmp_path) as process,
        ):
            told = landed_states()
            assert 2 in told  # in the air, and its takeoff is over
            asking = False
            process.send_signal(signal.SIGINT)
            assert 4 in told
            assert 1 in told
            assert process.wait(30) == 0
