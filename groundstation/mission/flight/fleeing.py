"""The way out for those who are under one that comes down. Says where to, and leaves distances to the avoidance."""

from __future__ import annotations

import numpy as np

from groundstation.core.limits import Fence
from groundstation.core.quick import between, norms, some
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.flight.poses import Poses
from groundstation.mission.plan.plan import MissionPlan

_DOWN_SHARE = 0.7  # of the speed limit: who flees from under one that sinks goes down with it as well
_FLOOR_SHARE = 0.5  # of the lowest height of formation flight
_LEVEL_MIN_M = 1e-3  # nearer than that there is no direction to leave in


class Fleeing:
    """Away from the column, and down with the one above while there is room.

    Autopilots sink faster than most teams may fly: who only goes sideways is caught up with.

    Args:
        plan: speed limit, lowest height, pads.
        column_m: radius of the column under one that comes down.
    """

    def __init__(self, plan: MissionPlan, column_m: float) -> None:
        self._column_m = column_m
        self._speed_m_s = plan.spec.speed_limit_m_s
        self._stopping_s = plan.profile.lag_s + plan.profile.delay_s
        above_m = min(plan.min_altitude_m, max(_FLOOR_SHARE * plan.min_altitude_m, plan.margin_m))
        self._floor_enu_m = max(float(plan.pads_enu_m[:, 2].max()) + above_m, plan.spec.fence.min_m[2])

    def wishes_ned_m_s(self, poses: Poses) -> FloatArray | None:
        """What those wish who are under one that comes down, NED, shape (n, 3), NaN for all others; None for nobody.

        Whoever comes down or is an obstacle itself does not flee.
        """
        if not some(poses.sinking):
            return None
        above = poses.sinking.nonzero()[0]
        offset_ned = poses.pos_team_ned_m[above][None] - poses.pos_team_ned_m[:, None]
        beside_m = norms(offset_ned[..., :2])
        under = (offset_ned[..., 2] < 0.0) & (beside_m < self._column_m)
        under &= ~(poses.sinking | (poses.extra_radius_m > 0.0))[:, None]
        flees: BoolArray = np.asarray(under.any(axis=1))
        if not some(flees):
            return None
        depth = np.where(under, (self._column_m - beside_m) / np.maximum(beside_m, _LEVEL_MIN_M), 0.0)
        away_ned = -np.einsum("ij,ijk->ik", depth, np.where(under[..., None], offset_ned[..., :2], 0.0))
        away_ned /= np.maximum(norms(away_ned), 1e-12)[:, None]
        height_m = -(poses.pos_team_ned_m + self._stopping_s * poses.vel_ned_m_s)[:, 2]
        # Near the edge of the column what counts is to be out of it.
        deepest = 1.0 - np.where(under, beside_m, self._column_m).min(axis=1) / self._column_m
        most_m_s = _DOWN_SHARE * self._speed_m_s * between(2.0 * deepest, 0.0, 1.0)
        down_m_s = between((height_m - self._floor_enu_m) / self._stopping_s, 0.0, most_m_s)
        beside_m_s = np.sqrt(self._speed_m_s**2 - down_m_s**2)
        wish_ned_m_s = np.column_stack([beside_m_s[:, None] * away_ned, down_m_s])
        return np.where(flees[:, None], wish_ned_m_s, np.nan)

    def with_lower_floor(self, box: Fence) -> Fence:
        """The box, with as much room below as those may use who flee."""
        down_m = max(float(box.max_team_ned_m[2]), -self._floor_enu_m)
        return Fence(box.min_team_ned_m, np.array([*box.max_team_ned_m[:2], down_m]))
