"""Directions that spheres block: caps on the unit sphere of directions, and where the nearest way out may lie.

The direction nearest to a wanted one outside of all caps is the wanted one itself, or it lies on the rim of a cap: then
it is the point of one rim that is nearest to the wanted direction, or a point where two rims cross. These are finitely
many, so the answer is found from the geometry and not by sampling. K caps give K + K (K - 1) candidates.

Knows directions only, no distances and no speeds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, Self

import numpy as np

from groundstation.core.quick import some
from groundstation.core.types import BoolArray, FloatArray, IntArray

RIM_CLEARANCE_RAD = 1e-9
"""How far outside the rim the candidates lie, so that rounding cannot put them inside."""

_DEGENERATE = 1e-9
"""Below this sine two directions count as one (or as opposite): no plane and no crossing is built from them."""


class Blocked(Protocol):
    """Directions that the regions of n others block for m agents."""

    @property
    def active(self) -> BoolArray:
        """Who blocks anything, shape (m, n)."""

    def meets(self, direction: FloatArray) -> BoolArray:
        """Whether unit directions (m, c, 3) lead into the regions, shape (m, c, n); anything where not active."""

    def candidates(self, direction: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Directions (m, c, 3), and which exist (m, c): the free one nearest to (m, 3) is among them."""

    def preference(self, candidates: FloatArray, direction: FloatArray) -> FloatArray | float:
        """What decides between candidates that are equally near, (m, c): far below what matters otherwise."""

    def take(self, rows: IntArray, columns: IntArray) -> Self:
        """Keeps those of the agents and of the others that index arrays (k, 1) and (k, w) name."""

    @staticmethod
    def work(width: int) -> int:
        """Numbers that an agent with so many others around costs in memory."""


@dataclass(frozen=True)
class Caps:
    """Blocked directions of m agents: all directions closer than an angle to a centre.

    Attributes:
        centre: unit vectors, shape (m, n, 3); anything where not active.
        cos_half: cosine of the half angle, shape (m, n); 0 means that a whole half space is blocked.
        sin_half: sine of the half angle, shape (m, n).
        active: the cap exists, shape (m, n).
    """

    centre: FloatArray
    cos_half: FloatArray
    sin_half: FloatArray
    active: BoolArray

    def meets(self, direction: FloatArray) -> BoolArray:
        """Directions (m, c, 3) inside of the caps, shape (m, c, n)."""
        along = dot(direction[:, :, None], self.centre[:, None])
        return np.asarray(along > self.cos_half[:, None], dtype=np.bool_)

    def candidates(self, direction: FloatArray) -> tuple[FloatArray, BoolArray]:
        """The nearest point of each rim, and the crossings of rims."""
        singles, singles_ok = self._nearest_on_rims(direction)
        crossings, crossings_ok = self.rim_crossings()
        return np.concatenate([singles, crossings], axis=1), np.concatenate([singles_ok, crossings_ok], axis=1)

    def preference(self, candidates: FloatArray, direction: FloatArray) -> float:
        """The first one, in the order of the candidates."""
        del candidates, direction
        return 0.0

    def take(self, rows: IntArray, columns: IntArray) -> Caps:
        """Keeps some."""
        pick = (rows, columns)
        return Caps(self.centre[pick], self.cos_half[pick], self.sin_half[pick], self.active[pick])

    @staticmethod
    def work(width: int) -> int:
        """As many candidates as squares, each held against all caps."""
        return width**3

    def rims(self) -> tuple[FloatArray, FloatArray]:
        """Cosine and sine of the half angles, a hair wider."""
        cos_eps, sin_eps = np.cos(RIM_CLEARANCE_RAD), np.sin(RIM_CLEARANCE_RAD)
        cos_rim = self.cos_half * cos_eps - self.sin_half * sin_eps
        sin_rim = self.sin_half * cos_eps + self.cos_half * sin_eps
        return cos_rim, sin_rim

    def rim_crossings(self) -> tuple[FloatArray, BoolArray]:
        """The points where the rims of two caps cross, shape (m, n (n - 1), 3), and where they exist.

        With unit centres a, b and g = a.b, a point p on both rims has p.a = cos(half_a), p.b = cos(half_b), so
        p = (alpha a + beta b) +- gamma (a x b), alpha = (cos_a - g cos_b) / (1 - g^2), beta likewise, and gamma from
        |p| = 1.
        """
        cos_rim, _ = self.rims()
        first, second = pairs(self.active.shape[1])
        centre = np.where(self.active[..., None], self.centre, 0.0)
        a, b = centre[:, first], centre[:, second]
        cos_a, cos_b = cos_rim[:, first], cos_rim[:, second]
        normal = cross(a, b)
        square = dot(normal, normal)  # 1 - g^2, without its cancellation
        apart = self.active[:, first] & self.active[:, second] & (square > _DEGENERATE**2)
        square = np.where(apart, square, 1.0)
        g = dot(a, b)
        alpha = (cos_a - g * cos_b) / square
        beta = (cos_b - g * cos_a) / square
        middle = alpha[..., None] * a + beta[..., None] * b
        rest = 1.0 - dot(middle, middle)
        crossing = apart & (rest >= 0.0)
        aside = np.sqrt(np.where(crossing, rest, 0.0) / square)[..., None] * normal
        points = np.concatenate([middle + aside, middle - aside], axis=1)
        return points, np.concatenate([crossing, crossing], axis=1)

    def _nearest_on_rims(self, direction: FloatArray) -> tuple[FloatArray, BoolArray]:
        """The point of each cap's rim nearest to the desired direction, shape (m, n, 3), and where it exists."""
        cos_rim, sin_rim = self.rims()
        centre = np.where(self.active[..., None], self.centre, 0.0)
        along = dot(direction[:, None], centre)
        away = direction[:, None] - along[..., None] * centre
        length = np.sqrt(dot(away, away))
        degenerate = length < _DEGENERATE
        if some(degenerate):
            away = np.where(degenerate[..., None], to_the_right(centre), away)
            length = np.sqrt(dot(away, away))
        unit = away / np.where(length > 0.0, length, 1.0)[..., None]
        return cos_rim[..., None] * centre + sin_rim[..., None] * unit, self.active


def caps_of(offset: FloatArray, distance: FloatArray, radius: FloatArray, active: BoolArray) -> Caps:
    """Caps of balls: half angle asin(radius / distance), 90 degrees from the surface inwards.

    Args:
        offset: to the centres, shape (m, n, 3).
        distance: their lengths, shape (m, n).
        radius: of the balls, shape (m, n).
        active: which count, shape (m, n).
    """
    safe = np.where(active, distance, 1.0)
    sin_half = np.minimum(radius / safe, 1.0)
    return Caps(
        centre=offset / safe[..., None], cos_half=np.sqrt(1.0 - sin_half * sin_half), sin_half=sin_half, active=active
    )


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Dot product over the last axis, term by term (the same rounding for any batch)."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2], dtype=np.float64)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product over the last axis; np.cross costs several times as much for small batches."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def to_the_right(centre: FloatArray) -> FloatArray:
    """A direction square to each centre: its right hand, z up; looking up or down, minus or plus y."""
    x, y, z = centre[..., 0], centre[..., 1], centre[..., 2]
    zero = np.zeros_like(x)
    vertical = (np.abs(x) < _DEGENERATE) & (np.abs(y) < _DEGENERATE)
    right = np.stack([y, -x, zero], axis=-1)
    return np.where(vertical[..., None], np.stack([zero, -z, y], axis=-1), right)


@lru_cache(maxsize=256)
def pairs(k: int) -> tuple[IntArray, IntArray]:
    """All pairs a < b of k things."""
    first, second = np.triu_indices(k, 1)
    return first.astype(np.int64), second.astype(np.int64)
