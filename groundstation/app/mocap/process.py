"""The motion capture process of a flight: begun with it, told to end with it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from groundstation.core.extras import need
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.positioning_spec import PositioningSpec

_END_S = 2.0


@contextmanager
def reading(plan: MissionPlan) -> Iterator[None]:
    """Reads the mission's motion capture system beside the block, where the mission names one.

    Raises:
        UserError: the package that reads it is not installed.
    """
    given = plan.spec.positioning
    if not isinstance(given, PositioningSpec) or given.system is None or given.host is None:
        yield
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
    package = Path(__file__).parents[2]
    command = [sys.executable, "-m", package.name, "mocap", "read", *words]
    child = subprocess.Popen(command, cwd=package.parent, stdin=subprocess.DEVNULL, start_new_session=True)  # noqa: S603
    try:
        yield
    finally:
        child.terminate()
        try:
            child.wait(_END_S)
        except subprocess.TimeoutExpired:
            child.kill()
