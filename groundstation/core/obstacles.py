"""Things that stand in the way and are no vehicles: spheres, upright cylinders and boxes of known place.

All are convex, so the distance to one is convex too and never grows faster than an agent moves: the damper can hold it
as it holds distances between agents (docs/avoidance-why.md). Axes are those of whoever makes them, the third one
vertical. Knows no vehicles; refuses sizes that are not positive.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from groundstation.core.types import BoolArray, FloatArray

_BESIDE = 1.12
"""Points beside an obstacle lie this many times the distance to keep from it."""
_BEARINGS = 12
_TINY_M = 1e-9


@dataclass(frozen=True)
class Obstacle(ABC):
    """One of them.

    Attributes:
        name: for people.
        centre_m: shape (3,).
    """

    name: str
    centre_m: FloatArray
    kind: ClassVar[str]

    def moved(self, by_m: FloatArray) -> Self:
        """The same somewhere else."""
        return replace(self, centre_m=self.centre_m + by_m)

    @abstractmethod
    def distance(self, pos_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances from its surface, shape (n,), negative inside, and unit vectors away from it, shape (n, 3)."""

    @abstractmethod
    def beside_m(self, pos_m: FloatArray) -> FloatArray:
        """Horizontal distances from what it covers, seen from above, negative inside; positions (n, 2) or (n, 3)."""

    @abstractmethod
    def gauge_m(self, pos_m: FloatArray) -> FloatArray:
        """By how much it may be grown, for ``crossed``, so that points lie on its surface, shape (n,)."""

    @abstractmethod
    def crossed(self, start_m: FloatArray, end_m: FloatArray, grown_m: float) -> BoolArray:
        """Whether straight lines, shape (n, 3), meet it when it is grown by so much; edges are not rounded off."""

    @abstractmethod
    def around_m(self, keep_m: float) -> FloatArray:
        """Points around it by which it can be flown round at a distance, shape (k, 3)."""


@dataclass(frozen=True)
class SphereObstacle(Obstacle):
    """A ball."""

    radius_m: float
    kind = "sphere"

    def __post_init__(self) -> None:
        """Refuses sizes that are not positive."""
        _check(self.name, self.radius_m)

    def distance(self, pos_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """From its centre, less its radius."""
        offset = pos_m - self.centre_m
        length = np.linalg.norm(offset, axis=-1)
        away = np.where((length > _TINY_M)[:, None], offset / np.maximum(length, _TINY_M)[:, None], [0.0, 0.0, 1.0])
        return length - self.radius_m, away

    def beside_m(self, pos_m: FloatArray) -> FloatArray:
        """From the vertical through its centre."""
        return np.asarray(np.linalg.norm(pos_m[..., :2] - self.centre_m[:2], axis=-1) - self.radius_m)

    def gauge_m(self, pos_m: FloatArray) -> FloatArray:
        """Its distance."""
        return self.distance(pos_m)[0]

    def crossed(self, start_m: FloatArray, end_m: FloatArray, grown_m: float) -> BoolArray:
        """By the nearest point of each line."""
        return _nearest_m(start_m, end_m, self.centre_m) < self.radius_m + grown_m

    def around_m(self, keep_m: float) -> FloatArray:
        """In 26 directions, so far out that lines from one to the next keep the distance."""
        grid = _corners()
        return np.asarray(
            self.centre_m
            + (self.radius_m + _BESIDE * keep_m) / 0.9 * grid / np.linalg.norm(grid, axis=1, keepdims=True)
        )


@dataclass(frozen=True)
class CylinderObstacle(Obstacle):
    """An upright cylinder; its centre is half-way up."""

    radius_m: float
    height_m: float
    kind = "cylinder"

    def __post_init__(self) -> None:
        """Refuses sizes that are not positive."""
        _check(self.name, self.radius_m, self.height_m)

    def _beyond(self, pos_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far outside of wall and ends, shape (n, 2), and unit vectors outward from the axis, shape (n, 2)."""
        offset = pos_m - self.centre_m
        level = np.linalg.norm(offset[:, :2], axis=1)
        out = np.where((level > _TINY_M)[:, None], offset[:, :2] / np.maximum(level, _TINY_M)[:, None], [1.0, 0.0])
        return np.stack([level - self.radius_m, np.abs(offset[:, 2]) - 0.5 * self.height_m], axis=1), out

    def distance(self, pos_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """From wall, end or edge, whichever is nearest."""
        beyond, out = self._beyond(pos_m)
        length, share = _of_product(beyond)
        up = np.where(pos_m[:, 2] >= self.centre_m[2], 1.0, -1.0)
        return length, np.concatenate([share[:, :1] * out, (share[:, 1] * up)[:, None]], axis=1)

    def beside_m(self, pos_m: FloatArray) -> FloatArray:
        """From its circle."""
        return np.asarray(np.linalg.norm(pos_m[..., :2] - self.centre_m[:2], axis=-1) - self.radius_m)

    def gauge_m(self, pos_m: FloatArray) -> FloatArray:
        """The larger one of both."""
        return np.asarray(self._beyond(pos_m)[0].max(axis=1))

    def crossed(self, start_m: FloatArray, end_m: FloatArray, grown_m: float) -> BoolArray:
        """Where a line is within the heights and within the circle at once."""
        start, line = start_m - self.centre_m, end_m - start_m
        low, high = _within(start[:, 2], line[:, 2], 0.5 * self.height_m + grown_m)
        a = np.maximum((line[:, :2] ** 2).sum(axis=1), _TINY_M**2)
        b = (start[:, :2] * line[:, :2]).sum(axis=1)
        c = (start[:, :2] ** 2).sum(axis=1) - (self.radius_m + grown_m) ** 2
        root = b * b - a * c
        wide = np.sqrt(np.maximum(root, 0.0))
        low, high = np.maximum(low, (-b - wide) / a), np.minimum(high, (-b + wide) / a)
        return np.asarray((root > 0.0) & (low < high), dtype=np.bool_)

    def around_m(self, keep_m: float) -> FloatArray:
        """Twelve bearings below, half-way up and above, and the middles of the ends."""
        out = (self.radius_m + _BESIDE * keep_m) / np.cos(np.pi / _BEARINGS)
        up = 0.5 * self.height_m + _BESIDE * keep_m
        bearings = np.linspace(0.0, 2.0 * np.pi, _BEARINGS, endpoint=False)
        ring = np.stack([out * np.cos(bearings), out * np.sin(bearings), np.zeros(_BEARINGS)], axis=1)
        heights = np.array([[0.0, 0.0, k * up] for k in (-1.0, 0.0, 1.0)])
        points = (ring[None] + heights[:, None]).reshape(-1, 3)
        return np.asarray(self.centre_m + np.concatenate([points, heights[[0, 2]]]))


@dataclass(frozen=True)
class BoxObstacle(Obstacle):
    """A box along the axes; its size is from wall to wall, shape (3,)."""

    size_m: FloatArray
    kind = "box"

    def __post_init__(self) -> None:
        """Refuses sizes that are not positive."""
        _check(self.name, *self.size_m.tolist())

    def distance(self, pos_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """From wall, edge or corner, whichever is nearest."""
        offset = pos_m - self.centre_m
        length, share = _of_product(np.abs(offset) - 0.5 * self.size_m)
        return length, share * np.where(offset >= 0.0, 1.0, -1.0)

    def beside_m(self, pos_m: FloatArray) -> FloatArray:
        """From its rectangle."""
        return _of_product(np.abs(pos_m[..., :2] - self.centre_m[:2]) - 0.5 * self.size_m[:2])[0]

    def gauge_m(self, pos_m: FloatArray) -> FloatArray:
        """The largest one of three."""
        return np.asarray((np.abs(pos_m - self.centre_m) - 0.5 * self.size_m).max(axis=1))

    def crossed(self, start_m: FloatArray, end_m: FloatArray, grown_m: float) -> BoolArray:
        """Where a line is between all walls at once."""
        start, line = start_m - self.centre_m, end_m - start_m
        low, high = np.zeros(len(start)), np.ones(len(start))
        for axis in range(3):
            enters, leaves = _within(start[:, axis], line[:, axis], 0.5 * float(self.size_m[axis]) + grown_m)
            low, high = np.maximum(low, enters), np.minimum(high, leaves)
        return np.asarray(low < high, dtype=np.bool_)

    def around_m(self, keep_m: float) -> FloatArray:
        """Its corners, and the middles of edges and walls, so much farther out."""
        return np.asarray(self.centre_m + _corners() * (0.5 * self.size_m + _BESIDE * keep_m))


@dataclass(frozen=True)
class Obstacles:
    """All obstacles of a place, and what is kept from them.

    Attributes:
        bodies: they.
        keep_m: distance that agents keep from every surface: r, and what a position may be off.
    """

    bodies: tuple[Obstacle, ...] = ()
    keep_m: float = 0.0

    def __len__(self) -> int:
        """How many."""
        return len(self.bodies)

    def distances(self, pos_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances from each surface, shape (n, k), and unit vectors away from it, shape (n, k, 3)."""
        found = [body.distance(pos_m) for body in self.bodies]
        if not found:
            return np.zeros((len(pos_m), 0)), np.zeros((len(pos_m), 0, 3))
        return np.stack([one for one, _ in found], axis=1), np.stack([one for _, one in found], axis=1)

    def nearest(self, pos_m: FloatArray) -> tuple[float, str, int]:
        """The smallest distance of any position, shape (n, 3), from any surface, with its obstacle and row."""
        distance, _ = self.distances(pos_m)
        if not distance.size:
            return float("inf"), "", 0
        row, body = (int(k) for k in np.unravel_index(int(np.argmin(distance)), distance.shape))
        return float(distance[row, body]), self.bodies[body].name, row

    def beside_m(self, pos_m: FloatArray) -> FloatArray:
        """Smallest horizontal distance from what they cover, seen from above, shape (n,)."""
        nowhere: FloatArray = np.full(len(pos_m), np.inf)
        return np.asarray(np.min([nowhere, *(body.beside_m(pos_m) for body in self.bodies)], axis=0))

    def seen_from(self, pos_m: FloatArray) -> Obstacles:
        """The same relative to a place, shape (3,)."""
        return replace(self, bodies=tuple(body.moved(-pos_m) for body in self.bodies))


def _of_product(beyond_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance from a product of intervals, and its gradient, by how far beyond each a point is, shape (n, k)."""
    outside = np.maximum(beyond_m, 0.0)
    length = np.sqrt((outside * outside).sum(axis=1))
    nearest = beyond_m == beyond_m.max(axis=1, keepdims=True)
    inward = nearest & (np.cumsum(nearest, axis=1) == 1)
    inside = length <= 0.0
    share = np.where(inside[:, None], inward, outside / np.where(inside, 1.0, length)[:, None])
    return np.where(inside, beyond_m.max(axis=1), length), share


def _within(start: FloatArray, line: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
    """From where to where along each line, 0 to 1, a coordinate is within a half width; from > to where never."""
    flat = np.abs(line) < _TINY_M
    slope = np.where(flat, 1.0, line)
    first, second = (-half - start) / slope, (half - start) / slope
    low, high = np.minimum(first, second), np.maximum(first, second)
    never = flat & (np.abs(start) >= half)
    low, high = np.where(flat, 0.0, low), np.where(flat, 1.0, high)
    return np.where(never, 1.0, np.maximum(low, 0.0)), np.where(never, 0.0, np.minimum(high, 1.0))


def _nearest_m(start_m: FloatArray, end_m: FloatArray, point_m: FloatArray) -> FloatArray:
    """Distance of a point from straight lines, shape (n,)."""
    line = end_m - start_m
    square = np.maximum((line * line).sum(axis=1), _TINY_M**2)
    along = np.clip(((point_m - start_m) * line).sum(axis=1) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(start_m + along[:, None] * line - point_m, axis=1))


def _corners() -> FloatArray:
    """The 26 points of a cube's corners, middles of edges and of faces."""
    axes = np.meshgrid(*[np.array([-1.0, 0.0, 1.0])] * 3, indexing="ij")
    grid = np.stack(axes, axis=-1).reshape(-1, 3)
    return np.asarray(grid[np.abs(grid).sum(axis=1) > 0.0])


def _check(name: str, *sizes_m: float) -> None:
    if not all(0.0 < size < np.inf for size in sizes_m):
        raise ValueError(f"obstacle {name}: sizes are {list(sizes_m)} m, must be positive")


def clear_of(bodies: Sequence[Obstacle], pos_m: FloatArray, keep_m: float) -> BoolArray:
    """Whether points, shape (n, 3), lie outside of all obstacles that are grown by so much, as ``crossed`` has it."""
    free = np.ones(len(pos_m), dtype=np.bool_)
    for body in bodies:
        free &= body.gauge_m(pos_m) >= keep_m
    return free
