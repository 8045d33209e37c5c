"""A judge for Algorithm 2: searches directions, and around upright regions walks along rays instead of solving them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from groundstation.core.types import BoolArray, FloatArray


def fibonacci_sphere(count: int) -> FloatArray:
    """Evenly spread unit vectors."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    azimuth = np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)


@dataclass(frozen=True)
class Shape:
    """A region as the tests see it: its norm, and how it is left."""

    kind: str
    radius: float
    half: float

    def norm(self, offset: FloatArray) -> FloatArray:
        across = np.hypot(offset[..., 0], offset[..., 1]) / self.radius
        above = np.abs(offset[..., 2]) / self.half
        return np.asarray(np.hypot(across, above) if self.kind == "ellipsoid" else np.maximum(across, above))

    def depth(self, offset: FloatArray) -> FloatArray:
        """What grows while one leaves from inside: the norm; of a cylinder, in metres to the nearer surface."""
        if self.kind == "ellipsoid":
            return self.norm(offset)
        across = np.hypot(offset[..., 0], offset[..., 1])
        return np.asarray(np.maximum(across - self.radius, np.abs(offset[..., 2]) - self.half))

    def nearest_along(self, direction: FloatArray, offset: FloatArray) -> FloatArray:
        """Smallest norm along rays (k, 3) from the origin, of each region at (n, 3): shape (k, n)."""
        low = np.zeros((len(direction), len(offset)))
        high = low + 2.0 * np.linalg.norm(offset, axis=-1) + 1.0
        ratio = (np.sqrt(5.0) - 1.0) / 2.0

        def at(t: FloatArray) -> FloatArray:
            return self.norm(offset[None] - t[..., None] * direction[:, None])

        for _ in range(70):
            one, two = high - ratio * (high - low), low + ratio * (high - low)
            nearer = at(one) < at(two)
            low, high = np.where(nearer, low, one), np.where(nearer, two, high)
        return at(0.5 * (low + high))

    def free(self, direction: FloatArray, offset: FloatArray, slack: float = 0.0) -> BoolArray:
        """Whether rays (k, 3) stay out of all regions (n, 3): outside by the ray, inside by parting; shape (k,)."""
        clear = self.outside_by(direction, offset)
        inside = self.norm(offset) < 1.0
        step = 1e-7
        parts = self.depth(offset[None] - step * direction[:, None]) - self.depth(offset)[None]
        free = np.where(inside, parts >= -step * (1e-7 + slack), clear >= -slack)
        return np.asarray(free.all(axis=1), dtype=np.bool_)

    def outside_by(self, direction: FloatArray, offset: FloatArray) -> FloatArray:
        """Above or at 0 where rays (k, 3) stay out of regions (n, 3), by how much in no particular measure: (k, n)."""
        if self.kind == "ellipsoid":
            scale = np.array([1.0 / self.radius, 1.0 / self.radius, 1.0 / self.half])
            ahead, to = direction * scale, offset * scale
            along = (ahead @ to.T) / np.linalg.norm(ahead, axis=1)[:, None]
            miss = (to**2).sum(axis=1)[None] - along**2 - 1.0
            return np.asarray(np.where(along <= 0.0, 1.0, miss))
        # A cylinder: over the azimuths that it spans, elevations between two tangents are blocked.
        rho = np.hypot(offset[:, 0], offset[:, 1])[None]
        bearing = np.arctan2(offset[:, 1], offset[:, 0])[None]
        azimuth = np.arctan2(direction[:, 1], direction[:, 0])[:, None] - bearing
        reach_square = self.radius**2 - (rho * np.sin(azimuth)) ** 2
        half_chord = np.sqrt(np.maximum(reach_square, 0.0))
        near, far = rho * np.cos(azimuth) - half_chord, rho * np.cos(azimuth) + half_chord
        top, bottom = offset[:, 2][None] + self.half, offset[:, 2][None] - self.half
        flat = np.hypot(direction[:, 0], direction[:, 1])[:, None]
        up = direction[:, 2][:, None]
        near = np.maximum(near, 0.0)  # over or under it: the ray starts within the side
        # Some t between near and far with bottom < t up / flat < top, in units of the horizontal way.
        high = np.maximum(up * near, up * far) - bottom * flat
        low = top * flat - np.minimum(up * near, up * far)
        passes = (reach_square <= 0.0) | (far <= 0.0)
        beside = np.where(passes, 1.0, -np.minimum(high, low))
        vertical = np.where((rho < self.radius) & (up * offset[:, 2][None] > 0.0), rho - self.radius, 1.0)
        return np.asarray(np.where(flat < 1e-12, vertical, beside))


def best_by_search(
    free: Callable[[FloatArray], BoolArray], wanted: FloatArray, spread: FloatArray, *, kept: int, tried: int
) -> float:
    """Smallest rotation to a free direction among many, the best ones searched around again and again.

    Args:
        free: which of the directions (k, 3) are free: shape (k,).
        wanted: unit vector, shape (3,).
        spread: unit vectors all around, shape (m, 3), m at least ``tried``.
        kept: how many of the best are searched around.
        tried: about how many directions around each.

    Returns:
        Angle in radians; inf where no direction is free.
    """

    def free_angles(directions: FloatArray) -> FloatArray:
        angle = np.arctan2(np.linalg.norm(np.cross(directions, wanted), axis=1), directions @ wanted)
        return np.where(free(directions), angle, np.inf)

    directions = np.concatenate([wanted[None], spread])
    angles = free_angles(directions)
    best = float(angles.min())
    if not 0.0 < best < np.inf:
        return best
    around = directions[np.argsort(angles)[:kept]]
    for size in (0.06, 0.02, 0.006, 0.002, 0.0006):
        near = (around[:, None] + size * spread[:: len(spread) // tried]).reshape(-1, 3)
        near = np.concatenate([around, near / np.linalg.norm(near, axis=1, keepdims=True)])
        angles = free_angles(near)
        around = near[np.argsort(angles)[:kept]]
        best = min(best, float(angles.min()))
    return best
