"""The motion capture process of a flight: begun with it, watched, replaced when it dies, ending with whoever needs it.

That is the flight, or its gateway, which brings vehicles down when the flight was killed. Both hold the writing end of
a pipe that the process reads: the last one that ends ends it, however that happens. A second process waits, loaded and
not connected, so that frames go on before everybody comes down for want of them (0.5 s).
"""

from __future__ import annotations

import fcntl
import os
import select
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from groundstation.app.session import Session
from groundstation.core.extras import need
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.positioning_spec import PositioningSpec

_END_S = 2.0
_SPARE_NS = 5_000_000_000  # the one that reads has the machine to itself while it connects
_AGAIN_NS, _AGAIN_MAX_NS = 1_000_000_000, 16_000_000_000
_BEGIN = b"."


class Reading:
    """One process that reads the system, or waits to.

    Args:
        command: of it.
        ends: descriptor that it ends with.
    """

    def __init__(self, command: Sequence[str], ends: int) -> None:
        begins, self._begin = os.pipe()
        try:
            self.process = subprocess.Popen(  # noqa: S603 - our own program
                [*command, "--begins-by", str(begins)], cwd=Path(__file__).parents[3], stdin=ends,
                start_new_session=True, pass_fds=(begins,),
            )  # fmt: skip
        finally:
            os.close(begins)

    def begin(self) -> None:
        """Lets it connect."""
        with suppress(OSError):  # it has died in the meantime, and is replaced
            os.write(self._begin, _BEGIN)

    def close(self) -> None:
        """Lets go of it; one that has not begun ends."""
        os.close(self._begin)


class RoomKeeper:
    """The motion capture of one flight; a ``Control`` of its loop.

    Args:
        starts: starts a process that waits.
        name: of the system, for people.
    """

    def __init__(self, starts: Callable[[], Reading], name: str) -> None:
        self._starts, self._name = starts, name
        self._reads = starts()
        self._waits: Reading | None = None
        self._began_ns: int | None = None
        self._died_ns: int | None = None
        self._again_ns = _AGAIN_NS
        self._reads.begin()

    @property
    def pid(self) -> int:
        """Of the process that reads."""
        return self._reads.process.pid

    def sources(self) -> Sequence[int]:
        """It says nothing here."""
        return ()

    def read(self) -> None:
        """It says nothing here."""

    def apply(self, session: Session, now_ns: int) -> None:
        """Puts another in its place when it has died."""
        self._began_ns = now_ns if self._began_ns is None else self._began_ns
        code = self._reads.process.poll()
        if code is None:
            if self._waits is None and now_ns - self._began_ns >= _SPARE_NS:
                self._waits = self._starts()
            return
        if self._died_ns is not None and now_ns - self._died_ns < self._again_ns:
            return
        short = self._died_ns is not None and now_ns - self._died_ns < _SPARE_NS + self._again_ns
        self._again_ns = min(2 * self._again_ns, _AGAIN_MAX_NS) if short else _AGAIN_NS
        self._died_ns = self._began_ns = now_ns
        how = f"killed by signal {-code}" if code < 0 else f"it ended with {code}"
        session.remark(
            "alarm", f"what reads the motion capture ({self._name}) has gone ({how}); another one begins", now_ns
        )
        self._reads.close()
        self._reads, self._waits = self._waits or self._starts(), None
        self._reads.begin()

    def answer(self, session: Session) -> None:
        """It asks nothing."""

    def close(self) -> None:
        """The flight is over: who waits ends; who reads ends with the last that holds it."""
        if self._waits is not None:
            self._waits.close()
            with suppress(subprocess.TimeoutExpired):
                self._waits.process.wait(_END_S)
        with suppress(subprocess.TimeoutExpired):  # its gateway may have somebody in the air
            self._reads.process.wait(_END_S)
        self._reads.close()


@contextmanager
def reading(plan: MissionPlan) -> Iterator[tuple[tuple[int, ...], tuple[RoomKeeper, ...]]]:
    """Reads the mission's motion capture system beside the block, where the mission names one.

    Yields:
        Descriptors, whoever holds one keeps the process; and who watches it.

    Raises:
        UserError: the package that reads it is not installed.
    """
    given = plan.spec.positioning
    if not isinstance(given, PositioningSpec) or given.system is None or given.host is None:
        yield (), ()
        return
    need("mocap", f"positioning.system: {given.system}")
    words = ["--system", given.system, "--host", given.host, "--link", given.link]
    words += ["--up", given.up, "--unit", given.unit]
    for vehicle in plan.spec.vehicles if given.bodies == "name" else ():
        words += ["--body", f"{vehicle.body_name}={vehicle.id}"]
    for item in given.obstacles:
        words += ["--obstacle", item.body]
    command = [sys.executable, "-m", Path(__file__).parents[2].name, "mocap", "read", *words, "--kept"]
    ends, holds = os.pipe()
    try:
        keeper = RoomKeeper(lambda: Reading(command, ends), f"{given.system} at {given.host}")
        try:
            yield (holds,), (keeper,)
        finally:
            os.close(holds)
            keeper.close()
    finally:
        os.close(ends)


def begins_by(descriptor: int) -> bool:
    """Waits for the word to begin; returns False where whoever would give it has ended."""
    with open(descriptor, "rb", buffering=0) as word:
        return word.read(1) == _BEGIN


def end_with_stdin() -> None:
    """Has the system end this process when nobody holds the other end of its standard input any more.

    By the system, because the package that reads may wait in a library of its own, where no other thread runs. Opened
    once more, because who is told stands with what is open, and another one that waits has the same standard input.
    """
    own = os.open("/proc/self/fd/0", os.O_RDONLY | os.O_NONBLOCK)
    fcntl.fcntl(own, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(own, fcntl.F_SETFL, fcntl.fcntl(own, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([own], [], [], 0.0)[0]:  # nothing is ever written: it has ended before
        raise SystemExit(0)
