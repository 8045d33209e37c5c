"""Who races: the product as it is, the paper's law alone, and three that know goals in a common frame.

The last three are textbook methods with the means that the product has too: the same margin around r, the same limits
of speed and acceleration, and positions counted where vehicles come to rest (p + (lag + delay) v), which obey u at once
as those methods assume. ORCA: van den Berg, Guy, Lin, Manocha (2011), in three dimensions. Buffered Voronoi cells:
Zhou, Wang, Bandyopadhyay, Schwager (2017). None of them is ever flown by a mission.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from groundstation.app.law_bench.plant import TICK_S, Seen
from groundstation.core import control, frames
from groundstation.core.assignment import assign_roles
from groundstation.core.avoidance import avoid
from groundstation.core.damper import fitting_margin_m, project
from groundstation.core.limits import clamp_acceleration, clamp_speed
from groundstation.core.types import FloatArray, IntArray
from groundstation.core.views import local_views
from groundstation.mission.flight.formation_flight import FormationFlight
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.helm import Helm
from groundstation.mission.flight.poses import Poses
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.profiles import approach_rate_1_s
from groundstation.mission.roster import enlist
from groundstation.mission.timing import SECOND_NS
from groundstation.mission.verdict import Figures

_HORIZON_S = 2.0
_STUCK_M, _STUCK_S, _ASIDE_S = 0.05, 0.5, 1.5
_TINY = 1e-9


class Rival(Protocol):
    """Steers a team."""

    @property
    def roles(self) -> IntArray:
        """Role of each vehicle at the moment, shape (n,)."""

    def steer(self, seen: Seen) -> FloatArray:
        """Velocities to be told at a tick, NED, shape (n, 3)."""


class Product:
    """Formation flight as missions have it: law, lead, avoidance, damper, limits, swaps and detours.

    Args:
        plan: a mission that forms and then holds.
        start_enu_m: shape (n, 3).
    """

    def __init__(self, plan: MissionPlan, start_enu_m: FloatArray) -> None:
        self._flight = FormationFlight(
            plan, enlist(plan), Helm(Guide(plan), plan.size), Figures(), lambda kind, text, roles: None
        )
        self._flight.assign(assign_roles(start_enu_m, plan.formation).role_of_agent)
        self._shape = plan.compensator()
        self._nobody = np.zeros(plan.size, dtype=np.bool_)
        self._tick = -1

    @property
    def roles(self) -> IntArray:
        """Role of each vehicle at the moment, shape (n,)."""
        return self._flight.role_of_agent

    def steer(self, seen: Seen) -> FloatArray:
        """Velocities to be told at a tick, NED, shape (n, 3)."""
        poses = Poses(seen.pos_ned_m, seen.vel_ned_m_s, seen.quat_ned_from_frd, self._nobody)
        self._tick += 1
        now_ns = round(self._tick * TICK_S * SECOND_NS)
        if self._tick == 0:
            self._flight.next_step(now_ns, poses)
        vel_ned_m_s = self._flight.step(now_ns, poses).vel_ned_m_s
        return vel_ned_m_s if self._shape is None else self._shape(vel_ned_m_s)


class _Limited:
    """Limits that all keep: of speed and of acceleration."""

    def __init__(self, plan: MissionPlan) -> None:
        self._speed_m_s, self._accel_m_s2 = plan.spec.speed_limit_m_s, plan.acceleration_limit_m_s2
        self._told: FloatArray = np.zeros((plan.size, 3))

    def _limit(self, vel_ned_m_s: FloatArray) -> FloatArray:
        vel = clamp_acceleration(clamp_speed(vel_ned_m_s, self._speed_m_s), self._told, self._accel_m_s2, TICK_S)
        self._told = clamp_speed(vel, self._speed_m_s)
        return self._told


class PureLaw(_Limited):
    """(14) and Algorithm 2 alone, with the k that the vehicles' lag allows; no lead, no damper, no margin, no swaps."""

    def __init__(self, plan: MissionPlan, start_enu_m: FloatArray) -> None:
        super().__init__(plan)
        formation, gains, profile = plan.formation, plan.gains, plan.profile
        self.roles = assign_roles(start_enu_m, formation).role_of_agent
        self._task = control.task_for_roles(formation, gains, self.roles)
        rate_1_s = control.rate_for_auto_gain_1_s(formation, gains, plan.scale)
        self._gain = control.auto_control_gain(rate_1_s, profile.lag_s, profile.delay_s + TICK_S)
        self._scale, self._region = plan.scale, plan.region
        self._everybody = np.ones((plan.size, plan.size), dtype=np.bool_)

    def steer(self, seen: Seen) -> FloatArray:
        """Velocities to be told at a tick, NED, shape (n, 3)."""
        views = local_views(seen.pos_ned_m, seen.vel_ned_m_s, seen.quat_ned_from_frd, self._everybody)
        want = control.formation_control(views, self._task, self._scale, self._gain)
        turned = avoid(views, control.saturate(want, self._speed_m_s), self._region).vel_flu_m_s
        return self._limit(frames.rotate(frames.rot_ned_from_flu(seen.quat_ned_from_frd), turned))


class Straight(_Limited):
    """Straight to goals that a centre has given out, minding nobody: how fast it could be, were there no r."""

    def __init__(self, plan: MissionPlan, start_enu_m: FloatArray) -> None:
        super().__init__(plan)
        found = assign_roles(start_enu_m, plan.formation)
        self.roles = found.role_of_agent
        self._goal_ned_m = frames.ned_from_enu(found.targets_team_enu_m(plan.formation))
        profile = plan.profile
        self._rest_s = profile.lag_s + profile.delay_s
        self._rate_1_s = approach_rate_1_s(profile, profile.lag_s)
        self._apart_m = plan.region.radius_m + fitting_margin_m(plan.keep_out_margin_m, plan.room_m)

    def steer(self, seen: Seen) -> FloatArray:
        """Velocities to be told at a tick, NED, shape (n, 3)."""
        rest_ned_m = seen.pos_ned_m + self._rest_s * seen.vel_ned_m_s
        return self._limit(self._mind(rest_ned_m, seen.vel_ned_m_s))

    def _mind(self, pos_ned_m: FloatArray, vel_ned_m_s: FloatArray) -> FloatArray:
        del vel_ned_m_s
        return clamp_speed(self._rate_1_s * (self._goal_ned_m - pos_ned_m), self._speed_m_s)


class Orca(Straight):
    """Optimal reciprocal collision avoidance: of each pair's needed change each does half."""

    def _mind(self, pos_ned_m: FloatArray, vel_ned_m_s: FloatArray) -> FloatArray:
        want = super()._mind(pos_ned_m, vel_ned_m_s)
        out = np.empty_like(want)
        for i in range(len(want)):
            rel = np.delete(pos_ned_m - pos_ned_m[i], i, axis=0)
            change, normals = changes_needed(
                rel, np.delete(vel_ned_m_s[i] - vel_ned_m_s, i, axis=0), self._apart_m, _HORIZON_S
            )
            least = (normals * (vel_ned_m_s[i] + 0.5 * change)).sum(axis=1)
            out[i] = project(want[i], -normals, -least)[0]
        return out


def changes_needed(
    rel_m: FloatArray, rel_vel_m_s: FloatArray, apart_m: float, horizon_s: float
) -> tuple[FloatArray, FloatArray]:
    """The smallest changes of relative velocities after which nobody comes nearer than that within the horizon.

    A relative velocity v leads there if v t is inside the ball around the other for a t within the horizon: a cone with
    its tip cut off by a ball. Whoever is inside already is to be out after a tick.

    Args:
        rel_m: from oneself to the others, shape (k, 3).
        rel_vel_m_s: one's own velocity less theirs, shape (k, 3).
        apart_m: radius of the ball.
        horizon_s: > 0.

    Returns:
        The changes, shape (k, 3) (outward or, where there is no need, inward), and unit vectors out of the cones.
    """
    distance2 = (rel_m * rel_m).sum(axis=1)
    inside = distance2 <= apart_m**2
    time_s = np.where(inside, TICK_S, horizon_s)[:, None]
    # The ball that cuts the tip off.
    from_ball = rel_vel_m_s - rel_m / time_s
    size = np.sqrt((from_ball * from_ball).sum(axis=1))
    along = (from_ball * rel_m).sum(axis=1)
    at_ball = inside | ((along < 0.0) & (along**2 > apart_m**2 * size**2))
    # The cone's side: the ball of the family t (p, R) whose surface v is beside.
    cross = np.cross(rel_m, rel_vel_m_s)
    b = (rel_m * rel_vel_m_s).sum(axis=1)
    c = (rel_vel_m_s**2).sum(axis=1) - (cross**2).sum(axis=1) / np.maximum(distance2 - apart_m**2, _TINY)
    share = (b + np.sqrt(np.maximum(b**2 - distance2 * c, 0.0))) / np.maximum(distance2, _TINY)
    from_side = rel_vel_m_s - share[:, None] * rel_m
    out = np.where(at_ball[:, None], from_ball, from_side)
    length = np.maximum(np.sqrt((out * out).sum(axis=1)), _TINY)
    normals = out / length[:, None]
    radius = np.where(at_ball, apart_m / time_s[:, 0], share * apart_m)
    return (radius - length)[:, None] * normals, normals


class Voronoi(Straight):
    """Buffered Voronoi cells: each goes to the point of its own cell that is nearest to its goal.

    Who has been stuck there for half a second goes round to its right for a while, the rule that its authors use.
    """

    def __init__(self, plan: MissionPlan, start_enu_m: FloatArray) -> None:
        super().__init__(plan, start_enu_m)
        self._stuck_s, self._aside_s = np.zeros(plan.size), np.zeros(plan.size)

    def _mind(self, pos_ned_m: FloatArray, vel_ned_m_s: FloatArray) -> FloatArray:
        to_goal = self._goal_ned_m - pos_ned_m
        self._aside_s = np.maximum(self._aside_s - TICK_S, 0.0)
        right = np.stack([-to_goal[:, 1], to_goal[:, 0], to_goal[:, 2]], axis=1)
        to_goal = np.where((self._aside_s > 0.0)[:, None], right, to_goal)
        step = np.empty_like(to_goal)
        for i in range(len(to_goal)):
            rel = np.delete(pos_ned_m - pos_ned_m[i], i, axis=0)
            distance = np.maximum(np.sqrt((rel * rel).sum(axis=1)), _TINY)
            step[i] = project(to_goal[i], rel / distance[:, None], 0.5 * (distance - self._apart_m))[0]
        still = np.linalg.norm(step, axis=1) < _STUCK_M
        far = np.linalg.norm(self._goal_ned_m - pos_ned_m, axis=1) > 2.0 * _STUCK_M
        self._stuck_s = np.where(still & far & (self._aside_s == 0.0), self._stuck_s + TICK_S, 0.0)
        self._aside_s = np.where(self._stuck_s > _STUCK_S, _ASIDE_S, self._aside_s)
        return clamp_speed(self._rate_1_s * step, self._speed_m_s)


RIVALS: dict[str, type[Product] | type[PureLaw] | type[Straight]] = {
    "product": Product,
    "not shaped": Product,
    "pure law": PureLaw,
    "ORCA": Orca,
    "Voronoi": Voronoi,
    "straight": Straight,
}
"""Name: who steers, made of a plan (of ``plan_for`` for that name) and the starts."""
