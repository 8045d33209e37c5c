"""Algorithm 2, exact: the smallest rotation of the desired velocity that leaves every safety region.

Seen from an agent, a safety region blocks a set of directions; a sphere blocks a cap, a round patch of the unit
sphere of directions. The desired direction is turned to the nearest direction outside all caps. That nearest
direction is the desired one itself, or it lies on the rim of a cap: then it is the point of one rim that is nearest
to the desired direction, or a point where two rims cross. These are finitely many, so the answer is found from the
geometry and not by sampling. Per agent with K near agents: 1 + K + K (K - 1) candidates, each held against K caps.

The rule is the paper's: it knows directions, not dynamics. On vehicles that lag it does not keep distances above
r; `damper` does. Refuses regions that contain their own activation distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.core.views import LocalViews

RIM_CLEARANCE_RAD = 1e-9
"""How far outside the rim the candidates lie, so that rounding cannot put them inside."""

_DEGENERATE = 1e-9
"""Below this sine two directions count as one (or as opposite): no plane and no crossing is built from them."""


@dataclass(frozen=True)
class Caps:
    """Blocked directions of m agents: all directions closer than an angle to a centre.

    Attributes:
        centre_flu: unit vectors, shape (m, n, 3); anything where not active.
        cos_half: cosine of the half angle, shape (m, n); 0 means that a whole half space is blocked.
        sin_half: sine of the half angle, shape (m, n).
        active: the cap exists, shape (m, n).
    """

    centre_flu: FloatArray
    cos_half: FloatArray
    sin_half: FloatArray
    active: BoolArray


class SafetyRegion(Protocol):
    """A shape around every agent that others stay out of, known by the directions that it blocks."""

    def caps(self, views: LocalViews) -> Caps:
        """Returns the caps of m agents; radius and activation grow by ``views.extra_m``."""


@dataclass(frozen=True)
class SafetySphere:
    """The paper's safety region: a ball of radius r around every agent nearer than d.

    Attributes:
        radius_m: r > 0.
        activation_m: d >= r; agents farther away are not avoided.
    """

    radius_m: float
    activation_m: float

    def __post_init__(self) -> None:
        """Refuses radii that are not 0 < r <= d."""
        if not 0.0 < self.radius_m <= self.activation_m:
            raise ValueError(
                f"safety sphere: radius {self.radius_m} m and activation {self.activation_m} m, "
                "must be 0 < radius <= activation"
            )

    def caps(self, views: LocalViews) -> Caps:
        """Returns caps of half angle asin(r / distance); 90 degrees from r inwards, so that one can only part.

        A coincident agent (distance below 1e-9 m) has no direction and blocks none: any motion parts.
        """
        rel_pos_flu_m = views.rel_pos_flu_m
        x, y, z = rel_pos_flu_m[..., 0], rel_pos_flu_m[..., 1], rel_pos_flu_m[..., 2]
        distance = np.sqrt(x * x + y * y + z * z)
        # Comparisons with NaN (not visible) are False.
        active = views.visible & (distance < self.activation_m + views.extra_m) & (distance > 1e-9)
        safe = np.where(active, distance, 1.0)
        sin_half = np.minimum((self.radius_m + views.extra_m) / safe, 1.0)
        return Caps(
            centre_flu=rel_pos_flu_m / safe[..., None],
            cos_half=np.sqrt(1.0 - sin_half * sin_half),
            sin_half=sin_half,
            active=active,
        )


@dataclass(frozen=True)
class Avoided:
    """What Algorithm 2 made of the desired velocities of m agents.

    Attributes:
        vel_flu_m_s: shape (m, 3); speeds as desired, or zero where blocked.
        blocked: wanted to move and no direction within 90 degrees is free, shape (m,). With zero output that is the
            paper's gridlock, if it lasts.
        angle_rad: rotation, shape (m,); 0 where nothing was in the way, pi/2 where blocked.
        in_the_way: agents whose region the desired direction meets, shape (m, n).
    """

    vel_flu_m_s: FloatArray
    blocked: BoolArray
    angle_rad: FloatArray
    in_the_way: BoolArray


def avoid(views: LocalViews, desired_flu_m_s: FloatArray, region: SafetyRegion) -> Avoided:
    """Turns desired velocities out of the safety regions of near agents (Algorithm 2, equation (13)).

    Ties are broken by the order of the candidates. Where the desired direction points at the very centre of a cap,
    every point of the rim is equally near: the agent goes to its right (looking along, z up), so that two agents head
    on pass each other instead of dancing.

    Args:
        views: what m agents see.
        desired_flu_m_s: shape (m, 3), body FLU of each agent.
        region: the safety region.

    Returns:
        New velocities and what happened; rows with nothing in the way come back unchanged.

    Raises:
        ValueError: shape, or a desired velocity that is not finite.
    """
    if desired_flu_m_s.shape != (views.viewers, 3) or not np.all(np.isfinite(desired_flu_m_s)):
        raise ValueError(f"desired velocities must be finite and of shape ({views.viewers}, 3)")
    caps = region.caps(views)
    m = views.viewers
    vel = desired_flu_m_s.copy()
    blocked = np.zeros(m, dtype=np.bool_)
    angle = np.zeros(m)
    in_the_way = np.zeros_like(caps.active)
    if not caps.active.any():
        return Avoided(vel, blocked, angle, in_the_way)
    speed = np.sqrt(_dot(vel, vel))
    moving = speed > 0.0
    direction = vel / np.where(moving, speed, 1.0)[:, None]
    in_the_way = caps.active & moving[:, None] & (_dot(direction[:, None], caps.centre_flu) > caps.cos_half)
    rows = np.flatnonzero(in_the_way.any(axis=1))
    if rows.size:
        turned, free = _nearest_free(direction[rows], _compress(caps, rows))
        vel[rows] = np.where(free[:, None], turned * speed[rows, None], 0.0)
        blocked[rows] = ~free
        cosine = np.clip(_dot(turned, direction[rows]), 0.0, 1.0)
        angle[rows] = np.where(free, np.arccos(cosine), np.pi / 2.0)
    return Avoided(vel, blocked, angle, in_the_way)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Dot product over the last axis, term by term (the same rounding for any batch)."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2], dtype=np.float64)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product over the last axis; np.cross costs several times as much for small batches."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _compress(caps: Caps, rows: IntArray) -> Caps:
    """Keeps the rows asked for, and moves their active caps to the front so that few columns remain."""
    active = caps.active[rows]
    width = int(active.sum(axis=1).max())
    order = np.argsort(~active, axis=1, kind="stable")[:, :width]
    pick = (rows[:, None], order)
    return Caps(caps.centre_flu[pick], caps.cos_half[pick], caps.sin_half[pick], caps.active[pick])


@lru_cache(maxsize=64)
def _pairs(k: int) -> tuple[IntArray, IntArray]:
    """All pairs a < b of k caps."""
    first, second = np.triu_indices(k, 1)
    return first.astype(np.int64), second.astype(np.int64)


def _nearest_free(direction: FloatArray, caps: Caps) -> tuple[FloatArray, BoolArray]:
    """Finds the free direction nearest to each desired one.

    Args:
        direction: unit vectors, shape (m, 3), each inside at least one of its caps.
        caps: shape (m, k).

    Returns:
        Unit vectors (m, 3) and whether one within 90 degrees exists (m,).
    """
    singles, singles_ok = _nearest_on_rims(direction, caps)
    crossings, crossings_ok = _rim_crossings(caps)
    candidates = np.concatenate([singles, crossings], axis=1)
    valid = np.concatenate([singles_ok, crossings_ok], axis=1)
    met = _dot(candidates[:, :, None], caps.centre_flu[:, None]) > caps.cos_half[:, None]
    free = valid & ~(met & caps.active[:, None]).any(axis=2)
    cosine = np.where(free, _dot(candidates, direction[:, None]), -np.inf)
    best = np.argmax(cosine, axis=1)
    row = np.arange(len(direction))
    # Within 90 degrees means strictly: a rotation of 90 degrees makes no progress and Theorem 2 does not cover it.
    return candidates[row, best], cosine[row, best] > 1e-12


def _nearest_on_rims(direction: FloatArray, caps: Caps) -> tuple[FloatArray, BoolArray]:
    """The point of each cap's rim nearest to the desired direction, shape (m, k, 3), and where it exists."""
    cos_rim, sin_rim = _outside(caps)
    centre = np.where(caps.active[..., None], caps.centre_flu, 0.0)
    along = _dot(direction[:, None], centre)
    away = direction[:, None] - along[..., None] * centre
    length = np.sqrt(_dot(away, away))
    degenerate = length < _DEGENERATE
    if degenerate.any():
        away = np.where(degenerate[..., None], _to_the_right(centre), away)
        length = np.sqrt(_dot(away, away))
    unit = away / np.where(length > 0.0, length, 1.0)[..., None]
    return cos_rim[..., None] * centre + sin_rim[..., None] * unit, caps.active


def _to_the_right(centre: FloatArray) -> FloatArray:
    """A direction square to each centre: its right hand, z up; looking up or down, minus or plus y."""
    x, y, z = centre[..., 0], centre[..., 1], centre[..., 2]
    zero = np.zeros_like(x)
    vertical = (np.abs(x) < _DEGENERATE) & (np.abs(y) < _DEGENERATE)
    right = np.stack([y, -x, zero], axis=-1)
    return np.where(vertical[..., None], np.stack([zero, -z, y], axis=-1), right)


def _rim_crossings(caps: Caps) -> tuple[FloatArray, BoolArray]:
    """The points where the rims of two caps cross, shape (m, k (k - 1), 3), and where they exist.

    With unit centres a, b and g = a.b, a point p on both rims has p.a = cos(half_a), p.b = cos(half_b), so
    p = (alpha a + beta b) +- gamma (a x b), alpha = (cos_a - g cos_b) / (1 - g^2), beta likewise, and gamma from
    |p| = 1.
    """
    cos_rim, _ = _outside(caps)
    first, second = _pairs(caps.active.shape[1])
    centre = np.where(caps.active[..., None], caps.centre_flu, 0.0)
    a, b = centre[:, first], centre[:, second]
    cos_a, cos_b = cos_rim[:, first], cos_rim[:, second]
    normal = _cross(a, b)
    square = _dot(normal, normal)  # 1 - g^2, without its cancellation
    apart = caps.active[:, first] & caps.active[:, second] & (square > _DEGENERATE**2)
    square = np.where(apart, square, 1.0)
    g = _dot(a, b)
    alpha = (cos_a - g * cos_b) / square
    beta = (cos_b - g * cos_a) / square
    middle = alpha[..., None] * a + beta[..., None] * b
    rest = 1.0 - _dot(middle, middle)
    crossing = apart & (rest >= 0.0)
    aside = np.sqrt(np.where(crossing, rest, 0.0) / square)[..., None] * normal
    points = np.concatenate([middle + aside, middle - aside], axis=1)
    return points, np.concatenate([crossing, crossing], axis=1)


def _outside(caps: Caps) -> tuple[FloatArray, FloatArray]:
    """Cosine and sine of the half angles, a hair wider."""
    cos_eps, sin_eps = np.cos(RIM_CLEARANCE_RAD), np.sin(RIM_CLEARANCE_RAD)
    cos_rim = caps.cos_half * cos_eps - caps.sin_half * sin_eps
    sin_rim = caps.sin_half * cos_eps + caps.cos_half * sin_eps
    return cos_rim, sin_rim
