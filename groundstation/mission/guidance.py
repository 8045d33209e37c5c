"""From poses to velocity setpoints: local view, law, avoidance, back to NED, limits.

Everything between the view and the limits happens in each agent's own tilted body frame, with nothing but that
agent's own view. Keeps no state but the last setpoints, whose slope is limited.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from groundstation.core import frames
from groundstation.core.avoidance import avoid
from groundstation.core.control import Task, formation_control, saturate
from groundstation.core.damper import DamperParams, damp, fitting_margin_m, walls
from groundstation.core.limits import Fence, apply_limits, fence_bounds
from groundstation.core.near import near_views
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.core.views import LocalViews, local_views
from groundstation.mission.plan import MissionPlan
from groundstation.mission.positioning import all_offsets
from groundstation.mission.profiles import approach_rate_1_s

_NOBODY: FloatArray = np.zeros(0)
"""Stands for zeros of whatever size is right."""
_MANY = 64
"""From so many vehicles on it is quicker to look for those near each than to look at all pairs."""
_LEVEL_MIN_M = 1e-3  # nearer than that there is no direction to leave in


@dataclass(frozen=True)
class Poses:
    """Poses of the team at one instant.

    Attributes:
        pos_team_ned_m: shape (n, 3); NaN where never known.
        vel_ned_m_s: shape (n, 3).
        quat_ned_from_frd: shape (n, 4).
        sinking: not steered by us, or its position is lost: it may come down anywhere below, shape (n,).
        extra_radius_m: what is added to r around a vehicle that nobody steers, so that the others do both halves of
            every manoeuvre, shape (n,), >= 0; zero for those we steer. Zeros when left out.
    """

    pos_team_ned_m: FloatArray
    vel_ned_m_s: FloatArray
    quat_ned_from_frd: FloatArray
    sinking: BoolArray
    extra_radius_m: FloatArray = field(default_factory=lambda: _NOBODY)

    def __post_init__(self) -> None:
        """Fills in what was left out, and refuses radii of the wrong size."""
        n = len(self.pos_team_ned_m)
        if self.extra_radius_m is _NOBODY:
            object.__setattr__(self, "extra_radius_m", np.zeros(n))
        elif self.extra_radius_m.shape != (n,):
            raise ValueError(f"poses: extra radii have shape {self.extra_radius_m.shape}, expected ({n},)")


@dataclass(frozen=True)
class Setpoints:
    """Setpoints of one tick.

    Attributes:
        vel_ned_m_s: within all limits, shape (n, 3).
        blocked: the agent wanted to move and found no free direction, shape (n,).
    """

    vel_ned_m_s: FloatArray
    blocked: BoolArray


class Guide:
    """Guidance of one team.

    Args:
        plan: gains, radii, limits.
    """

    def __init__(self, plan: MissionPlan) -> None:
        spec, profile = plan.spec, plan.profile
        self._period_s = 1.0 / spec.rate_hz
        self._plan = plan
        # What two positions may be off against each other is added to r and d: then true distances stay above r.
        room_m = plan.region.room_m(all_offsets(plan.formation.points_enu_m))
        margin_m = fitting_margin_m(plan.margin_m, room_m)
        self._region = plan.region.grown(margin_m)
        self._damper = DamperParams(
            radius_m=spec.avoidance.radius_m,
            margin_m=margin_m,
            lag_s=profile.lag_s,
            delay_s=profile.delay_s,
            tick_s=self._period_s,
            speed_limit_m_s=spec.speed_limit_m_s,
            accel_limit_m_s2=profile.acceleration_max_m_s2,
            region=plan.region,
        )
        # Beyond this distance no bound of the damper is below the speed limit, even head on at full speed.
        closing_m = 2.0 * spec.speed_limit_m_s * (1.0 / self._damper.rate_1_s + self._damper.horizon_s)
        widest = self._region.activation_m / self._region.radius_m
        self._reach_m = max(widest * self._region.reach_m(0.0), self._region.reach_m(closing_m))
        # Critically damped on a lag of tau: the fastest way to a point that does not overshoot.
        self._approach_rate_1_s = 1.0 / (4.0 * (profile.lag_s + profile.delay_s))
        self._target_rate_1_s = approach_rate_1_s(profile, plan.lead_s)
        self._stopping_s = profile.lag_s + profile.delay_s
        self._fence = Fence.from_enu(np.array(spec.fence.min_m), np.array(spec.fence.max_m))
        floor_enu = np.array([*spec.fence.min_m[:2], max(plan.min_altitude_m, spec.fence.min_m[2])])
        self._formation_box = Fence.from_enu(floor_enu, np.array(spec.fence.max_m))
        self._previous_ned_m_s: FloatArray = np.zeros((plan.size, 3))

    def rest(self) -> None:
        """Forgets the last setpoints: everybody was told to stand still."""
        self._previous_ned_m_s = np.zeros((self._plan.size, 3))

    def formation(self, poses: Poses, task: Task, control_gain: float) -> Setpoints:
        """One tick of (14) with avoidance, above the floor of formation flight."""
        if self._plan.size >= _MANY:
            views = local_views(poses.pos_team_ned_m, poses.vel_ned_m_s, poses.quat_ned_from_frd, task.neighbours)
        else:
            views = self._views(poses, task.neighbours)
        wish = formation_control(
            views,
            task,
            self._plan.scale,
            control_gain,
            lead_s=self._plan.lead_s,
            upright_1_s=self._plan.upright_1_s,
        )
        if self._plan.size >= _MANY:
            views = self._near_views(poses)
        return self._finish(poses, views, wish, self._formation_box)

    def to_targets(self, poses: Poses, target_team_ned_m: FloatArray) -> Setpoints:
        """One tick towards a point for each vehicle, with the same avoidance; the floor is the ground."""
        if self._plan.size >= _MANY:
            views = self._near_views(poses)
        else:
            views = self._views(poses, np.zeros((self._plan.size, self._plan.size), dtype=np.bool_))
        offset_ned = target_team_ned_m - poses.pos_team_ned_m
        offset_ned = offset_ned - self._plan.lead_s * poses.vel_ned_m_s
        wish = self._target_rate_1_s * frames.rotate_back(frames.rot_ned_from_flu(poses.quat_ned_from_frd), offset_ned)
        return self._finish(poses, views, wish, self._fence)

    def _views(self, poses: Poses, neighbours: BoolArray) -> LocalViews:
        """What each agent sees: its neighbours, and whoever is near enough to hit."""
        everybody = np.broadcast_to(np.arange(self._plan.size), neighbours.shape)
        offset_ned, under = self._shown(poses, everybody)
        near = np.einsum("ijk,ijk->ij", offset_ned, offset_ned) < self._reach_of(poses) ** 2
        views = local_views(poses.pos_team_ned_m, poses.vel_ned_m_s, poses.quat_ned_from_frd, neighbours | near)
        return self._with_obstacles(poses, views, everybody, offset_ned, under)

    def _near_views(self, poses: Poses) -> LocalViews:
        """What each agent of a large team sees that is near enough to hit: a column for each of those, and no other."""
        special = np.flatnonzero(poses.sinking | (poses.extra_radius_m > 0.0))
        others = None
        if special.size:
            columns = np.broadcast_to(special, (self._plan.size, special.size))
            offset_ned, _ = self._shown(poses, columns)
            reach_m = np.broadcast_to(self._reach_of(poses), (1, self._plan.size))[:, special]
            others = np.zeros((self._plan.size, self._plan.size), dtype=np.bool_)
            others[:, special] = np.einsum("ijk,ijk->ij", offset_ned, offset_ned) < reach_m**2
        near = near_views(
            poses.pos_team_ned_m, poses.vel_ned_m_s, poses.quat_ned_from_frd, self._reach_m, others=others
        )
        offset_ned, under = self._shown(poses, near.who)
        return self._with_obstacles(poses, near.views, near.who, offset_ned, under)

    def _shown(self, poses: Poses, who: IntArray) -> tuple[FloatArray, BoolArray]:
        """Where others are taken to be, from each agent: offsets NED (n, k, 3) to ``who`` (n, k), and whom that moves.

        A vehicle that is not steered by us may be coming down, and one whose position is lost may be anywhere below
        where it was last seen: those below see it at their own height, so that they leave the column under it. It
        does its half of no manoeuvre: inside the radius it is shown twice as deep inside, so that they do both halves.
        Around a vehicle with an extra radius they do so by themselves.
        """
        offset_ned = poses.pos_team_ned_m[who] - poses.pos_team_ned_m[:, None]
        under = np.asarray(poses.sinking[who] & (offset_ned[..., 2] < 0.0), dtype=np.bool_)
        offset_ned[..., 2] = np.where(under, 0.0, offset_ned[..., 2])
        if under.any():
            keep_out_m = self._damper.radius_m + self._damper.margin_m
            beside_m = np.maximum(np.linalg.norm(offset_ned, axis=2), _LEVEL_MIN_M)
            shown_m = np.clip(2.0 * beside_m - keep_out_m, _LEVEL_MIN_M, beside_m)
            steered = poses.extra_radius_m[who] == 0.0
            offset_ned *= np.where(under & steered, shown_m / beside_m, 1.0)[..., None]
        return offset_ned, under

    def _with_obstacles(
        self, poses: Poses, views: LocalViews, who: IntArray, offset_ned: FloatArray, under: BoolArray
    ) -> LocalViews:
        """Views with the extra radii of obstacles, and with those that may come down where they are taken to be."""
        if poses.extra_radius_m.any():
            # From where it is itself, an obstacle has nobody to make room for.
            extra_m = np.where(poses.extra_radius_m[:, None] > 0.0, 0.0, poses.extra_radius_m[who])
            views = replace(views, extra_m=extra_m)
        if not under.any():
            return views
        rot_ned_from_flu = frames.rot_ned_from_flu(poses.quat_ned_from_frd)
        level_flu_m = frames.rotate_back(rot_ned_from_flu[:, None], offset_ned)
        shown = (under & views.visible)[..., None]
        return replace(views, rel_pos_flu_m=np.where(shown, level_flu_m, views.rel_pos_flu_m))

    def _reach_of(self, poses: Poses) -> FloatArray | float:
        """How far each vehicle has to be seen by the others: farther where it is an obstacle, or a fast one."""
        if not poses.extra_radius_m.any():
            return self._reach_m
        speed_m_s = np.nan_to_num(np.linalg.norm(poses.vel_ned_m_s, axis=1))
        faster_m_s = np.maximum(speed_m_s - self._plan.spec.speed_limit_m_s, 0.0)
        farther_m = poses.extra_radius_m + faster_m_s * (1.0 / self._damper.rate_1_s + self._damper.horizon_s)
        return self._reach_m + np.where(poses.extra_radius_m > 0.0, farther_m, 0.0)[None, :]

    def _finish(self, poses: Poses, views: LocalViews, wish_flu_m_s: FloatArray, box: Fence) -> Setpoints:
        speed_max = self._plan.spec.speed_limit_m_s
        rot_ned_from_flu = frames.rot_ned_from_flu(poses.quat_ned_from_frd)
        avoided = avoid(views, saturate(wish_flu_m_s, speed_max), self._region)
        # What already moves towards a wall counts as if it were nearer, so that a lagging vehicle stops before it.
        ahead_ned_m = poses.pos_team_ned_m + self._stopping_s * poses.vel_ned_m_s
        normals_flu, bounds_m_s = walls(rot_ned_from_flu, *fence_bounds(ahead_ned_m, box, self._approach_rate_1_s))
        damped = damp(views, avoided.vel_flu_m_s, self._damper, normals_flu, bounds_m_s)
        vel_ned_m_s = apply_limits(
            frames.rotate(rot_ned_from_flu, damped.vel_flu_m_s),
            self._previous_ned_m_s,
            ahead_ned_m,
            speed_max_m_s=speed_max,
            accel_max_m_s2=self._plan.acceleration_limit_m_s2,
            period_s=self._period_s,
            fence=box,
            fence_rate_1_s=self._approach_rate_1_s,
        )
        self._previous_ned_m_s = vel_ned_m_s
        return Setpoints(vel_ned_m_s, avoided.blocked | damped.held)
