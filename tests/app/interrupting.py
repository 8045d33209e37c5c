"""Presses Ctrl-C at instants spread over the first seconds of every command, each on a terminal of its own.

``python -m tests.app.interrupting`` (or ``... interrupting fly campaign``) takes a quarter of an hour on two cores. It
waits for the wall clock and says what it saw; tests/app/test_interrupted.py judges the same in fewer, chosen instants.
"""

from __future__ import annotations

import argparse
import os
import pty
import re
import select
import shlex
import signal
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from groundstation.app.cli import COMMANDS
from groundstation.app.commands.bench import BENCHES
from groundstation.app.reference.examples import EXAMPLES

INSTANTS = 20
SPAN_S = 2.0
PATIENCE_S = 60.0
_AGAIN_S = 6.0
"""Flights come home after the first Ctrl-C; the second and third end them."""
BAD = re.compile(
    r"Traceback|KeyboardInterrupt|Exception ignored|Fatal Python error|Error in sys\.excepthook|Exception in"
)

_LINES: tuple[str, ...] = (
    "--help",
    "--version",
    "missions",
    "init mine --like cube8",
    "new formation sphere --agents 40",
    "new law my_law",
    "fly --mission cube8 --dry-run",
    "fly --mission cube8 --dry-run --json",
    "fly --mission hello1 --dry-run --realtime",
    "fly --mission hello1 --dry-run --udp",
    "fly --mission first_flight2 --set vehicles.0.link=udpin://127.0.0.1:{port} --set vehicles.1.link=udpin://127.0.0.1:{port}",
    "command",
    "command hold",
    "console --port {port}",
    "vehicles udpin://127.0.0.1:{port}",
    "check --mission first_flight2 --set vehicles.0.link=udpin://127.0.0.1:{port} --set vehicles.1.link=udpin://127.0.0.1:{port}",
    "params save --mission first_flight2 --set vehicles.0.link=udpin://127.0.0.1:{port} --set vehicles.1.link=udpin://127.0.0.1:{port}",
    "signing new team.key",
    "design ring.yaml --robustness -o ring.npz",
    "design cube8 --method cvxpy",
    "sitl --vehicles 2 --port {port}",
    "sitl --autopilot crazyflie --vehicles 2 --port {port}",
    "gateway crazyflie -v 1=udp://127.0.0.1:{port}",
    "sitl-env px4_cube8",
    "replay flight.tlog",
    "replay flight.tlog --verify",
    "report flight.tlog -o report",
    "compare flight.tlog flight.tlog -o compared",
    "export flight.tlog --to csv -o flight.csv",
    "export flight.tlog --to parquet -o flight.parquet",
    "export flight.tlog --to mcap -o flight.mcap",
    "import crazyswarm . -o imported --formation two_squares9",
    "campaign --mission first_flight2 --runs 4 --workers 1 -o campaign",
    "campaign --mission first_flight2 --runs 4 --workers 0 -o campaign",
    "identify flight.tlog",
    "schema mission",
    "completion bash",
    *(f"bench {name}" for name in BENCHES),
)
LINES = (
    *_LINES,
    *(
        line.removeprefix("gs ")
        for name in sorted(set(COMMANDS) - {line.split()[0] for line in _LINES})
        for line in EXAMPLES[name]
    ),
)
"""Every command, those with several ways to work by each of them; of new ones their examples."""
BESIDE = ("command hold", "console")
"""Lines that want a flight under way."""
_FLIGHT = "fly --mission sequence8 --dry-run --realtime --console"


@dataclass(frozen=True)
class Seen:
    """One process: what was typed, when it was interrupted, what came of it."""

    line: str
    at_s: float
    code: int | None
    said: str
    left: tuple[str, ...]
    cooked: bool

    @property
    def too_early(self) -> bool:
        """Nothing of gs ran yet: Python itself was starting, which no program written in it can change."""
        return bool(BAD.search(self.said)) and not re.search(r"groundstation|sitl/|site-packages", self.said)

    @property
    def wrong(self) -> str:
        """What is not as it should be; empty where all is."""
        if self.code is None:
            return f"did not end within {PATIENCE_S:g} s"
        if BAD.search(self.said):
            return "" if self.too_early else "a traceback"
        if not self.cooked:
            return "the terminal was left raw"
        if self.left:
            return f"left behind: {', '.join(self.left)}"
        return ""


def _group(leader: int) -> tuple[str, ...]:
    """Processes of a session that still run."""
    listed = subprocess.run(
        ["/bin/ps", "-o", "pid=,stat=,args=", "-s", str(leader)], capture_output=True, text=True, check=False
    ).stdout.splitlines()
    return tuple(row for row in (item.strip() for item in listed) if row and row.split()[1][0] != "Z")


def _flight(program: str, place: str, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """A flight of the same user, listening for orders when this returns."""
    words = [program, *_FLIGHT.split()]
    flight = subprocess.Popen(
        words, cwd=place, env=dict(environment), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    while flight.poll() is None and not list(Path(place, ".gs").rglob("*.sock")):
        time.sleep(0.05)
    return flight


def interrupt(line: str, at_s: float, kit: Path, port: int) -> Seen:
    """Starts a command on a terminal of its own and types Ctrl-C.

    Args:
        line: words after ``gs``.
        at_s: when, seconds after the process was begun.
        kit: folder with what commands read.
        port: a free one.
    """
    with tempfile.TemporaryDirectory() as place:
        for path in kit.iterdir():
            (Path(place) / path.name).write_bytes(path.read_bytes())
        program = str(Path(sys.executable).with_name("gs"))
        words = ["/usr/bin/setsid", "--ctty", program, *shlex.split(line.format(port=port))]
        environment = {
            key: os.environ[key] for key in ("PATH", "LANG", "OPENBLAS_NUM_THREADS", "PYTHONPATH") if key in os.environ
        } | {"HOME": place, "TERM": "xterm", "COLUMNS": "200", "LINES": "50"}
        flight = _flight(program, place, environment) if line.startswith(BESIDE) else None
        terminal, far = pty.openpty()
        begun = time.monotonic()
        child = subprocess.Popen(words, cwd=place, env=environment, stdin=far, stdout=far, stderr=far)
        os.close(far)
        said, code, times = bytearray(), None, 0
        due = begun + at_s
        while time.monotonic() < begun + at_s + PATIENCE_S:
            if times < 3 and time.monotonic() >= due:
                os.write(terminal, b"\x03")
                times, due = times + 1, time.monotonic() + _AGAIN_S
            if select.select([terminal], [], [], 0.01)[0]:
                try:
                    said += os.read(terminal, 65_536)
                except OSError:
                    time.sleep(0.01)  # closed: it is about to end
            code = child.poll()
            if code is not None:
                break
        time.sleep(0.3)
        left = _group(child.pid)
        for row in left:
            os.kill(int(row.split()[0]), signal.SIGKILL)
        child.wait()
        if flight is not None:
            flight.kill()
            flight.wait()
        try:
            cooked = bool(termios.tcgetattr(terminal)[3] & termios.ECHO)
        except termios.error:
            cooked = True
        while select.select([terminal], [], [], 0)[0]:
            try:
                said += os.read(terminal, 65_536)
            except OSError:
                break
        os.close(terminal)
        rests = tuple(
            str(path.relative_to(place))
            for path in Path(place).rglob("*")
            if re.search(r"\.(part|tmp)$|^tmp", path.name)
        )
        return Seen(line, at_s, code, said.decode(errors="replace"), (*left, *rests), cooked)


def main() -> int:
    """Interrupts every command, and says what was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commands", nargs="*", help="beginnings of lines; all where none is named")
    parser.add_argument("--instants", type=int, default=INSTANTS)
    parser.add_argument("--span", type=float, default=SPAN_S, help="seconds")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    lines = [line for line in LINES if not asked.commands or line.startswith(tuple(asked.commands))]
    bad = early = 0
    with tempfile.TemporaryDirectory() as place:
        kit = Path(place)
        for words in (
            "fly --mission first_flight2 --dry-run --log flight.tlog",
            "new formation ring --agents 24 --graph complete -o ring.yaml",
        ):
            subprocess.run(
                [sys.executable, "-m", "groundstation", *words.split()], cwd=kit, check=True, stdout=subprocess.DEVNULL
            )
        jobs = [(line, SPAN_S * index / asked.instants) for line in lines for index in range(asked.instants)]
        with ThreadPoolExecutor(asked.workers) as pool:
            port = iter(range(24_000, 60_000, 10))
            for seen in pool.map(lambda job: interrupt(job[0], job[1], kit, next(port)), jobs):
                if seen.at_s == 0.0:
                    sys.stdout.write(f"gs {seen.line}\n")
                if seen.wrong:
                    bad += 1
                    sys.stdout.write(f"  {seen.at_s:.2f} s, exit {seen.code}: {seen.wrong}\n")
                    if BAD.search(seen.said) or seen.code is None:
                        sys.stdout.write("".join(f"    | {row}\n" for row in seen.said.splitlines()[-40:]))
                else:
                    early += seen.too_early
                    words = ", in Python's own start" if seen.too_early else ""
                    sys.stdout.write(f"  {seen.at_s:.2f} s, exit {seen.code}{words}\n")
                sys.stdout.flush()
    sys.stdout.write(f"{len(jobs)} processes of {len(lines)} lines: {bad} wrong, {early} in Python's own start\n")
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
