"""Vehicles that come down by themselves with somebody below: an autopilot that lands at its own word asks nobody.

Nothing stops it. Those below leave its column (``Guide``) as long as setpoints are what they follow: not once they are
told to land, and not while a take-over lets everybody stand. People have to know of all of them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from groundstation.core.quick import some
from groundstation.core.types import BoolArray
from groundstation.mavlink.vehicle import LANDED_LANDING
from groundstation.mission.monitors.findings import Finding, LastingOf, Reaction, Sight
from groundstation.mission.monitors.vehicles import Modes
from groundstation.mission.plan.plan import MissionPlan

_SINKS_M_S = 0.25  # slower than any landing, faster than one that hovers


class Sinking:
    """Autopilots that come down onto somebody, though nobody told them to land."""

    def __init__(self, plan: MissionPlan, modes: Modes) -> None:
        n = plan.size
        self._modes = modes
        # Pads may be exactly r apart, and positions are off by something.
        self._beside_m = max(plan.spec.avoidance.radius_m - plan.margin_m, 0.5 * plan.spec.avoidance.radius_m)
        self._by_itself: BoolArray = np.zeros(n, dtype=np.bool_)
        self._told = LastingOf()

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells who comes down by itself, and who is below; where the first is not ours, those below are told of it."""
        fleet, n = sight.fleet, len(sight.fleet)
        modes = self._modes
        by_itself = (self._by_itself & modes.foreign) | (modes.foreign & ~modes.waits & ~sight.excused)
        self._by_itself = by_itself & fleet.armed
        if not some(self._by_itself):
            return
        stands = ~sight.airborne
        sinks = (sight.vel_ned_m_s[:, 2] > _SINKS_M_S) | (fleet.landed_state == LANDED_LANDING)
        sinks &= self._by_itself & ~stands & ~sight.blind
        rows = sinks.nonzero()[0]
        away_m = sight.pos_team_ned_m[None] - sight.pos_team_ned_m[rows, None]  # from who sinks to who is below
        beside_m, below_m = np.hypot(away_m[..., 0], away_m[..., 1]), away_m[..., 2]
        above, others = ((below_m > 0.0) & (beside_m < self._beside_m) & (rows[:, None] != np.arange(n))).nonzero()
        of_pair = dict(zip((rows[above] * n + others).tolist(), above.tolist(), strict=True))
        leaves = (sight.steered | sight.lands_here) & ~(sight.excused | stands | sight.blind | self._by_itself)
        for pair in self._told(list(of_pair), sight.now_ns):
            row, (who, other) = of_pair[pair], divmod(pair, n)
            below, beside = f"{below_m[row, other]:.1f} m", f"{beside_m[row, other]:.2f} m beside"
            can_leave = ours[other] and leaves[other]
            if ours[who]:
                then = "which gets out of the way" if can_leave else "and cannot be told to leave; keep people away"
                what = f"comes down by itself, vehicle {fleet.ids[other]} is {below} below and {beside}, {then}"
                yield Finding(Reaction.SAY, what, (who,))
            else:
                then = "it gets out of the way" if can_leave else "it cannot be told to leave; keep people away"
                what = f"vehicle {fleet.ids[who]} comes down by itself {below} above and {beside}, {then}"
                yield Finding(Reaction.SAY, what, (other,))


class OntoHeld:
    """The same while a take-over lets everybody stand still.

    It has modes of its own to look at: what is so then counts for nothing later.
    """

    def __init__(self, plan: MissionPlan) -> None:
        self._modes = Modes(plan)
        self._sinking = Sinking(plan, self._modes)

    def words(self, sight: Sight) -> list[str]:
        """Words for those that come down onto somebody.

        Args:
            sight: what is to be seen; nobody is steered.
        """
        list(self._modes.look(sight, sight.ours))  # what it finds is the take-over's to tell
        found = self._sinking.look(sight, sight.ours)
        return [f"vehicle {sight.fleet.ids[finding.vehicles[0]]}: {finding.what}" for finding in found]
