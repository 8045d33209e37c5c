"""Monitors of what one message says against all others: somebody else speaks in a vehicle's name, or it is broken.

What is contradicted is not believed, it is told, and everybody comes back: under whose setpoints the vehicle is stays
as it was, so that nobody who flies is left alone for one false word. Senders that take turns are found by ``Frames``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from groundstation.core import frames
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.kinds import Kind
from groundstation.mavlink.vehicle import LANDED_ON_GROUND
from groundstation.mission.monitors.findings import OWN_ID, Finding, Lasting, Reaction, Sight
from groundstation.mission.plan.plan import MissionPlan

_BESIDE_S = 1.5  # longer than any of the messages takes to follow the others
_OF_HEIGHT = 0.5  # of the takeoff height: who is higher above its pad does not stand on it
_FIND = "find who else speaks on its link, or what is wrong with it"
_OF_MARGIN = 2.0  # times what positions are off


class Contradictions:
    """Words of one message against all others.

    Attributes:
        flies: reports to stand on the ground and is seen above its pad, shape (n,).
        above: is seen above its pad, whatever it reports, shape (n,).
    """

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._pads_ned_m: FloatArray = frames.ned_from_enu(plan.pads_enu_m)
        self._height_m = max(_OF_HEIGHT * plan.spec.takeoff.height_m, _OF_MARGIN * plan.margin_m)
        self._doubts, self._kinds = Lasting(n, _BESIDE_S), Lasting(n)
        self._highs = Lasting(n, _BESIDE_S, again=True)
        self.flies: BoolArray = np.zeros(n, dtype=np.bool_)
        self.above: BoolArray = np.zeros(n, dtype=np.bool_)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of what cannot be, and brings everybody back."""
        fleet = sight.fleet
        counts = ours & ~sight.excused
        height_m = (self._pads_ned_m - sight.pos_team_ned_m)[:, 2]
        self.above = (height_m > self._height_m) & ours & ~sight.blind
        stands = fleet.landed_state == LANDED_ON_GROUND
        for vehicle in self._doubts(fleet.disarm_doubted & counts, sight.now_ns):
            seen = "its landed state that it flies"
            if stands[vehicle]:
                seen = f"its landed state that it stands, {height_m[vehicle]:.1f} m above its pad"
            what = f"its heartbeats say disarmed, {seen}; it counts as flying"
            yield Finding(Reaction.ALL_HOME, what, (vehicle,), remedy=_FIND)
        high = stands & fleet.armed & self.above & counts
        found = self._highs(high, sight.now_ns)
        self.flies &= high
        self.flies[found] = True
        for vehicle in found:
            if fleet.disarm_doubted[vehicle]:
                continue  # told above
            what = f"says that it stands on the ground, {height_m[vehicle]:.1f} m above its pad; it counts as flying"
            yield Finding(Reaction.ALL_HOME, what, (vehicle,), remedy=_FIND)
        if fleet.senders.all_alike:  # nothing was ever told of anybody
            return
        strange = {row: fleet.senders.strange_kind(row, sight.now_ns) for row in ours.nonzero()[0].tolist()}
        told = np.array([strange.get(row) is not None for row in range(len(fleet))])
        for vehicle in self._kinds(told, sight.now_ns):
            kind = strange[vehicle]
            if kind is not None:
                own = Kind(int(fleet.mav_type[vehicle]), int(fleet.autopilot[vehicle]))
                what = f"heartbeats of a {kind.words} come under its id, it is a {own.words}; they count for nothing"
                yield Finding(Reaction.ALL_HOME, what, (vehicle,), remedy=OWN_ID)
