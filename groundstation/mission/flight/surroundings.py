"""What each agent has around it, from poses alone: where others are taken to be, who is near enough to hit.

Asked twice in a tick when somebody flies apart; worked out once. Knows nothing of what anybody wishes.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.damper import DamperParams, fitting_margin_m
from groundstation.core.quick import between, norms, some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mission.flight.poses import OncePerPoses, Poses
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.positioning import DEVIATIONS

_LEVEL_MIN_M = 1e-3  # nearer than that there is no direction to leave in


class Surroundings:
    """Where others are for each agent of a team.

    Args:
        plan: of the mission.
        damper: radius, margin and rates of the damper.
        reach_m: how far everybody has to be seen at least.
        margin_m: what is added to r.
        everyone: columns of all, shape (n, n), or (1, n) in large teams.

    Attributes:
        everyone: the same.
        of_all: where all others are taken to be, whom that moves (``shown``), and who is near enough to hit, (n, n).
        reach_m: how far vehicles have to be seen that are no obstacles.
    """

    def __init__(
        self, plan: MissionPlan, damper: DamperParams, reach_m: float, margin_m: float, everyone: IntArray
    ) -> None:
        self._plan, self._damper, self._least_m, self._margin_m = plan, damper, reach_m, margin_m
        self.everyone = everyone
        self.of_all = OncePerPoses(self._look_around)
        self.reach_m = OncePerPoses(self._find_reach_m)
        self._wider_of_all = OncePerPoses(lambda poses: self._find_wider_m(poses, everyone))

    def _look_around(self, poses: Poses) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Where all others are taken to be, whom that moves (``_shown``), and who is near enough to hit, (n, n)."""
        offset_ned, under = self.shown(poses, self.everyone)
        near = np.einsum("ijk,ijk->ij", offset_ned, offset_ned) < self.reach_of(poses) ** 2
        return offset_ned, under, near

    def shown(self, poses: Poses, who: IntArray) -> tuple[FloatArray, BoolArray]:
        """Where others are taken to be, from each agent: offsets NED (n, k, 3) to ``who`` (n, k), and whom that moves.

        A vehicle that is not steered by us may be coming down, and one whose position is lost may be anywhere below
        where it was last seen: those below see it at their own height, so that they leave the column under it. It
        does its half of no manoeuvre: inside the radius it is shown twice as deep inside, so that they do both halves.
        Around a vehicle with an extra radius they do so by themselves.
        """
        offset_ned = poses.pos_team_ned_m[who] - poses.pos_team_ned_m[:, None]
        under = np.asarray(poses.sinking[who] & (offset_ned[..., 2] < 0.0), dtype=np.bool_)
        offset_ned[..., 2] = np.where(under, 0.0, offset_ned[..., 2])
        if some(under):
            keep_out_m = self._damper.radius_m + self._damper.margin_m
            beside_m = np.maximum(norms(offset_ned), _LEVEL_MIN_M)
            shown_m = between(2.0 * beside_m - keep_out_m, _LEVEL_MIN_M, beside_m)
            steered = poses.extra_radius_m[who] == 0.0
            offset_ned *= np.where(under & steered, shown_m / beside_m, 1.0)[..., None]
        return offset_ned, under

    def _find_wider_m(self, poses: Poses, who: IntArray) -> FloatArray:
        """What the margin is to grow by for pairs with a poor velocity, as far as there is room, shape of ``who``.

        The damper holds d + T d' against r: of a pair T times the error of d' is missing, for three deviations.
        """
        plan, error_m_s = self._plan, poses.vel_error_m_s
        pair_m = DEVIATIONS * self._damper.horizon_s * np.hypot(error_m_s[:, None], error_m_s[who])
        wanted_m = np.hypot(plan.keep_out_margin_m, pair_m)
        most_m = fitting_margin_m(np.inf, plan.room_m)
        return np.asarray(np.maximum(np.minimum(wanted_m, most_m) - self._margin_m, 0.0))

    def wider_m(self, poses: Poses, who: IntArray) -> FloatArray:
        """What the margin is to grow by for pairs with a poor velocity, as far as there is room, shape of ``who``."""
        return self._wider_of_all(poses) if who is self.everyone else self._find_wider_m(poses, who)

    def _find_reach_m(self, poses: Poses) -> float:
        """How far vehicles have to be seen that are no obstacles."""
        if not np.count_nonzero(poses.vel_error_m_s):
            return self._least_m
        everybody = self.everyone if len(self.everyone) > 1 else np.tile(self.everyone, (self._plan.size, 1))
        return self._least_m + float(self.wider_m(poses, everybody).max())

    def reach_of(self, poses: Poses) -> FloatArray | float:
        """How far each vehicle has to be seen by the others: farther where it is an obstacle, or a fast one."""
        if not np.count_nonzero(poses.extra_radius_m):
            return self.reach_m(poses)
        speed_m_s = np.nan_to_num(norms(poses.vel_ned_m_s))
        faster_m_s = np.maximum(speed_m_s - self._plan.spec.speed_limit_m_s, 0.0)
        farther_m = poses.extra_radius_m + faster_m_s * (1.0 / self._damper.rate_1_s + self._damper.horizon_s)
        return self.reach_m(poses) + np.where(poses.extra_radius_m > 0.0, farther_m, 0.0)[None, :]
