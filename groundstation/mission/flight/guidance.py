"""From poses to velocity setpoints: local view, law, avoidance, back to NED, limits.

Everything between the view and the limits happens in each agent's own tilted body frame, with nothing but that
agent's own view. Keeps nothing: what was told last, from which the slope is limited, is handed in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from groundstation.core import frames
from groundstation.core.avoidance import Avoided, avoid, straight_on
from groundstation.core.control import Task, formation_control, saturate
from groundstation.core.damper import DamperParams, damp, fitting_margin_m, obstacle_bounds, walls
from groundstation.core.gridlock import Sensed
from groundstation.core.law import OwnAvoidance, OwnLaw, seen_by
from groundstation.core.limits import Fence, apply_limits, fence_bounds
from groundstation.core.motion import Motion
from groundstation.core.near import near_views, views_of
from groundstation.core.places import Places, own_places
from groundstation.core.quick import norms, some
from groundstation.core.regions import SafetyRegion
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.core.views import LocalViews, alone, local_views
from groundstation.mission.flight.fleeing import Fleeing
from groundstation.mission.flight.poses import OncePerPoses, Poses
from groundstation.mission.flight.sensing import Sight
from groundstation.mission.flight.surroundings import Surroundings
from groundstation.mission.plan.own_code import AVOIDANCE, LAW
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.positioning import DEVIATIONS
from groundstation.mission.plan.profiles import approach_rate_1_s
from groundstation.mission.plan.schema import AvoidanceSpec
from groundstation.mission.plan.stages import Stage

_MANY = 64
"""From so many vehicles on it is quicker to look for those near each than to look at all pairs."""


@dataclass(frozen=True)
class Setpoints:
    """Setpoints of one tick.

    Attributes:
        vel_ned_m_s: within all limits, shape (n, 3).
        blocked: the agent wanted to move and found no free direction, shape (n,).
        sensed: what each agent knows of itself, for ``core.gridlock``.
        room: share of a commanded common motion that the fence leaves to all agents, 0 to 1.
    """

    vel_ned_m_s: FloatArray
    blocked: BoolArray
    sensed: Sensed
    room: float = 1.0


@dataclass(frozen=True)
class Course:
    """What the team is about, beyond its task.

    Attributes:
        stage: the formation under way, with its gains and its law.
        control_gain: k that multiplies (14), for the size that the formation has at the moment.
        points_by_agent_m: the point of each agent's role at its present size, ENU, shape (n, 3).
        detour_enu_m_s: what agents on a detour wish instead of their law, NaN for all others, shape (n, 3).
        motion: what the formation does as one; None at rest.
        present: the part of it that shows in velocities already.
        members: agents that fly the formation, shape (n,); None for all.
        places_ned_m: where the law is shown everybody, smoothed, shape (n, 3); None where the poses say.
        sight: what agents' own sensors see of those places; None where they see all neighbours.
    """

    stage: Stage
    control_gain: float
    points_by_agent_m: FloatArray
    detour_enu_m_s: FloatArray | None = None
    motion: Motion | None = None
    present: Motion | None = None
    members: BoolArray | None = None
    places_ned_m: FloatArray | None = None
    sight: Sight | None = None


class Guide:
    """Guidance of one team.

    Args:
        plan: gains, radii, limits.
    """

    def __init__(self, plan: MissionPlan) -> None:
        spec, profile = plan.spec, plan.profile
        self._period_s = 1.0 / spec.rate_hz
        self._plan = plan
        # What positions may be off and gusts may do is added to r and d: then true distances stay above r.
        margin_m = fitting_margin_m(plan.keep_out_margin_m, plan.room_m)
        self._region = plan.region.grown(margin_m)
        self._damper = DamperParams(
            radius_m=spec.avoidance.radius_m,
            margin_m=margin_m,
            lag_s=profile.lag_s,
            delay_s=profile.delay_s,
            tick_s=self._period_s,
            speed_limit_m_s=spec.speed_limit_m_s,
            # With less than the vehicles could do braking takes that much longer.
            accel_limit_m_s2=min(plan.acceleration_limit_m_s2, profile.acceleration_max_m_s2),
            region=plan.region,
        )
        # Beyond this distance no bound of the damper is below the speed limit, even head on at full speed.
        closing_m = 2.0 * spec.speed_limit_m_s * (1.0 / self._damper.rate_1_s + self._damper.horizon_s)
        widest = self._region.activation_m / self._region.radius_m
        reach_m = max(widest * self._region.reach_m(0.0), self._region.reach_m(closing_m))
        # Critically damped on a lag of tau: the fastest way to a point that does not overshoot.
        self._approach_rate_1_s = 1.0 / (4.0 * (profile.lag_s + profile.delay_s))
        self._target_rate_1_s = approach_rate_1_s(profile, plan.lead_s)
        self._stopping_s = profile.lag_s + profile.delay_s
        self._fence = Fence.from_enu(np.array(spec.fence.min_m), np.array(spec.fence.max_m))
        floor_enu = np.array([*spec.fence.min_m[:2], max(plan.min_altitude_m, spec.fence.min_m[2])])
        self._formation_box = Fence.from_enu(floor_enu, np.array(spec.fence.max_m))
        own, ids = plan.own_code, [vehicle.id for vehicle in spec.vehicles]
        # In the steps of a formation alone: takeoff, hold, return and landing are never left to them.
        self._own_law = OwnLaw(f"law {own[LAW].use}", own[LAW].make(), ids) if LAW in own else None
        self._own_avoidance = (
            OwnAvoidance(f"avoidance {own[AVOIDANCE].use}", own[AVOIDANCE].make(), ids) if AVOIDANCE in own else None
        )
        everyone: IntArray = np.tile(np.arange(plan.size), (plan.size, 1) if plan.size < _MANY else (1, 1))
        self._fleeing = Fleeing(plan, self._damper.radius_m + self._damper.margin_m)
        # Who flies apart is steered with the others' poses: what follows from these alone is worked out once.
        self._flees = OncePerPoses(self._fleeing.wishes_ned_m_s)
        self._near_views = OncePerPoses(self._look_near)
        self._surroundings = Surroundings(plan, self._damper, reach_m, margin_m, everyone)

    def take_words(self) -> list[str]:
        """What people should know of a law of one's own, each thing once."""
        return [] if self._own_law is None else self._own_law.take_words()

    @property
    def keep_out_m(self) -> float:
        """Distance that agents keep from each other in any direction, margin included."""
        return self._region.reach_m(0.0)

    @property
    def beside_m(self) -> float:
        """Horizontal distance from which on two agents are clear of each other at any heights, margin included."""
        return self._region.radius_m

    @property
    def settle_s(self) -> float:
        """Lag and delay of the slowest vehicle."""
        return self._stopping_s

    def formation(self, poses: Poses, task: Task, course: Course, told_ned_m_s: FloatArray) -> Setpoints:
        """One tick of (14) with avoidance, above the floor of formation flight."""
        shown = None
        if self._plan.size < _MANY:
            views = self._views(poses, task.neighbours)
        elif self._own_law is None and course.sight is None:  # with columns for neighbours alone
            task, shown = task.near
            pos_ned_m, rot_ned_from_flu = poses.pos_team_ned_m, poses.rot_ned_from_flu
            views = views_of(pos_ned_m, poses.vel_ned_m_s, rot_ned_from_flu, shown, task.neighbours)
        else:
            views = local_views(poses.pos_team_ned_m, poses.vel_ned_m_s, poses.quat_ned_from_frd, task.neighbours)
        motion, common_enu = course.motion, None
        seen = self._shown(poses, views, task, course, shown)
        if motion is not None:
            places = self._places(poses, views, course, shown)
            common_enu = motion.rigid(places.from_centre_m)
            if course.present is not None:
                seen = self._without(poses, seen, course.present)
        wish = self._law(seen, task, course)
        if course.sight is not None:
            # Theorem 2 with c_i = 0 for a while: who lacks a neighbour does nothing wrong by doing nothing.
            wish = np.where(course.sight.waits[:, None], 0.0, wish)
        if motion is not None:
            grown = motion.growth_1_s * places.from_centre_m
            wish = wish + _flu_from_enu(poses, grown)
        who = None
        if self._plan.size >= _MANY:
            views, who = self._near_views(poses)
        return self._finish(
            poses,
            views,
            wish,
            self._formation_box,
            told_ned_m_s,
            who=who,
            detour_enu_m_s=course.detour_enu_m_s,
            common_enu_m_s=common_enu,
            own_avoidance=self._own_avoidance,
            method=self._plan.spec.avoidance,
        )

    def _shown(self, poses: Poses, views: LocalViews, task: Task, course: Course, who: IntArray | None) -> LocalViews:
        """What the law is shown of the neighbours: by their sensors, by smoothed places, or as the views are."""
        if course.sight is not None:
            return course.sight.views
        if course.places_ned_m is None:
            return views
        vel_ned_m_s, rot_ned_from_flu = poses.vel_ned_m_s, poses.rot_ned_from_flu
        if who is not None:
            return views_of(course.places_ned_m, vel_ned_m_s, rot_ned_from_flu, who, task.neighbours)
        return local_views(course.places_ned_m, vel_ned_m_s, poses.quat_ned_from_frd, task.neighbours, rot_ned_from_flu)

    def _law(self, views: LocalViews, task: Task, course: Course) -> FloatArray:
        """What the law wishes: (14), or one of the mission's own in its place; shape (n, 3), body FLU."""
        stage, lead_s = course.stage, self._plan.lead_s
        if self._own_law is None:
            return formation_control(
                views, task, stage.scale, course.control_gain, lead_s=lead_s, upright_1_s=stage.upright_1_s
            )
        seen = seen_by(
            views,
            task,
            stage.scale,
            course.control_gain,
            lead_s=lead_s,
            upright_1_s=stage.upright_1_s,
            speed_limit_m_s=self._plan.spec.speed_limit_m_s,
            period_s=self._period_s,
        )
        return self._own_law(seen)

    def _places(self, poses: Poses, views: LocalViews, course: Course, who: IntArray | None) -> Places:
        """What each agent makes of its view, in its own level axes."""
        rel_enu_m = _enu_from_flu(poses, views.rel_pos_flu_m)
        free = course.stage.scale.kind == "free"
        seen = views.visible
        if course.members is not None:
            seen = seen & (course.members[None] if who is None else course.members[who])
        return own_places(rel_enu_m, seen, course.points_by_agent_m, who=who, free_scale=free)

    def _without(self, poses: Poses, views: LocalViews, motion: Motion) -> LocalViews:
        """Views without the common motion in relative velocities: the lead of the law is for what is not wanted."""
        expected_enu = motion.relative(_enu_from_flu(poses, views.rel_pos_flu_m))
        rot = poses.rot_ned_from_flu
        expected_flu = frames.rotate_back(rot[:, None], frames.ned_from_enu(expected_enu))
        return replace(views, rel_vel_flu_m_s=views.rel_vel_flu_m_s - expected_flu)

    def to_targets(
        self,
        poses: Poses,
        target_team_ned_m: FloatArray,
        told_ned_m_s: FloatArray,
        detour_enu_m_s: FloatArray | None = None,
    ) -> Setpoints:
        """One tick towards a point for each vehicle, with the same avoidance; the floor is the ground.

        Args:
            poses: of the team.
            target_team_ned_m: shape (n, 3).
            told_ned_m_s: setpoints of the tick before, shape (n, 3).
            detour_enu_m_s: what agents on a detour wish instead, NaN for all others, shape (n, 3).
        """
        who = None
        if self._plan.size >= _MANY:
            views, who = self._near_views(poses)
        else:
            views = self._views(poses, np.zeros((self._plan.size, self._plan.size), dtype=np.bool_))
        offset_ned = target_team_ned_m - poses.pos_team_ned_m
        offset_ned = offset_ned - self._plan.lead_s * poses.vel_ned_m_s
        wish = self._target_rate_1_s * frames.rotate_back(poses.rot_ned_from_flu, offset_ned)
        return self._finish(poses, views, wish, self._fence, told_ned_m_s, who=who, detour_enu_m_s=detour_enu_m_s)

    def _views(self, poses: Poses, neighbours: BoolArray) -> LocalViews:
        """What each agent sees: its neighbours, and whoever is near enough to hit."""
        offset_ned, under, near = self._surroundings.of_all(poses)
        views = local_views(
            poses.pos_team_ned_m,
            poses.vel_ned_m_s,
            poses.quat_ned_from_frd,
            neighbours | near,
            poses.rot_ned_from_flu,
        )
        return self._with_obstacles(poses, views, self._surroundings.everyone, offset_ned, under)

    def _look_near(self, poses: Poses) -> tuple[LocalViews, IntArray]:
        """What each agent of a large team sees that is near enough to hit, a column for each, and who that is."""
        special = (poses.sinking | (poses.extra_radius_m > 0.0)).nonzero()[0]
        others = None
        if special.size:
            columns = np.broadcast_to(special, (self._plan.size, special.size))
            offset_ned, _ = self._surroundings.shown(poses, columns)
            reach_m = np.broadcast_to(self._surroundings.reach_of(poses), (1, self._plan.size))[:, special]
            others = np.zeros((self._plan.size, self._plan.size), dtype=np.bool_)
            others[:, special] = np.einsum("ijk,ijk->ij", offset_ned, offset_ned) < reach_m**2
        near_m = self._surroundings.reach_m(poses)
        near = near_views(poses.pos_team_ned_m, poses.vel_ned_m_s, poses.quat_ned_from_frd, near_m, others=others)
        offset_ned, under = self._surroundings.shown(poses, near.who)
        return self._with_obstacles(poses, near.views, near.who, offset_ned, under), near.who

    def _with_obstacles(
        self, poses: Poses, views: LocalViews, who: IntArray, offset_ned: FloatArray, under: BoolArray
    ) -> LocalViews:
        """Views with all extra radii, and with those that may come down where they are taken to be."""
        if np.count_nonzero(poses.vel_error_m_s):
            views = replace(views, wider_m=self._surroundings.wider_m(poses, who))
        if np.count_nonzero(poses.extra_radius_m):
            # From where it is itself, an obstacle has nobody to make room for.
            extra_m = np.where(poses.extra_radius_m[:, None] > 0.0, 0.0, poses.extra_radius_m[who])
            views = replace(views, extra_m=extra_m)
        if not some(under):
            return views
        rot_ned_from_flu = poses.rot_ned_from_flu
        level_flu_m = frames.rotate_back(rot_ned_from_flu[:, None], offset_ned)
        shown = (under & views.visible)[..., None]
        return replace(views, rel_pos_flu_m=np.where(shown, level_flu_m, views.rel_pos_flu_m))

    def _standing_in_the_way(self, poses: Poses) -> tuple[FloatArray, FloatArray]:
        """Unit vectors towards each obstacle, NED, shape (n, k, 3), and how fast agents may fly along them, m/s.

        Those that stand come first, then those that fly.

        As the damper bounds who flies towards a vehicle that nobody steers: an obstacle does its half of nothing, so
        an agent does both, and what it moves already counts (docs/avoidance-why.md).
        """
        obstacles, flying = self._plan.obstacles, poses.intruders
        if not len(obstacles) and not len(flying):
            return np.zeros((self._plan.size, 0, 3)), np.zeros((self._plan.size, 0))
        left_m, away_enu = obstacles.distances(frames.enu_from_ned(poses.pos_team_ned_m))
        towards_ned, comes_m_s = -frames.ned_from_enu(away_enu), np.zeros_like(left_m)
        if len(flying):
            left_there_m, there_ned = flying.distances(poses.pos_team_ned_m)
            comes_there_m_s = (there_ned * flying.vel_ned_m_s[None]).sum(axis=2)
            left_m, comes_m_s = np.hstack([left_m, left_there_m]), np.hstack([comes_m_s, comes_there_m_s])
            towards_ned = np.concatenate([towards_ned, there_ned], axis=1)
        return towards_ned, obstacle_bounds(
            left_m - obstacles.keep_m,
            towards_ned,
            poses.vel_ned_m_s,
            self._damper,
            comes_m_s=comes_m_s,
            poor_m_s=DEVIATIONS * poses.vel_error_m_s[:, None],
        )

    def _finish(
        self,
        poses: Poses,
        views: LocalViews,
        wish_flu_m_s: FloatArray,
        box: Fence,
        told_ned_m_s: FloatArray,
        *,
        who: IntArray | None = None,
        detour_enu_m_s: FloatArray | None = None,
        common_enu_m_s: FloatArray | None = None,
        own_avoidance: OwnAvoidance | None = None,
        method: AvoidanceSpec | None = None,
    ) -> Setpoints:
        turn: Callable[[LocalViews, FloatArray, SafetyRegion], Avoided] = own_avoidance or avoid
        if method is not None and not method.turns:
            turn = straight_on
        speed_max = self._plan.spec.speed_limit_m_s
        rot_ned_from_flu = poses.rot_ned_from_flu
        flee_ned_m_s = self._flees(poses)
        if flee_ned_m_s is not None:
            box = self._fleeing.with_lower_floor(box)
        # What already moves towards a wall counts as if it were nearer, so that a lagging vehicle stops before it.
        ahead_ned_m = poses.pos_team_ned_m + self._stopping_s * poses.vel_ned_m_s
        low_m_s, high_m_s = fence_bounds(ahead_ned_m, box, self._approach_rate_1_s)
        wish_flu_m_s = saturate(wish_flu_m_s, speed_max)
        if detour_enu_m_s is not None:
            detour_flu_m_s = _flu_from_enu(poses, detour_enu_m_s)
            wish_flu_m_s = np.where(np.isfinite(detour_flu_m_s), detour_flu_m_s, wish_flu_m_s)
        if flee_ned_m_s is not None:
            flee_flu_m_s = frames.rotate_back(rot_ned_from_flu, flee_ned_m_s)
            wish_flu_m_s = np.where(np.isfinite(flee_flu_m_s), flee_flu_m_s, wish_flu_m_s)
        towards_ned, most_m_s = self._standing_in_the_way(poses)
        walled = None
        standing = len(self._plan.obstacles)  # what flies by is waited for, not flown round
        if standing:
            wish_ned_m_s = frames.rotate(rot_ned_from_flu, wish_flu_m_s)
            along_m_s = (towards_ned[:, :standing] * wish_ned_m_s[:, None]).sum(axis=2)
            walled = (along_m_s > most_m_s[:, :standing]).any(axis=1)
        common_flu, room = None, 1.0
        if common_enu_m_s is None:
            avoided = turn(views, wish_flu_m_s, self._region)
            wanted_flu_m_s = avoided.vel_flu_m_s
        else:
            common_ned = frames.ned_from_enu(common_enu_m_s)
            room = _room(common_ned, low_m_s, high_m_s, towards_ned, most_m_s)
            common_flu = _flu_from_enu(poses, room * common_enu_m_s)
            # Directions count from the common motion, which changes no distance; both together keep the speed limit.
            left = np.maximum(speed_max - norms(common_flu), 0.1 * speed_max)
            size = norms(wish_flu_m_s)
            wish_flu_m_s = wish_flu_m_s * np.minimum(1.0, left / np.maximum(size, 1e-12))[:, None]
            avoided = turn(views, wish_flu_m_s, self._region)
            wanted_flu_m_s = saturate(avoided.vel_flu_m_s + common_flu, speed_max)
        normals_flu, bounds_m_s = walls(rot_ned_from_flu, low_m_s, high_m_s)
        if most_m_s.shape[1]:
            towards_flu = frames.rotate_back(rot_ned_from_flu[:, None], towards_ned)
            normals_flu = np.concatenate([normals_flu, towards_flu], axis=1)
            bounds_m_s = np.concatenate([bounds_m_s, most_m_s], axis=1)
        guarded = views if method is None or method.damps else alone(views)
        damped = damp(guarded, wanted_flu_m_s, self._damper, normals_flu, bounds_m_s, common_flu_m_s=common_flu)
        vel_ned_m_s = apply_limits(
            frames.rotate(rot_ned_from_flu, damped.vel_flu_m_s),
            told_ned_m_s,
            ahead_ned_m,
            speed_max_m_s=speed_max,
            accel_max_m_s2=self._plan.acceleration_limit_m_s2,
            period_s=self._period_s,
            fence=box,
            fence_rate_1_s=self._approach_rate_1_s,
        )
        low_enu_m, high_enu_m = box.corners_enu_m
        pos_enu_m = frames.enu_from_ned(poses.pos_team_ned_m)
        sensed = Sensed(
            rel_m=_enu_from_flu(poses, views.rel_pos_flu_m),
            visible=views.visible,
            vel_m_s=frames.enu_from_ned(poses.vel_ned_m_s),
            wish_m_s=_enu_from_flu(poses, wish_flu_m_s),
            in_the_way=avoided.in_the_way | damped.in_the_way,
            low_m=low_enu_m - pos_enu_m,
            high_m=high_enu_m - pos_enu_m,
            walled=walled,
            pos_m=pos_enu_m if walled is not None else None,
            who=who,
        )
        return Setpoints(vel_ned_m_s, avoided.blocked | damped.held, sensed, room)


def _room(
    common_ned_m_s: FloatArray,
    low_m_s: FloatArray,
    high_m_s: FloatArray,
    towards_ned: FloatArray,
    most_m_s: FloatArray,
) -> float:
    """Share of the common motion that no wall or obstacle forbids to anybody: one who stops would be run into."""
    towards = np.maximum(common_ned_m_s, 0.0) / np.maximum(high_m_s, 1e-6)
    towards = np.maximum(towards, np.maximum(-common_ned_m_s, 0.0) / np.maximum(low_m_s, 1e-6))
    largest = float(towards.max())
    if most_m_s.size:
        closing = np.maximum((towards_ned * common_ned_m_s[:, None]).sum(axis=2), 0.0)
        largest = max(largest, float((closing / np.maximum(most_m_s, 1e-6)).max()))
    return 1.0 / max(1.0, largest)


def _enu_from_flu(poses: Poses, vector_flu: FloatArray) -> FloatArray:
    """Turns each agent's vectors, shape (n, 3) or (n, k, 3), from its tilted body frame into its level axes."""
    rot = poses.rot_ned_from_flu
    rot = rot if vector_flu.ndim == 2 else rot[:, None]
    return frames.enu_from_ned(frames.rotate(rot, vector_flu))


def _flu_from_enu(poses: Poses, vector_enu: FloatArray) -> FloatArray:
    """Turns each agent's vectors, shape (n, 3), from level axes into its tilted body frame."""
    return frames.rotate_back(poses.rot_ned_from_flu, frames.ned_from_enu(vector_enu))
