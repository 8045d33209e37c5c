"""GPS receivers that have lost their fix in the air: what is told of a position from then on is a guess.

An estimator goes on telling positions, carried on by its accelerometers alone, and for seconds calls them as good as
before: PX4 1.16 in its simulator was 0.4 m off in 3 s, 1.6 m in 5 s and 2.4 m in 6 s, when it said a word for the first
time and came down. The receiver says at once that it has no fix.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from groundstation.core.quick import some
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.vehicle import UNKNOWN
from groundstation.mission.monitors.findings import Finding, Lasting, Reaction, Sight
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

_LASTS_S = 1.0  # a receiver may miss one; after as long, and a report, the position is off by 0.2 m
_REPORTS = 3.0  # a receiver that has told nothing for so many is not heard any more
_FIX_3D = 3  # GPS_FIX_TYPE_3D_FIX; better ones are larger
_WORDS = {0: "no receiver", 1: "no fix", 2: "a fix without height"}
_REMEDY = "see to its GPS antenna, and to what is above it"


class GpsFix:
    """Vehicles whose place comes from GPS, and whose receivers have none any more."""

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._gps: BoolArray = np.array([plan.uses_gps(vehicle) for vehicle in range(n)])
        heard_s: FloatArray = np.array([_REPORTS / plan.rates_of(vehicle).fix_hz for vehicle in range(n)])
        self._heard_ns = np.rint(heard_s * SECOND_NS).astype(np.int64)
        self._had: BoolArray = np.zeros(n, dtype=np.bool_)
        self._lasting = Lasting(n, _LASTS_S)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Lands those without a fix, while where they are is still known; one of two receivers is enough."""
        if not some(self._gps):
            return
        fleet = sight.fleet
        heard = (fleet.gps_fix != UNKNOWN) & (sight.now_ns - fleet.gps_fix_ns < self._heard_ns)
        fixed = (heard & (fleet.gps_fix >= _FIX_3D)).any(axis=0)
        self._had |= fixed & self._gps
        gone = self._had & heard.any(axis=0) & ~fixed & sight.airborne & ~sight.blind & ours
        for vehicle in self._lasting(gone, sight.now_ns):
            fix = int(fleet.gps_fix[heard[:, vehicle], vehicle].max())
            what = f"its GPS has had {_WORDS[fix]} for {_LASTS_S:g} s, so that its position is a guess"
            reaction = Reaction.LAND
            if sight.excused[vehicle]:
                reaction, what = Reaction.FAILED, f"{what}; it lands by it, keep people away"
            yield Finding(reaction, what, (vehicle,), lost=True, remedy=_REMEDY)
