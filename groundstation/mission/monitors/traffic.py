"""Aircraft, and bodies of the motion capture, that are none of the team: told when one comes near, and too near.

What vehicles do about it is avoidance's; one that is faster than they are cannot be kept away from.
"""

from __future__ import annotations

from collections.abc import Iterator

from groundstation.core.types import BoolArray
from groundstation.mission.flight.intruders import NOBODY, Intruders
from groundstation.mission.monitors.findings import Finding, Reaction, Sight
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

_NEAR_S = 15.0  # within which it could be as near as it may be
_NEAR_LEAST_M = 30.0
_BODY_NEAR_S = 1.0
_AGAIN_NS = 20 * SECOND_NS


class TrafficNear:
    """Aircraft near vehicles that fly."""

    def __init__(self, plan: MissionPlan) -> None:
        self._keep_m = plan.obstacles.keep_m
        self._speed_m_s = plan.spec.speed_limit_m_s
        self._told_ns: dict[tuple[str, bool], int] = {}
        self._intruders = NOBODY

    def take(self, intruders: Intruders) -> None:
        """Takes the aircraft of a tick, before ``look``."""
        self._intruders = intruders

    def _near_m(self, comes_m_s: float, *, from_room: bool) -> float:
        """What counts as near, of one that comes so fast."""
        return _BODY_NEAR_S * comes_m_s if from_room else max(_NEAR_LEAST_M, _NEAR_S * comes_m_s)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of each aircraft once in a while, with the vehicle that it is nearest to."""
        flies, intruders = sight.airborne & ours & ~sight.blind, self._intruders
        if not len(intruders) or not flies.any():
            return
        rows = flies.nonzero()[0]
        distance_m, _ = intruders.distances(sight.pos_team_ned_m[rows])
        left_m = distance_m - self._keep_m
        comes_m_s = (intruders.vel_ned_m_s**2).sum(axis=1) ** 0.5 + self._speed_m_s
        for k, name in enumerate(intruders.names):
            from_room = k >= len(intruders) - intruders.from_room
            nearest = int(left_m[:, k].argmin())
            least_m = float(left_m[nearest, k])
            near, too_near = least_m < self._near_m(float(comes_m_s[k]), from_room=from_room), least_m < 0.0
            if not near or sight.now_ns - self._told_ns.get((name, too_near), -_AGAIN_NS) < _AGAIN_NS:
                continue
            self._told_ns[name, too_near] = sight.now_ns
            away_m = least_m + self._keep_m + float(intruders.radius_m[k])
            digits = 2 if from_room else 0
            words = f"body {name} is" if from_room else f"aircraft {name} is"
            words += f" {away_m:.{digits}f} m away{'' if from_room else ' (ADS-B)'}"
            if too_near:
                least = self._keep_m + float(intruders.radius_m[k])
                words += f", minimum is {least:.{digits}f} m; it is faster than the team can make room: "
                words += "have it go away, or land" if from_room else "land, or bring it home"
            else:
                words += "; the team keeps out of its way"
            yield Finding(Reaction.SAY, words, (int(rows[nearest]),))
