"""MAVProxy, driven by its command line, flies a vehicle of ``gs sitl``."""

from __future__ import annotations

import contextlib
import importlib.util
import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.sitl.served import FASTER, free_tcp_port, free_udp_port, serving

pytestmark = pytest.mark.skipif(importlib.util.find_spec("MAVProxy") is None, reason="MAVProxy is not installed")

_MODULES = "link,mode,arm,param,cmdlong,misc,fence"
_LIMIT_S = 25.0


class MavProxy:
    """Its standard input and output."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._lines: queue.Queue[str] = queue.Queue()
        self.transcript: list[str] = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)

    def type(self, command: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()

    def expect(self, pattern: str) -> str:
        """Waits for a line in which the pattern is found."""
        deadline = time.monotonic() + _LIMIT_S
        while True:
            try:
                line = self._lines.get(timeout=max(deadline - time.monotonic(), 0.001))
            except queue.Empty:
                raise AssertionError(f"{pattern!r} not seen in:\n{''.join(self.transcript)}") from None
            self.transcript.append(line)
            if re.search(pattern, line):
                return line

    def until(self, command: str, pattern: str) -> str:
        """Repeats a command that shows something until it shows the pattern."""
        deadline = time.monotonic() + _LIMIT_S
        while time.monotonic() < deadline:
            self.type(command)
            try:
                line = self._lines.get(timeout=0.5)
            except queue.Empty:
                continue
            self.transcript.append(line)
            if re.search(pattern, line):
                return line
        raise AssertionError(f"{pattern!r} not seen in:\n{''.join(self.transcript)}")


@contextlib.contextmanager
def mavproxy(master: str, folder: Path) -> Iterator[MavProxy]:
    process = subprocess.Popen(
        [
            sys.executable, "-u", "-m", "MAVProxy.mavproxy", f"--master={master}", "--no-state",
            f"--default-modules={_MODULES}", "--streamrate=10",
        ],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder,
    )  # fmt: skip
    try:
        yield MavProxy(process)
    finally:
        process.kill()
        process.wait()


def _nothing_unknown(proxy: MavProxy) -> None:
    text = "".join(proxy.transcript)
    assert "UNSUPPORTED" not in text
    assert "FAILED" not in text
    assert "ERROR" not in text


def test_flies_arducopter(tmp_path: Path) -> None:
    port = free_udp_port()
    arguments = ("--vehicles", "1", "--autopilot", "arducopter", "--port", str(port), *FASTER)
    with serving(*arguments), mavproxy(f"udpin:127.0.0.1:{port}", tmp_path) as proxy:
        proxy.expect("Detected vehicle 1:1 on link 0")
        received = proxy.expect(r"Received \d+ parameters")
        assert int(received.split()[-2]) > 300
        proxy.type("link")
        proxy.expect(r"link 1 OK .* 0 lost")
        proxy.type("param show RTL_ALT")
        proxy.expect(r"RTL_ALT +1500\.0")
        proxy.type("param set RTL_ALT 2000")
        proxy.until("param show RTL_ALT", r"RTL_ALT +2000\.0")
        proxy.type("mode guided")
        proxy.expect("Mode GUIDED")
        proxy.type("arm throttle")
        proxy.expect("COMPONENT_ARM_DISARM: ACCEPTED")
        proxy.expect("^ARMED|> ARMED")
        proxy.type("takeoff 1.5")
        proxy.expect("NAV_TAKEOFF: ACCEPTED")
        proxy.until("status VFR_HUD", r"VFR_HUD .*alt : 489\.[3-9]")
        proxy.type("status HEARTBEAT")
        proxy.expect(r"HEARTBEAT .*custom_mode : 4, system_status : 4")
        proxy.type("mode land")
        proxy.expect("DISARMED")
        proxy.until("status HEARTBEAT", r"HEARTBEAT .*custom_mode : 9, system_status : 3")
        assert "fence breach" not in "".join(proxy.transcript)
        _nothing_unknown(proxy)


def test_flies_px4_over_tcp(tmp_path: Path) -> None:
    port, tcp_port = free_udp_port(), free_tcp_port()
    arguments = ("--vehicles", "1", "--port", str(port), *FASTER, "--tcp", str(tcp_port))
    with serving(*arguments), mavproxy(f"tcp:127.0.0.1:{tcp_port}", tmp_path) as proxy:
        proxy.expect("Detected vehicle 1:1 on link 0")
        proxy.expect(r"Received \d+ parameters")
        proxy.type("param show MIS_TAKEOFF_ALT")
        proxy.expect(r"MIS_TAKEOFF_ALT +2\.5")
        proxy.type("param set MIS_TAKEOFF_ALT 1.5")
        proxy.until("param show MIS_TAKEOFF_ALT", r"MIS_TAKEOFF_ALT +1\.5")
        proxy.type("arm throttle")
        proxy.expect("COMPONENT_ARM_DISARM: ACCEPTED")
        proxy.type("takeoff 489.5")  # above the sea, as PX4 takes it
        proxy.expect("NAV_TAKEOFF: ACCEPTED")
        proxy.expect("Mode TAKEOFF")
        proxy.expect("Mode LOITER")
        proxy.type("long NAV_LAND 0 0 0 0 0 0 0")
        proxy.expect("NAV_LAND: ACCEPTED")
        proxy.expect("DISARMED")
        _nothing_unknown(proxy)
