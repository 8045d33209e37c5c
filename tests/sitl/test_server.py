"""``gs sitl`` as a process: ports, several ground stations, TCP, silence, faults, ends."""

from __future__ import annotations

import contextlib
import io
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from rich.console import Console

from groundstation.app.serving import server_picture
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, message_name
from sitl.faults import Fault
from sitl.fleet import fleet
from sitl.server import Server
from sitl.world import WorldConfig
from tests.sitl.served import free_tcp_port, free_udp_port, serving

LIMIT_S = 10.0


@contextlib.contextmanager
def listener(port: int = 0) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as item:
        item.bind(("127.0.0.1", port))
        item.settimeout(LIMIT_S)
        yield item


def beats(item: socket.socket, count: int) -> dict[int, tuple[str, int]]:
    """Waits for heartbeats of that many systems; the source address of each."""
    found: dict[int, tuple[str, int]] = {}
    splitter = FrameSplitter()
    deadline = time.monotonic() + LIMIT_S
    while len(found) < count:
        assert time.monotonic() < deadline, f"{len(found)} of {count} heartbeats"
        data, address = item.recvfrom(65535)
        for frame in splitter.feed(data):
            if isinstance(frame, Frame) and message_name(frame.msgid) == "HEARTBEAT":
                found[frame.sysid] = address
    return found


def test_one_port_for_all_each_from_its_own() -> None:
    with listener() as item, serving("--vehicles", "5", "--port", str(item.getsockname()[1])):
        found = beats(item, 5)
        assert sorted(found) == [1, 2, 3, 4, 5]
        assert len(set(found.values())) == 5


def test_a_port_for_each_vehicle() -> None:
    base = free_udp_port()
    arguments = ("--vehicles", "2", "--port", str(base), "--port-per-vehicle")
    with listener(base) as first, listener(base + 1) as second, serving(*arguments):
        assert sorted(beats(first, 1)) == [1]
        assert sorted(beats(second, 1)) == [2]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_goes_on_quietly_with_nobody_listening_and_ends_cleanly(number: signal.Signals) -> None:
    port = free_udp_port()
    with serving("--vehicles", "2", "--port", str(port), interrupt=number), listener() as later:
        # nobody has the port: every datagram is refused; then somebody comes and is served
        sources = _sources(port)
        later.sendto(Encoder(255, 190).encode("HEARTBEAT", type=6), sources[0])
        assert beats(later, 1)


def _sources(port: int) -> list[tuple[str, int]]:
    with listener(port) as item:
        return [address for _, address in sorted(beats(item, 2).items())]


def test_several_ground_stations_at_once() -> None:
    port = free_udp_port()
    arguments = ("--vehicles", "2", "--port", str(port))
    with listener(port) as first, listener() as second, listener() as third, serving(*arguments):
        found = beats(first, 2)
        heartbeat = Encoder(42, 190).encode("HEARTBEAT", type=6)
        second.sendto(heartbeat, found[1])
        third.sendto(heartbeat, found[1])
        third.sendto(heartbeat, found[2])
        assert sorted(beats(second, 1)) == [1]
        assert sorted(beats(third, 2)) == [1, 2]
        assert sorted(beats(first, 2)) == [1, 2]


def test_each_datagram_comes_once_to_a_ground_station_that_answers_from_its_port() -> None:
    with listener() as item, serving("--vehicles", "1", "--port", str(item.getsockname()[1])):
        address = beats(item, 1)[1]
        item.sendto(Encoder(255, 190).encode("HEARTBEAT", type=6), address)
        beats(item, 1)
        splitter = FrameSplitter()
        numbers: list[int] = []
        deadline = time.monotonic() + LIMIT_S
        while len(numbers) < 200 and time.monotonic() < deadline:
            numbers += [frame.seq for frame in splitter.feed(item.recv(65535)) if isinstance(frame, Frame)]
        assert all((b - a) % 256 == 1 for a, b in pairwise(numbers))


def test_tcp() -> None:
    tcp_port = free_tcp_port()
    with serving("--vehicles", "2", "--port", str(free_udp_port()), "--tcp", str(tcp_port)):
        for vehicle in (1, 2):
            with socket.create_connection(("127.0.0.1", tcp_port + 10 * (vehicle - 1)), LIMIT_S) as link:
                link.settimeout(LIMIT_S)
                command = Encoder(255, 190).encode(
                    "COMMAND_LONG", target_system=vehicle, target_component=1, command=512, param1=148
                )
                link.sendall(command[:7])  # frames may come in pieces
                splitter, rest = FrameSplitter(datagrams=False), command[7:]
                seen: set[str | None] = set()
                deadline = time.monotonic() + LIMIT_S
                while time.monotonic() < deadline and not {"HEARTBEAT", "AUTOPILOT_VERSION", "COMMAND_ACK"} <= seen:
                    frames = [piece for piece in splitter.feed(link.recv(65535)) if isinstance(piece, Frame)]
                    assert all(frame.sysid == vehicle for frame in frames)
                    seen |= {message_name(frame.msgid) for frame in frames}
                    if rest and "HEARTBEAT" in seen:
                        link.sendall(rest)
                        rest = b""
                assert {"HEARTBEAT", "AUTOPILOT_VERSION", "COMMAND_ACK"} <= seen


def test_timetable_and_orders(tmp_path: Path) -> None:
    path = tmp_path / "faults.yaml"
    path.write_text("faults: [{kind: blackout, vehicles: [2]}]")
    with (
        listener() as item,
        serving(
            "--vehicles", "3", "--port", str(item.getsockname()[1]), "--faults", str(path), "--orders", stdin=True
        ) as process,
    ):
        assert sorted(beats(item, 2)) == [1, 3]
        assert process.stdin is not None
        process.stdin.write("clear\n{kind: blackout, vehicles: [1, 3]}\n{kind: gremlins}\n")
        process.stdin.flush()
        assert process.stdout is not None
        assert "'gremlins' is unknown" in process.stdout.readline()
        item.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                item.recv(65535)
        item.settimeout(LIMIT_S)
        assert sorted(beats(item, 1)) == [2]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--vehicles", "0"], "vehicles: 0, limits 1 and 254"),
        (["--autopilot", "inav"], "--autopilot: 'inav' is unknown; choose one of px4, arducopter"),
        (["--profile", "brick"], "--profile: 'brick' is unknown"),
        (["--port", "70000"], "--port: 70000"),
        (["--faults", "no-such-file.yaml"], "no-such-file.yaml: cannot be read"),
        (["--mavlink", "3"], "--mavlink: 3 is unknown"),
        (["--wind", "99"], "--wind: 99.0 is out of range"),
    ],
)
def test_wrong_options_end_with_2_and_a_sentence(arguments: list[str], words: str) -> None:
    code = "import sys; from groundstation.app.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code, "sitl", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert words in re.sub(r"\s+", " ", done.stderr)
    assert "Traceback" not in done.stderr


def test_a_machine_that_stands_still_skips_time_and_says_so() -> None:
    stop, now = threading.Event(), [10**12]

    def clock() -> int:
        now[0] += 1_000_000
        return now[0]

    with Server(WorldConfig(vehicles=fleet(1)), 1, port=free_udp_port(), clock=clock) as server:
        calls: list[int] = []

        def status(running: Server) -> None:
            calls.append(running.world.now_ns)
            if len(calls) == 2:
                now[0] += 5 * 10**9  # the machine sleeps for 5 s
            if len(calls) == 4:
                stop.set()

        server.run(stop, status, status_every_s=0.01)
        assert server.late_ns == pytest.approx(5e9, rel=0.02)
        assert calls[-1] - calls[0] < 10**9


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("{kind: blackout, vehicles: [77]}", "77 is not among the emulated ones"),
        ("{kind: blackout}, {kind: blackout, vehicles: [77]}", "77 is not among the emulated ones"),
        ("[" * 5000, "nested too deeply"),
        ("{kind: blackout, for_s: 1" + "0" * 400 + "}", "out of all bounds"),
    ],
)
def test_a_wrong_order_is_told_and_changes_nothing(line: str, words: str) -> None:
    with Server(WorldConfig(vehicles=fleet(2)), 1, port=free_udp_port()) as server:
        server.orders.obey(line)
        assert len(server.orders.errors) == 1
        assert words in server.orders.errors[0]
        assert server.world.active_faults == ()


def test_status_shows_modes_positions_and_what_is_wrong() -> None:
    faults = (Fault("loss", vehicles=(2,), numbers={"probability": 0.5}),)
    with Server(WorldConfig(vehicles=fleet(3), faults=faults), 1, port=free_udp_port()) as server:
        server.world.advance(server.world.now_ns + 3 * 10**9)
        server.orders.obey("{kind: gremlins}")
        server.world.frame_errors[1] = 3
        console = Console(width=120, record=True, file=io.StringIO())
        console.print(server_picture(server))
        text = console.export_text()
    assert re.search(r"1 +AUTO.LOITER +ground +100 % +-1.00 +0.00 +0.00", text)
    assert "fault: loss of 2, probability 0.5" in text
    assert "'gremlins' is unknown" in text
    assert "3 frames could not be handled" in text
