"""How much processor time a dry run takes against the time that it flies, and how many calls a tick makes.

Processor time of this process alone: what else the machine does counts little, the start of the program not at all.
Calls are counted in a flight of their own, since counting them costs.
"""

from __future__ import annotations

import statistics
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from types import FrameType

from groundstation.app.emulator import world_config
from groundstation.app.loop import Interrupts, fly_virtual
from groundstation.app.opening import open_flight
from groundstation.app.output import Output
from groundstation.app.resources import find_config
from groundstation.app.session import Session
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from sitl.world import World

_MISSIONS = ("cube8.yaml", "first_flight2.yaml")
_ROUNDS = 5


def run(out: Output) -> dict[str, float | int]:
    """Measures and returns the figures of each mission; medians over several rounds, with the least and the most."""
    values: dict[str, float | int] = {"rounds": _ROUNDS}
    for mission in _MISSIONS:
        plan = load_mission(find_config(Path(mission), "missions"))
        name = plan.spec.name
        flights = []
        for number in range(_ROUNDS):
            out.console.print(f"{name}: round {number + 1} of {_ROUNDS}")
            flights.append(_fly(plan))
        flown_s, used_s = flights[0][0], [used for _, used in flights]
        factors = [flown_s / used for used in used_s]
        values |= {
            f"{name}_vehicles": plan.size,
            f"{name}_flown_s": flown_s,
            f"{name}_processor_s": statistics.median(used_s),
            f"{name}_times_real_time": statistics.median(factors),
            f"{name}_times_real_time_least": min(factors),
            f"{name}_times_real_time_most": max(factors),
            f"{name}_calls_per_tick": _calls_per_tick(plan),
        }
    return values


def _ready(plan: MissionPlan) -> tuple[Session, World, int]:
    """A flight that has not begun, its emulator, and the period of its ticks in ns."""
    session = open_flight(ExitStack(), plan, make=Session).session
    return session, World(world_config(plan, 0), 0), round(1e9 / plan.spec.rate_hz)


def _fly(plan: MissionPlan) -> tuple[float, float]:
    """Flies once; returns the seconds that were flown, from the first byte on, and those of the processor."""
    session, world, period_ns = _ready(plan)
    start_s = time.process_time()
    fly_virtual(session, world, period_ns=period_ns, watchers=(), interrupts=Interrupts())
    return session.runner.figures.ticks * period_ns / 1e9, time.process_time() - start_s


def _calls_per_tick(plan: MissionPlan) -> int:
    """Calls of functions, in Python and built in, that one tick makes on both sides together; the same every time."""
    session, world, period_ns = _ready(plan)
    calls = 0

    def count(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        fly_virtual(session, world, period_ns=period_ns, watchers=(), interrupts=Interrupts())
    finally:
        sys.setprofile(before)
    return round(calls / session.runner.figures.ticks)
