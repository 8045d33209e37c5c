"""Whose position is lost, since when, and who is found again.

A position that contradicted itself is lost for good. One of which merely nothing was heard counts again once it has
been told for a while, from a place that the vehicle could have reached: it can be led to a free place then, instead of
coming down where it was last seen.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.quick import norms, some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mission.monitors.findings import Finding, Reaction, Sight
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS, HeldEach

_FOUND_NS = 2 * SECOND_NS  # so long it has to be heard without a gap


class Losses:
    """Positions of one team that are lost.

    Attributes:
        blind: nobody knows where these are now, shape (n,).
        since_ns: since when, of those, shape (n,).
        unheard: those of them that are lost since nothing is heard, and for no other reason, shape (n,).
    """

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._speed_m_s, self._jump_m = plan.spec.speed_limit_m_s, plan.limits.pose_jump_m
        self._fresh_ns = round(plan.spec.limits.pose_age_s * SECOND_NS)
        self._heartbeat_age_s = plan.spec.limits.heartbeat_age_s
        self.blind: BoolArray = np.zeros(n, dtype=np.bool_)
        self.since_ns: IntArray = np.zeros(n, dtype=np.int64)
        self.unheard: BoolArray = np.zeros(n, dtype=np.bool_)
        self._seen_ned_m: FloatArray = np.full((n, 3), np.nan)
        self._seen_ns: IntArray = np.zeros(n, dtype=np.int64)
        self._back = HeldEach(n)

    def lose(self, rows: list[int], sight: Sight, *, unheard: bool) -> None:
        """Positions are lost from now on.

        Args:
            rows: whose.
            sight: of this tick.
            unheard: nothing was heard of them, and nothing else speaks against what they say.
        """
        new = [row for row in rows if not self.blind[row]]
        self.since_ns[new] = sight.now_ns
        self._seen_ned_m[new], self._seen_ns[new] = sight.pos_team_ned_m[new], sight.pose_ns[new]
        self.unheard[new] = unheard
        self.blind[new] = True
        if not unheard:
            self.unheard[rows] = False

    def find(self, sight: Sight, suspect: BoolArray) -> list[Finding]:
        """Takes back those that are heard again; once per tick, before the monitors look.

        Args:
            sight: of this tick.
            suspect: whose positions are not to be trusted for another reason, shape (n,).

        Returns:
            One line for each.
        """
        if not some(self.unheard):
            return []
        fleet, now_ns = sight.fleet, sight.now_ns
        gone_s = (now_ns - self._seen_ns) / SECOND_NS
        gone_m = norms(sight.pos_team_ned_m - self._seen_ned_m)
        back = self.unheard & sight.ours & (now_ns - sight.pose_ns <= self._fresh_ns) & ~suspect
        back &= gone_m <= self._jump_m + self._speed_m_s * gone_s  # NaN is not
        back &= ~fleet.heartbeat_stale(now_ns, self._heartbeat_age_s) & ~fleet.senders.in_doubt(now_ns)
        found = self._back(back, now_ns, _FOUND_NS)
        self.blind &= ~found
        self.unheard &= ~found
        findings = []
        for row in found.nonzero()[0].tolist():
            what = f"its position is told again, {gone_m[row]:.1f} m from where it was last seen"
            findings.append(Finding(Reaction.SAY, what if sight.excused[row] else f"{what}; it is led again", (row,)))
        return findings
