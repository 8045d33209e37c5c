"""Autopilots that start anew before their vehicles stand: motors stop, and what is said first afterwards is "disarmed".

One in flight is found by its frame (``Frames``). Told to land, a vehicle may disarm; whether it fell, its new clock
tells, or that it has told nothing of its place since.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from groundstation.core.quick import every, some
from groundstation.core.types import BoolArray, IntArray
from groundstation.mavlink.vehicle import NEVER
from groundstation.mission.monitors.descents import KEEP
from groundstation.mission.monitors.findings import Finding, Lasting, Reaction, Sight
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

_STANDS_S = 1.0  # one that has started anew may say that it stands before it shows where, and that its clock is new
_OLD_S = 0.5
_STARTED_NS = 3 * SECOND_NS  # in which one that has started anew sends a heartbeat


class Restarts:
    """Landings that a restart has ended."""

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._aloft: BoolArray = np.zeros(n, dtype=np.bool_)
        self._stands, self._unshown = Lasting(n, _STANDS_S, again=True), Lasting(n, _STANDS_S)
        self._restarts: IntArray = np.zeros(n, dtype=np.int64)
        self._anew_ns: IntArray = np.full(n, NEVER, dtype=np.int64)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of those that fell."""
        fleet, now_ns = sight.fleet, sight.now_ns
        self._anew_ns[fleet.restarts > self._restarts] = now_ns
        self._restarts = fleet.restarts.copy()
        anew = now_ns - self._anew_ns < _STARTED_NS
        self._aloft |= sight.airborne
        if every(sight.airborne) and not some(sight.excused):  # nobody has come down, nobody is to
            self._stands(~sight.airborne, now_ns)
            self._unshown(sight.excused, now_ns)
            return
        age_ns = now_ns - sight.pose_ns
        silent, old = age_ns > _STANDS_S * SECOND_NS, age_ns > _OLD_S * SECOND_NS
        for vehicle in self._stands(self._aloft & ~(sight.airborne | anew | old), now_ns):
            self._aloft[vehicle] = False
        told = self._aloft & sight.excused & ours & ~sight.blind
        for vehicle in (told & anew & ~fleet.armed).nonzero()[0].tolist():  # an armed one's clock has jumped
            self._aloft[vehicle] = False
            what = "its autopilot has started anew before it stood, so that its motors have stopped in the air"
            yield Finding(Reaction.FAILED, f"{what}; {KEEP}", (vehicle,), lost=True)
        for vehicle in self._unshown(told & ~sight.airborne & silent, now_ns):
            what = "is disarmed, and has told no position since it was in the air; whether it has fallen is not known"
            yield Finding(Reaction.FAILED, f"{what}; {KEEP}", (vehicle,))
