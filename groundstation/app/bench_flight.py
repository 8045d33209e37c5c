"""How fast the flight path is: dry run against flight time, tick against its period."""

from __future__ import annotations

import statistics
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from groundstation.app.emulator import world_config
from groundstation.app.loop import Interrupts, fly_virtual
from groundstation.app.opening import open_flight
from groundstation.app.output import Output
from groundstation.app.resources import find_config
from groundstation.app.session import Session
from groundstation.mavlink.gate import Gate
from groundstation.mavlink.station import Outgoing
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.runner import Runner
from groundstation.records.tlog import TlogWriter
from sitl.world import World

_ROUNDS = 5


class _TimedSession(Session):
    """A session that takes the time of every tick."""

    def __init__(self, runner: Runner, log: TlogWriter | None, gate: Gate | None) -> None:
        super().__init__(runner, log, gate)
        self.tick_s: list[float] = []

    def tick(self, now_ns: int) -> list[Outgoing]:
        """Steps the runner."""
        start = time.perf_counter()
        outgoing = super().tick(now_ns)
        self.tick_s.append(time.perf_counter() - start)
        return outgoing


def run(out: Output) -> dict[str, float | int]:
    """Measures and returns the figures; medians over several rounds."""
    del out
    plan = load_mission(find_config(Path("cube8.yaml"), "missions"))
    period_s = 1.0 / plan.spec.rate_hz
    speed, tick_median, tick_worst = [], [], []
    for seed in range(_ROUNDS):
        session = open_flight(ExitStack(), plan, make=_TimedSession).session
        world = World(world_config(plan), seed)
        start = time.perf_counter()
        fly_virtual(session, world, period_ns=round(period_s * 1e9), watchers=(), interrupts=Interrupts())
        wall_s = time.perf_counter() - start
        speed.append(session.runner.figures.ticks * period_s / wall_s)
        tick_median.append(statistics.median(session.tick_s) / period_s)
        tick_worst.append(float(np.quantile(session.tick_s, 0.999)) / period_s)
    return {
        "vehicles": plan.size,
        "rounds": _ROUNDS,
        "dry_run_times_real_time": statistics.median(speed),
        "tick_over_period_median": statistics.median(tick_median),
        "tick_over_period_p999": statistics.median(tick_worst),
    }
