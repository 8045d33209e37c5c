"""``gs sitl`` as a process of its own on free ports, for clients that need real sockets."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator

FASTER = ("--speed", "3")
"""For clients that do not mind: their waiting is most of what the tests take."""

_MAIN = "import sys; sys.argv[0] = 'gs'; from groundstation.app.cli import main; main()"


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def free_tcp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def serving(
    *arguments: str, interrupt: signal.Signals = signal.SIGINT, stdin: bool = False
) -> Iterator[subprocess.Popen[str]]:
    """Runs ``gs sitl`` with these arguments; ends it as a user would, and checks that it ended cleanly."""
    process = subprocess.Popen(
        [sys.executable, "-c", _MAIN, "sitl", *arguments],
        stdin=subprocess.PIPE if stdin else subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        first = process.stdout.readline()  # printed when the sockets are open
        assert "Ctrl-C" in first, (first, process.stderr.read() if process.stderr else "")
        yield process
    finally:
        process.send_signal(interrupt)
        try:
            out, err = process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert process.returncode == 0, (out, err)
    assert "Traceback" not in err, err
