"""How far positions have gone that no velocity explains: once one has begun to, it is kept, and no longer forgotten.

A position that creeps is told from a velocity that is a little off by how fast the two part. From the moment at which
they part too fast all of it counts, so that a slow drift is found as well, and in the end can be said how far from its
place a vehicle may stand. Which of the two is wrong is for others to judge.
"""

from __future__ import annotations

import numpy as np

from groundstation.core import frames
from groundstation.core.quick import every, norms, some
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.flight.poses import Poses
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SinceBefore

_TRAIL_S = 10.0  # so far back a drift that is found now may have begun
_ENDS = 0.5  # of the limit: below it they part no more
_ABSURD_M = 1000.0
_QUICK = 0.4  # of pose_jump_m: by GPS 0.65 to 0.8 m; seen of PX4's shaken simulator: 0.66 m, of quiet ones 0.29 m
_GOOD_M, _LEAST_M, _LATE_S = 0.1, 0.3, 0.2  # where positions are better: by motion capture 0.3 m; badly known time
_BESIDE_M = 0.3  # and what positions are off: who is farther from its pad does not stand on it
_SANE_M_S, _SANE_SPEEDS = 2.5, 1.5  # landing vehicles sink no faster; times the speed limit
_REACH_S = 0.5


class Drifts:
    """What n positions have gone besides their velocities.

    Attributes:
        gone_ned_m: what was kept, shape (n, 3); zero for those that never drifted.
        drifting: those that do at the moment, shape (n,).
    """

    def __init__(self, n: int) -> None:
        self.gone_ned_m: FloatArray = np.zeros((n, 3))
        self.drifting: BoolArray = np.zeros(n, dtype=np.bool_)
        self._trail_m: FloatArray = np.zeros((n, 3))

    @property
    def gone_m(self) -> FloatArray:
        """How far that is, shape (n,)."""
        return norms(self.gone_ned_m)

    def take(self, more_m: FloatArray, faded: float, begins: BoolArray, ends: BoolArray) -> None:
        """Takes what positions have gone since the tick before.

        Args:
            more_m: besides their velocities, shape (n, 3); zero for those that do not count.
            faded: what is left by now of what they had gone before.
            begins: parts from its velocity as positions do not, and counts, shape (n,).
            ends: hardly parts any more, shape (n,).
        """
        self._trail_m = self._trail_m * faded + more_m
        begins = begins & ~self.drifting
        if some(begins) or some(self.drifting):
            self.gone_ned_m += np.where(self.drifting[:, None], more_m, np.where(begins[:, None], self._trail_m, 0.0))
            self._trail_m[self.drifting] = 0.0
        self.drifting = (self.drifting | begins) & ~ends


class _Steps:
    """How far n positions go in a tick that their velocities do not explain."""

    def __init__(self, n: int) -> None:
        self._pos: FloatArray = np.full((n, 3), np.nan)
        self._vel: FloatArray = np.zeros((n, 3))

    def take(self, poses: Poses, counts: BoolArray, passed_s: float) -> FloatArray:
        """Takes the poses of a tick, as reported; returns that, shape (n, 3).

        Args:
            poses: as reported.
            counts: in the air and reported of late, shape (n,): what is carried on by its velocity cannot part from it.
            passed_s: since the tick before.
        """
        pos_ned_m, vel_ned_m_s = poses.pos_team_ned_m, poses.vel_ned_m_s
        more_m = pos_ned_m - self._pos - 0.5 * passed_s * (self._vel + vel_ned_m_s)
        # Not with what is no number; what is absurd comes and goes in two ticks, and both are left out.
        told = counts & (norms(more_m) < _ABSURD_M)
        if every(told):
            self._pos, self._vel = pos_ned_m.copy(), vel_ned_m_s.copy()
            return more_m
        self._pos = np.where(counts[:, None], pos_ned_m, np.nan)
        self._vel = vel_ned_m_s.copy()
        return np.where(told[:, None], more_m, 0.0)


class Astray:
    """Where vehicles may be whose positions drift, and how far from their pads they may stand in the end.

    Args:
        plan: limits, pads.

    Attributes:
        drifts: how far positions have gone.
    """

    def __init__(self, plan: MissionPlan) -> None:
        limit_m = plan.limits.pose_jump_m
        self.drifts, self._early = Drifts(plan.size), Drifts(plan.size)
        self._steps, self._since_step = _Steps(plan.size), SinceBefore()
        quick_m = max(limit_m - plan.margin_m, _QUICK * limit_m)
        good_m = _GOOD_M + plan.margin_m + _LATE_S * plan.spec.speed_limit_m_s
        self._quick_m = min(quick_m, max(good_m, _LEAST_M))
        self._beside_m = _BESIDE_M + plan.margin_m
        self._sane_m_s = max(_SANE_M_S, _SANE_SPEEDS * plan.spec.speed_limit_m_s)
        self._pads_ned_m: FloatArray = frames.ned_from_enu(plan.pads_enu_m)
        self._off_m: FloatArray = np.zeros(plan.size)
        self._led: BoolArray = np.zeros(plan.size, dtype=np.bool_)
        self._since_before = SinceBefore()

    def take(self, poses: Poses, counts: BoolArray, good: BoolArray, away_m: FloatArray, now_ns: int) -> FloatArray:
        """Takes the poses of a tick, as reported; returns how far those have gone that drift now, shape (n,).

        Args:
            poses: as reported.
            counts: in the air and reported of late, without a gap, shape (n,).
            good: those of them whose velocities were good until now, shape (n,).
            away_m: how far position and velocity have parted within the last seconds, shape (n,).
            now_ns: time of the tick.
        """
        drifts, pos_ned_m = self.drifts, poses.pos_team_ned_m
        passed_s = self._since_step(now_ns)
        more_m, faded = self._steps.take(poses, counts, passed_s), float(np.exp(-passed_s / _TRAIL_S))
        begins, ends = counts & (away_m > self._quick_m), away_m < _ENDS * self._quick_m
        drifts.take(more_m, faded, begins & good, ends)
        self._early.take(more_m, faded, begins & ~good, ends)
        gone_m = drifts.gone_m
        # From its pad it is as far as it says, or as its velocity has led it.
        says_m = (pos_ned_m - self._pads_ned_m)[:, :2]
        led_m = says_m - drifts.gone_ned_m[:, :2]
        off_m = np.maximum(norms(says_m), norms(led_m)) + self._quick_m
        self._off_m = np.where(counts & (gone_m > 0.0), off_m, self._off_m)
        return np.where(drifts.drifting, gone_m, 0.0)

    def own_up(self, calm: BoolArray) -> None:
        """Of those whose velocities prove to be good, shape (n,), it was the position that went astray before."""
        if not np.count_nonzero(self._early.gone_ned_m):  # mostly nothing has
            return
        rows = calm & ~self._early.drifting
        self.drifts.gone_ned_m[rows] += self._early.gone_ned_m[rows]
        self._early.gone_ned_m[rows] = 0.0

    def lead_on(
        self, pos_ned_m: FloatArray, vel_ned_m_s: FloatArray, poses: Poses, lost: BoolArray, now_ns: int
    ) -> None:
        """Moves trusted places as velocities lead, in place, as long as these are no wilder than vehicles fly.

        Args:
            pos_ned_m: trusted places, shape (n, 3).
            vel_ned_m_s: by which they are carried on besides, shape (n, 3); zero from now on for those that are led.
            poses: as reported.
            lost: whose position is not believed any more, and is still reported, shape (n,).
            now_ns: time of the tick.
        """
        passed_s = min(self._since_before(now_ns), _REACH_S)
        if not some(lost):
            return
        rows = lost & (norms(poses.vel_ned_m_s) <= self._sane_m_s)
        pos_ned_m[rows] += passed_s * poses.vel_ned_m_s[rows]
        led_m = poses.pos_team_ned_m - self.drifts.gone_ned_m
        first = rows & ~self._led & self.drifts.drifting & np.isfinite(led_m).all(axis=1)
        pos_ned_m[first] = led_m[first]
        vel_ned_m_s[rows] = 0.0
        self._led |= rows

    def may_stand_off_m(self, vehicle: int, *, lost: bool) -> tuple[float, float] | None:
        """How far from its pad one may stand, and how far its position has gone; None where it may stand on it."""
        off_m, gone_m = float(self._off_m[vehicle]), float(self.drifts.gone_m[vehicle])
        # What had parted before it was found to drift is known by half.
        astray_m = off_m if lost else gone_m + 0.5 * self._quick_m if gone_m > 0.0 else 0.0
        return (off_m, gone_m) if astray_m > self._beside_m else None
