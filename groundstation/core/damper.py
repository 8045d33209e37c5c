"""The approach damper: keeps true distances above r on vehicles that lag, which rotation alone does not.

For each near agent j the commanded velocity of i along the line to it is bounded by half of what the pair may close,

    n_ij . u_i <= alpha h_ij / 2,    h_ij = d_ij - (r + margin) + T min(d_ij', 0),    T = lag (or more),

n_ij the unit vector from i to j, d_ij their distance and d_ij' its rate as measured. d + T d' is the distance that
would remain if both stopped now: what is already moving counts, not only what is commanded. All bounds of an agent
are met together by the smallest change of its velocity (a projection onto a convex polyhedron, solved exactly).
A negative h commands the pair apart. The argument, with its assumptions, stands in docs/avoidance-why.md.

Around an upright region (`regions`) the same stands for its distance, with the gradient of that in place of n: any
distance that is convex and grows no faster than an agent moves will do.

An obstacle (``LocalViews.extra_m`` above zero) does its half of nothing: there r grows by that, and i does both halves,
n_ij . u_i <= alpha h_ij + min(n_ij . w_j, 0), w_j the obstacle's velocity as measured.

Refuses parameters outside their ranges only: for all others `DamperParams.rate_1_s` is as slow as the argument needs.
It does not know other agents' intentions (both sides of a pair must run it), nor whether the vehicles are what the
parameters say.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import nnls

from groundstation.core import frames
from groundstation.core.quick import between, every, some
from groundstation.core.regions import SafetyRegion, SafetySphere, rot_level_from_flu
from groundstation.core.types import BoolArray, FloatArray
from groundstation.core.views import LocalViews

_SLACK_WEIGHT = 1e4
"""Weight of a common violation when the bounds contradict each other; large: least violation comes first."""

_STALE_MAX = float(np.exp(-1.0))
"""x' = -c x(t - s) stays positive if and only if c s is at most this."""


@dataclass(frozen=True)
class DamperParams:
    """What the vehicles can do, and what follows for the damper.

    Along the line between two agents, with first-order lag tau (v' = (u - v) / tau) and centrifugal terms dropped
    (they only help), h = d + T d' - r obeys, for closing agents and T >= tau,

        h' >= (T / tau) n.(u_j - u_i) >= -(T / tau) alpha h,

    so h never falls below zero, and then neither does d - r, since d' >= -(d - r) / T. Delay and sampling make the
    bound old by ``delay + tick`` seconds; h stays positive as long as `delay_product` is at most 1/e, which alpha
    sees to. A finite acceleration acts as a longer lag: to lose a speed v takes v / a.

    Attributes:
        radius_m: r > 0, the distance that must not be undercut.
        margin_m: added to r for errors of position and velocity, >= 0.
        lag_s: first-order lag tau of the slowest vehicle's velocity loop, >= 0.
        delay_s: from measurement to effect (telemetry, link, autopilot), >= 0.
        tick_s: period of the controller, > 0.
        speed_limit_m_s: largest commanded speed, > 0.
        accel_limit_m_s2: largest acceleration of the vehicle, > 0; infinite where unknown to matter.
        region: what is kept out of instead of a ball of radius r; its radius is r. Activation does not matter here.
    """

    radius_m: float
    margin_m: float
    lag_s: float
    delay_s: float
    tick_s: float
    speed_limit_m_s: float
    accel_limit_m_s2: float = float("inf")
    region: SafetyRegion | None = None

    def __post_init__(self) -> None:
        """Refuses values outside their ranges."""
        for name in ("radius_m", "tick_s", "speed_limit_m_s", "accel_limit_m_s2"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"damper: {name} is {getattr(self, name)}, must be positive")
        for name in ("margin_m", "lag_s", "delay_s"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise ValueError(f"damper: {name} is {getattr(self, name)}, must not be negative")
        if self.region is not None and self.region.radius_m != self.radius_m:
            raise ValueError(f"damper: radius_m is {self.radius_m}, of the region {self.region.radius_m}")

    @property
    def keep_out(self) -> SafetyRegion:
        """The region with the margin."""
        region = self.region or SafetySphere(self.radius_m, self.radius_m)
        return region.grown(self.margin_m)

    @cached_property
    def horizon_s(self) -> float:
        """T: how far ahead the measured closing speed is held against the pair: what stopping takes.

        No more: what a delay does is in alpha, and T beyond the lag makes a bound old sooner (`delay_product`).
        """
        return max(self.lag_s, self.speed_limit_m_s / self.accel_limit_m_s2)

    @cached_property
    def rate_1_s(self) -> float:
        """alpha: how fast the remaining distance may be used up.

        1 / (3 (delay + tick) + tau), or, where that is less, the one with which `delay_product` is 1/e: long delays
        on vehicles whose acceleration, and not their lag, says how long stopping takes.
        """
        swift_1_s = 1.0 / (3.0 * (self.delay_s + self.tick_s) + self.lag_s)
        # Not a minimum of both: where the first will do it stays what it is, to the last bit.
        return swift_1_s if swift_1_s * self._stale_s <= _STALE_MAX else _STALE_MAX / self._stale_s

    @property
    def delay_product(self) -> float:
        """Product alpha (T / tau) (delay + tick), T / tau left out without lag: at most 1/e, to rounding."""
        return self.rate_1_s * self._stale_s

    @cached_property
    def _stale_s(self) -> float:
        """How old a bound is, stretched by T / tau: h may fall that much faster than it is used up."""
        stretch = self.horizon_s / self.lag_s if self.lag_s > 0.0 else 1.0
        return stretch * (self.delay_s + self.tick_s)


@dataclass(frozen=True)
class Damped:
    """What the damper made of the velocities of m agents.

    Attributes:
        vel_flu_m_s: shape (m, 3).
        changed: the velocity was changed, shape (m,).
        held: wanted to move, and less than a tenth of the speed is left, shape (m,). If it lasts, a gridlock.
        infeasible: the bounds contradict each other; the answer violates them least, shape (m,).
        in_the_way: agents whose bound the wanted velocity breaks, shape (m, n).
    """

    vel_flu_m_s: FloatArray
    changed: BoolArray
    held: BoolArray
    infeasible: BoolArray
    in_the_way: BoolArray


def damp(
    views: LocalViews,
    vel_flu_m_s: FloatArray,
    params: DamperParams,
    wall_normals_flu: FloatArray | None = None,
    wall_bounds_m_s: FloatArray | None = None,
    *,
    common_flu_m_s: FloatArray | None = None,
) -> Damped:
    """Changes velocities as little as possible so that nobody approaches anybody faster than both can stop.

    With every h >= 0 standing still is allowed, so an answer exists and is no faster than what was wanted. With a
    negative h agents must part; demands that contradict each other (or the speed limit) are met with the least
    common violation, and the answer is shortened to the speed limit last.

    Args:
        views: what m agents see; an unknown relative velocity counts as closing at the speed limit.
        vel_flu_m_s: wanted velocities, shape (m, 3), body FLU.
        params: the vehicles and the radius.
        wall_normals_flu: further unit vectors w per agent along which the velocity is bounded (`limits.fence_bounds`
            turned into the agent's frame), shape (m, w, 3).
        wall_bounds_m_s: their bounds, shape (m, w).
        common_flu_m_s: velocity that each agent was told to share with the team, as part of a formation that moves and
            turns as one, shape (m, 3). Along a line to another agent bounds then count from what both move along it
            already, as measured, up to what was told: who follows a moving agent may keep up with it, and who
            follows one that stays behind may not run into it.

    Returns:
        New velocities; rows within all bounds come back unchanged.

    Raises:
        ValueError: shape, or a wanted velocity that is not finite.
    """
    m = views.viewers
    if vel_flu_m_s.shape != (m, 3) or not every(np.isfinite(vel_flu_m_s)):
        raise ValueError(f"wanted velocities must be finite and of shape ({m}, 3)")
    normals, bounds = approach_bounds(views, params)
    if common_flu_m_s is not None:
        bounds = bounds + _shared_m_s(views, normals, common_flu_m_s)
    if wall_normals_flu is not None and wall_bounds_m_s is not None:
        normals = np.concatenate([normals, wall_normals_flu], axis=1)
        bounds = np.concatenate([bounds, wall_bounds_m_s], axis=1)
    x, y, z = vel_flu_m_s[:, None, 0], vel_flu_m_s[:, None, 1], vel_flu_m_s[:, None, 2]
    along = normals[..., 0] * x + normals[..., 1] * y + normals[..., 2] * z
    broken = along > bounds
    vel = vel_flu_m_s.copy()
    held, infeasible = np.zeros(m, dtype=np.bool_), np.zeros(m, dtype=np.bool_)
    if not some(broken):
        return Damped(vel, held.copy(), held, infeasible, broken[:, : views.team_size])
    changed = np.asarray(broken.any(axis=1), dtype=np.bool_)
    for i in changed.nonzero()[0]:
        wanted = np.sqrt(float(vel[i] @ vel[i]))
        # While standing still is allowed the answer is no faster than the wish: wider bounds cannot matter.
        rows = (bounds[i] < (np.inf if bounds[i].min() < 0.0 else wanted)).nonzero()[0]
        vel[i], infeasible[i] = project(vel[i], normals[i, rows], bounds[i, rows])
        speed = np.sqrt(float(vel[i] @ vel[i]))
        held[i] = speed < 0.1 * wanted
        if speed > params.speed_limit_m_s:
            vel[i] *= params.speed_limit_m_s / speed
    return Damped(vel, changed, held, infeasible, broken[:, : views.team_size])


def _shared_m_s(views: LocalViews, normals: FloatArray, common_flu_m_s: FloatArray) -> FloatArray:
    """What two agents move along the line between them together: measured, up to what was told; shape (m, n).

    Both ends of a pair measure the same mean of their velocities, so what one bound gains the other loses.
    """
    told = (normals * common_flu_m_s[:, None]).sum(axis=2)
    mean_flu_m_s = views.vel_flu_m_s[:, None] + 0.5 * views.rel_vel_flu_m_s
    moved = (normals * np.where(np.isfinite(mean_flu_m_s), mean_flu_m_s, 0.0)).sum(axis=2)
    return np.asarray(between(moved, np.minimum(told, 0.0), np.maximum(told, 0.0)), dtype=np.float64)


def obstacle_bounds(
    left_m: FloatArray,
    towards: FloatArray,
    vel_m_s: FloatArray,
    params: DamperParams,
    *,
    comes_m_s: FloatArray | float = 0.0,
    poor_m_s: FloatArray | float = 0.0,
) -> FloatArray:
    """How fast agents may fly towards what does nothing of its half of a manoeuvre, m/s, shape (m, k).

    docs/avoidance-why.md, "The approach damper": n . u <= alpha h + min(n . w, 0), no agent is asked for more than the
    speed limit. Any axes, the same for all.

    Args:
        left_m: distances from the surfaces, less what is kept from them, shape (m, k).
        towards: unit vectors towards them, shape (m, k, 3).
        vel_m_s: of the agents, shape (m, 3).
        params: the vehicles.
        comes_m_s: velocity of what is in the way along those vectors, negative when it comes nearer, shape (m, k).
        poor_m_s: by how much the agents' velocities may be off, shape (m, 1).
    """
    closing_m_s = np.maximum((towards * vel_m_s[:, None]).sum(axis=2) - comes_m_s, 0.0)
    left_m = left_m - params.horizon_s * (closing_m_s + poor_m_s)
    most_m_s = params.rate_1_s * left_m + np.minimum(comes_m_s, 0.0)
    return np.asarray(np.maximum(most_m_s, -params.speed_limit_m_s), dtype=np.float64)


def walls(rot_ned_from_flu: FloatArray, low_m_s: FloatArray, high_m_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turns the speeds of `limits.fence_bounds` into bounds for `damp`.

    Meeting agents and walls together matters: a velocity cut at a wall afterwards may point at an agent again.

    Args:
        rot_ned_from_flu: attitudes, shape (m, 3, 3).
        low_m_s: largest speeds towards the walls at low north, east, down, shape (m, 3).
        high_m_s: towards the others, shape (m, 3).

    Returns:
        Unit vectors in each agent's frame, shape (m, 6, 3), and bounds, shape (m, 6).
    """
    # The axes of NED, seen from the body, are the rows of the matrix.
    normals = np.concatenate([-rot_ned_from_flu, rot_ned_from_flu], axis=1)
    return normals, np.concatenate([low_m_s, high_m_s], axis=1)


def fitting_margin_m(margin_m: float, room_m: float) -> float:
    """Shrinks a margin so that the formation can be reached: at most nine tenths of the room that it leaves.

    A margin that large costs a quarter of the time to form and keeps true distances above r; half of the room did not.

    Args:
        margin_m: what position errors ask for.
        room_m: by how much the region can grow before the formation touches it, > 0.

    Returns:
        The margin, metres.

    Raises:
        ValueError: no room: the formation cannot be reached.
    """
    if not room_m > 0.0:
        raise ValueError(f"formation: leaves {room_m} m of room around the safety region, must be positive")
    return min(margin_m, 0.9 * room_m)


def approach_bounds(views: LocalViews, params: DamperParams) -> tuple[FloatArray, FloatArray]:
    """Computes each agent's bounds n . u <= c.

    Args:
        views: what m agents see.
        params: the vehicles and the region.

    Returns:
        Vectors towards the others, shape (m, n, 3), and bounds, shape (m, n), m/s: infinite (and the vector zero) where
        there is nobody, or nobody in any direction: coincident agents have no line between them. The vectors are
        gradients of the region's distance: unit vectors for a sphere, never longer.
    """
    distance, normals = _distance_left(views, params)
    seen = np.isfinite(distance)
    rel_vel = views.rel_vel_flu_m_s
    rate = normals[..., 0] * rel_vel[..., 0] + normals[..., 1] * rel_vel[..., 1] + normals[..., 2] * rel_vel[..., 2]
    parting = np.where(np.isfinite(rate), np.minimum(rate, 0.0), -params.speed_limit_m_s)
    left = distance + params.horizon_s * parting
    bounds = 0.5 * params.rate_1_s * left
    if np.count_nonzero(views.extra_m):
        unsteered = seen & (views.extra_m > 0.0)
        own = views.vel_flu_m_s[:, None]
        towards = normals[..., 0] * own[..., 0] + normals[..., 1] * own[..., 1] + normals[..., 2] * own[..., 2]
        # Of an obstacle whose velocity is unknown no more is known than that the pair may close at full speed.
        its_own = np.where(np.isfinite(rate + towards), np.minimum(rate + towards, 0.0), 0.0)
        bounds = np.where(unsteered, params.rate_1_s * left + its_own, bounds)
    bounds = np.maximum(bounds, -params.speed_limit_m_s)
    return normals, np.where(seen, bounds, np.inf)


def _distance_left(views: LocalViews, params: DamperParams) -> tuple[FloatArray, FloatArray]:
    """Distances (m, n) to the region with its margin, infinite where there is none, and their gradients (m, n, 3)."""
    rel = views.rel_pos_flu_m
    if params.region is None or params.region.by_distance:
        x, y, z = rel[..., 0], rel[..., 1], rel[..., 2]
        length = np.sqrt(x * x + y * y + z * z)
        seen = views.visible & (length > 1e-9)
        length = np.where(seen, length, 1.0)
        normals = np.where(seen[..., None], rel, 0.0) / length[..., None]
        left = length - (params.radius_m + params.margin_m + views.grown_m)
        return np.where(seen, left, np.inf), normals
    level = rot_level_from_flu(views.up_flu)[:, None]
    offset = np.where(views.visible[..., None], frames.rotate(level, rel), 0.0)
    left, gradient = params.keep_out.distance(offset, views.grown_m)
    seen = views.visible & (np.abs(gradient).max(axis=-1) > 0.0)
    normals = np.where(seen[..., None], frames.rotate_back(level, gradient), 0.0)
    return np.where(seen, left, np.inf), normals


def project(vel: FloatArray, normals: FloatArray, bounds: FloatArray) -> tuple[FloatArray, bool]:
    """Finds the nearest velocity within bounds: min |u - vel| subject to normals u <= bounds.

    Solved as a least-distance problem by nonnegative least squares (Lawson and Hanson, Solving Least Squares Problems,
    chapter 23): an active-set method, exact after finitely many steps, deterministic.

    Args:
        vel: shape (3,).
        normals: shape (k, 3).
        bounds: shape (k,).

    Returns:
        The velocity, and whether the bounds contradict each other. Then a common violation s >= 0 is allowed to all
        of them and made as small as is worth it: min |u - vel|^2 + weight s^2.
    """
    step = _least_distance(-normals, normals @ vel - bounds)
    if step is not None:
        return vel + step, False
    widened = np.concatenate([-normals, np.full((len(normals), 1), 1.0 / np.sqrt(_SLACK_WEIGHT))], axis=1)
    step = _least_distance(widened, normals @ vel - bounds)
    return (np.zeros(3) if step is None else vel + step[:3]), True


def _least_distance(rows: FloatArray, least: FloatArray) -> FloatArray | None:
    """Shortest x with rows x >= least, or None where there is none."""
    size = rows.shape[1]
    system = np.concatenate([rows, least[:, None]], axis=1).T
    target = np.zeros(size + 1)
    target[-1] = 1.0
    weights, _ = nnls(system, target, maxiter=20 * len(rows) + 20)
    residual = system @ weights - target
    # residual[-1] = -|residual|^2 at the optimum: zero means that the target is reached, so nothing satisfies all.
    if -residual[-1] < 1e-9:
        return None
    return np.asarray(-residual[:size] / residual[-1], dtype=np.float64)
