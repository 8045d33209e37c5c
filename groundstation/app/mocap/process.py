"""The motion capture process of a flight: begun with it, and ending with whoever needs its frames last.

That is the flight, or its gateway, which brings vehicles down when the flight was killed. Both hold the writing end of
a pipe that the process reads: the last one that ends ends it, however that happens.
"""

from __future__ import annotations

import fcntl
import os
import select
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from groundstation.core.extras import need
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.positioning_spec import PositioningSpec

_END_S = 2.0


@contextmanager
def reading(plan: MissionPlan) -> Iterator[tuple[int, ...]]:
    """Reads the mission's motion capture system beside the block, where the mission names one.

    Yields:
        Descriptors; whoever holds one keeps the process.

    Raises:
        UserError: the package that reads it is not installed.
    """
    given = plan.spec.positioning
    if not isinstance(given, PositioningSpec) or given.system is None or given.host is None:
        yield ()
        return
    need("mocap", f"positioning.system: {given.system}")
    words = [
        "--system",
        given.system,
        "--host",
        given.host,
        "--link",
        given.link,
        "--up",
        given.up,
        "--unit",
        given.unit,
    ]
    for vehicle in plan.spec.vehicles if given.bodies == "name" else ():
        words += ["--body", f"{vehicle.body_name}={vehicle.id}"]
    for item in given.obstacles:
        words += ["--obstacle", item.body]
    package = Path(__file__).parents[2]
    command = [sys.executable, "-m", package.name, "mocap", "read", *words, "--kept"]
    ends, holds = os.pipe()
    try:
        child = subprocess.Popen(command, cwd=package.parent, stdin=ends, start_new_session=True)  # noqa: S603
    finally:
        os.close(ends)
    try:
        yield (holds,)
    finally:
        os.close(holds)
        with suppress(subprocess.TimeoutExpired):  # its gateway may have somebody in the air
            child.wait(_END_S)


def end_with_stdin() -> None:
    """Has the system end this process when nobody holds the other end of its standard input any more.

    By the system, because the package that reads may wait in a library of its own, where no other thread runs.
    """
    fcntl.fcntl(0, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(0, fcntl.F_SETFL, fcntl.fcntl(0, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([0], [], [], 0.0)[0]:  # nothing is ever written: it has ended before
        raise SystemExit(0)
