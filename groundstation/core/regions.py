"""Safety regions: the shape around every agent that others stay out of, in metres and upright in the world.

A sphere is the paper's. What flies above another blows down on it: a cylinder and an ellipsoid reach farther up and
down than to the sides. Both stand upright in the world, so an agent needs to know where up is; its attitude says so.

Two measures belong to a shape. Its clearance is its own norm: below 1 inside, 1 on the surface, above 1 outside. Its
distance is a length: negative inside, 0 on the surface, never growing faster than an agent moves, and convex. The
damper keeps the distance above 0 and its argument rests on these properties (docs/avoidance-why.md).

Refuses sizes that are not positive, and regions that contain their own activation distance.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from groundstation.core.caps import Blocked, Caps, caps_of
from groundstation.core.cones import CylinderCones, EllipsoidCones, cylinder_cones, ellipsoid_cones
from groundstation.core.types import BoolArray, FloatArray

_NOWHERE_M = 1e-9
"""Nearer than that there is no direction from one agent to another."""


@dataclass(frozen=True)
class SafetyRegion(ABC):
    """A shape around every agent that others stay out of.

    Attributes:
        radius_m: r > 0, half the width.
        activation_m: d >= r; others are avoided from the shape on that is d / r times as large.
    """

    radius_m: float
    activation_m: float

    name: ClassVar[str]
    by_distance: ClassVar[bool] = False
    """Two are clear of each other by their distance alone, wherever up is; clearance is distance over r."""

    def __post_init__(self) -> None:
        """Refuses radii that are not 0 < r <= d."""
        if not 0.0 < self.radius_m <= self.activation_m < math.inf:
            raise ValueError(
                f"safety {self.name}: radius {self.radius_m} m and activation {self.activation_m} m, "
                "must be 0 < radius <= activation"
            )

    @abstractmethod
    def grown(self, by_m: float) -> Self:
        """The region that holds everything within a distance of this one, activation included.

        Both positions of a pair may be off, together by up to that distance: reported positions outside of the grown
        region are true positions outside of this one.
        """

    @abstractmethod
    def clearance(self, offset_m: FloatArray) -> FloatArray:
        """The region's own norm of offsets (..., 3), third axis vertical: below 1 is inside."""

    @abstractmethod
    def distance(self, offset_m: FloatArray, extra_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far offsets are outside of the region, and where that changes fastest.

        Args:
            offset_m: shape (..., 3), third axis vertical.
            extra_m: by how much the region is larger there, shape (...).

        Returns:
            Distances (...), negative inside, and their gradients (..., 3), none longer than 1; zero where there is
            no direction.
        """

    @abstractmethod
    def blocked(self, offset_m: FloatArray, visible: BoolArray, extra_m: FloatArray) -> Blocked:
        """The directions that lead into it, for those that it is active for.

        Args:
            offset_m: from m agents to n others, shape (m, n, 3); level axes, any where ``by_distance``.
            visible: those that are known, shape (m, n).
            extra_m: by how much the region around each is larger, shape (m, n).
        """

    def near_words(self, apart_m: float, clearance: float) -> str:
        """Says of two that are inside of it how near they are to each other.

        Args:
            apart_m: their distance.
            clearance: the same in the region's own norm.
        """
        if self.by_distance:
            return f"{apart_m:.2f} m apart, minimum is {self.radius_m:g} m"
        return f"{apart_m:.2f} m apart, {clearance:.0%} of what their safety region asks for"

    def size_words(self) -> str:
        """Its sizes, by the keys that a mission gives them."""
        return f"avoidance.radius_m {self.radius_m:g} m"

    @abstractmethod
    def reach_m(self, beyond_m: float) -> float:
        """Euclidean distance from which on everybody is farther than ``beyond_m`` outside of the region."""

    @abstractmethod
    def room_m(self, offset_m: FloatArray) -> float:
        """By how much the region can grow before it holds the first of the offsets (k, 3); negative: by none."""


@dataclass(frozen=True)
class SafetySphere(SafetyRegion):
    """The paper's safety region: a ball of radius r around every agent nearer than d."""

    name: ClassVar[str] = "sphere"
    by_distance: ClassVar[bool] = True

    def grown(self, by_m: float) -> Self:
        """Radius and activation larger by the distance."""
        return replace(self, radius_m=self.radius_m + by_m, activation_m=self.activation_m + by_m)

    def clearance(self, offset_m: FloatArray) -> FloatArray:
        """Distance over r."""
        return np.asarray(_length(offset_m) / self.radius_m, dtype=np.float64)

    def distance(self, offset_m: FloatArray, extra_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance less r."""
        length = _length(offset_m)
        unit = offset_m / np.where(length > _NOWHERE_M, length, np.inf)[..., None]
        return length - self.radius_m - extra_m, unit

    def blocked(self, offset_m: FloatArray, visible: BoolArray, extra_m: FloatArray) -> Caps:
        """Caps of half angle asin(r / distance); 90 degrees from r inwards, so that one can only part.

        A coincident agent (distance below 1e-9 m) has no direction and blocks none: any motion parts.
        """
        distance = _length(offset_m)
        # Comparisons with NaN (not visible) are False.
        active = visible & (distance < self.activation_m + extra_m) & (distance > _NOWHERE_M)
        return caps_of(offset_m, distance, self.radius_m + extra_m, np.asarray(active, dtype=np.bool_))

    def reach_m(self, beyond_m: float) -> float:
        """The radius and what is beyond."""
        return self.radius_m + beyond_m

    def room_m(self, offset_m: FloatArray) -> float:
        """Shortest offset less r."""
        return float(_length(offset_m).min(initial=math.inf)) - self.radius_m


@dataclass(frozen=True)
class UprightRegion(SafetyRegion):
    """A region that is as wide as a sphere and higher, or less high.

    Attributes:
        half_height_m: h > 0, how far it reaches up, and down.
    """

    half_height_m: float

    def __post_init__(self) -> None:
        """Refuses what a sphere refuses, and heights that are not positive."""
        super().__post_init__()
        if not 0.0 < self.half_height_m < math.inf:
            raise ValueError(f"safety {self.name}: half height is {self.half_height_m} m, must be positive")

    def size_words(self) -> str:
        """Its height, too."""
        return f"{super().size_words()} and half_height_m {self.half_height_m:g} m"

    @property
    def _growth(self) -> float:
        """How much larger the sizes have to be than the distance by which the region grows."""
        return 1.0

    @abstractmethod
    def sizes(self, extra_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radius and half height where the region is larger by an extra distance, both of the extra's shape."""

    def activation_clearance(self, extra_m: FloatArray) -> FloatArray:
        """How many times as large as the region, with its extra distance, its activation region is."""
        radius_m, _ = self.sizes(extra_m)
        return np.asarray(1.0 + (self.activation_m - self.radius_m) / radius_m, dtype=np.float64)

    def grown(self, by_m: float) -> Self:
        """Radius and half height larger, and the activation distance too."""
        by_m = self._growth * by_m
        return replace(
            self,
            radius_m=self.radius_m + by_m,
            activation_m=self.activation_m + by_m,
            half_height_m=self.half_height_m + by_m,
        )


@dataclass(frozen=True)
class SafetyCylinder(UprightRegion):
    """An upright cylinder of radius r that reaches h up and down."""

    name: ClassVar[str] = "cylinder"

    def sizes(self, extra_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Larger by the extra distance each."""
        return self.radius_m + extra_m, self.half_height_m + extra_m

    def clearance(self, offset_m: FloatArray) -> FloatArray:
        """The larger of what the side and what the faces leave."""
        return np.maximum(_across(offset_m) / self.radius_m, np.abs(offset_m[..., 2]) / self.half_height_m)

    def distance(self, offset_m: FloatArray, extra_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Euclidean distance to the surface: to the side, to a face, or to the edge between them."""
        across, z = _across(offset_m), offset_m[..., 2]
        radius, half = self.sizes(extra_m)
        aside, above = across - radius, np.abs(z) - half
        outside = np.sqrt(np.maximum(aside, 0.0) ** 2 + np.maximum(above, 0.0) ** 2)
        within = np.maximum(aside, above)
        distance = np.where(within > 0.0, outside, within)
        # Outside both parts count by what they add; inside only the nearer surface does.
        length = np.where(outside > 0.0, outside, 1.0)
        share_aside = np.where(within > 0.0, np.maximum(aside, 0.0) / length, aside >= above)
        share_above = np.where(within > 0.0, np.maximum(above, 0.0) / length, aside < above)
        unit = offset_m[..., :2] / np.where(across > _NOWHERE_M, across, np.inf)[..., None]
        upwards = share_above * np.sign(z)
        return distance, np.concatenate([share_aside[..., None] * unit, upwards[..., None]], axis=-1)

    def blocked(self, offset_m: FloatArray, visible: BoolArray, extra_m: FloatArray) -> CylinderCones:
        """What its side and its faces hide."""
        offset_m = np.where(visible[..., None], offset_m, np.inf)
        radius, half = self.sizes(extra_m)
        across = np.asarray(np.hypot(offset_m[..., 0], offset_m[..., 1]))
        clearance = np.maximum(across / radius, np.abs(offset_m[..., 2]) / half)
        active = visible & (clearance < self.activation_clearance(extra_m))
        offset_m = np.where(active[..., None], offset_m, 0.0)
        return cylinder_cones(offset_m, active, (radius, half), self.distance(offset_m, extra_m))

    def reach_m(self, beyond_m: float) -> float:
        """The edge is farthest."""
        return math.hypot(self.radius_m, self.half_height_m) + beyond_m

    def room_m(self, offset_m: FloatArray) -> float:
        """The larger of what is left aside and above, the smallest of all."""
        aside = _across(offset_m) - self.radius_m
        above = np.abs(offset_m[..., 2]) - self.half_height_m
        return float(np.maximum(aside, above).min(initial=math.inf))


@dataclass(frozen=True)
class SafetyEllipsoid(UprightRegion):
    """An upright ellipsoid of revolution with the half axes r, r and h."""

    name: ClassVar[str] = "ellipsoid"

    @property
    def _growth(self) -> float:
        """(r + h) / (2 sqrt(r h)).

        All within a distance e of an ellipsoid is no ellipsoid. One with half axes larger by k e holds it if its width
        in every direction does: (r + k e)^2 c + (h + k e)^2 s >= (sqrt(r^2 c + h^2 s) + e)^2 for c + s = 1, c, s >= 0.
        For k >= 1 that follows from k (r c + h s) >= sqrt(r^2 c + h^2 s), whose ratio Kantorovich's inequality bounds.
        """
        return (self.radius_m + self.half_height_m) / (2.0 * math.sqrt(self.radius_m * self.half_height_m))

    def sizes(self, extra_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Larger in proportion, so that all regions keep one shape and one scaling makes balls of all."""
        times = 1.0 + extra_m / min(self.radius_m, self.half_height_m)
        return self.radius_m * times, self.half_height_m * times

    def clearance(self, offset_m: FloatArray) -> FloatArray:
        """Length in space scaled so that the region is the unit ball."""
        scale = np.array([1.0 / self.radius_m, 1.0 / self.radius_m, 1.0 / self.half_height_m])
        return np.asarray(_length(offset_m * scale), dtype=np.float64)

    def distance(self, offset_m: FloatArray, extra_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance to the surface in space scaled so that the region is a ball of its smaller half axis.

        Not the Euclidean distance, which it never exceeds: along the longer axis it counts in the region's own measure.
        """
        radius, half = self.sizes(extra_m)
        smaller = np.minimum(radius, half)
        wide, high = smaller / radius, smaller / half
        scaled = np.stack([offset_m[..., 0] * wide, offset_m[..., 1] * wide, offset_m[..., 2] * high], axis=-1)
        length = _length(scaled)
        scaled = scaled / np.where(length > _NOWHERE_M, length, np.inf)[..., None]
        return length - smaller, scaled * np.stack([wide, wide, high], axis=-1)

    def blocked(self, offset_m: FloatArray, visible: BoolArray, extra_m: FloatArray) -> EllipsoidCones:
        """What it hides; scaled vertically it is a ball."""
        radius, _ = self.sizes(extra_m)
        squeeze = self.radius_m / self.half_height_m
        return ellipsoid_cones(offset_m, visible, radius, self.activation_clearance(extra_m), squeeze=squeeze)

    def reach_m(self, beyond_m: float) -> float:
        """Along the longer axis, where the scaled distance grows most slowly."""
        smaller, larger = sorted((self.radius_m, self.half_height_m))
        return larger + beyond_m * larger / smaller

    def room_m(self, offset_m: FloatArray) -> float:
        """Found by halving an interval: how far both half axes can grow together, over the growth per distance."""
        across, above = _across(offset_m), np.abs(offset_m[..., 2])
        if across.size == 0:
            return math.inf
        low = -min(self.radius_m, self.half_height_m) * np.ones_like(across)
        high = np.sqrt(across * across + above * above)  # both half axes longer than the offset: inside for sure
        for _ in range(60):
            middle = 0.5 * (low + high)
            wide, tall = self.radius_m + middle, self.half_height_m + middle
            inside = (across * tall) ** 2 + (above * wide) ** 2 < (wide * tall) ** 2
            low, high = np.where(inside, low, middle), np.where(inside, middle, high)
        return float(low.min()) / self._growth


REGIONS: dict[str, type[SafetySphere | SafetyCylinder | SafetyEllipsoid]] = {
    shape.name: shape for shape in (SafetySphere, SafetyCylinder, SafetyEllipsoid)
}


def build_region(shape: str, radius_m: float, activation_m: float, half_height_m: float) -> SafetyRegion:
    """Builds a region by the name of its shape; a sphere takes no notice of the half height.

    Raises:
        ValueError: sizes.
        KeyError: no such shape.
    """
    if shape == SafetySphere.name:
        return SafetySphere(radius_m, activation_m)
    kind = {SafetyCylinder.name: SafetyCylinder, SafetyEllipsoid.name: SafetyEllipsoid}[shape]
    return kind(radius_m, activation_m, half_height_m)


def rot_level_from_flu(up_flu: FloatArray) -> FloatArray:
    """Rotations from body axes to level ones: z up, x as near to forward as can be.

    Args:
        up_flu: unit vectors, up as each agent's attitude knows it, shape (m, 3).

    Returns:
        Shape (m, 3, 3).
    """
    # Looking straight up or down there is no level forward; then it is what was to the left.
    steep = np.abs(up_flu[:, 0]) > 0.9
    ahead = np.where(steep[:, None], np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    along = np.where(steep, up_flu[:, 1], up_flu[:, 0])
    x = ahead - along[:, None] * up_flu
    x = x / _length(x)[:, None]
    y = np.stack(
        [
            up_flu[:, 1] * x[:, 2] - up_flu[:, 2] * x[:, 1],
            up_flu[:, 2] * x[:, 0] - up_flu[:, 0] * x[:, 2],
            up_flu[:, 0] * x[:, 1] - up_flu[:, 1] * x[:, 0],
        ],
        axis=-1,
    )
    return np.stack([x, y, up_flu], axis=1)


def _length(vector: FloatArray) -> FloatArray:
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    return np.asarray(np.sqrt(x * x + y * y + z * z), dtype=np.float64)


def _across(vector: FloatArray) -> FloatArray:
    x, y = vector[..., 0], vector[..., 1]
    return np.asarray(np.sqrt(x * x + y * y), dtype=np.float64)
