"""Keeps the team where it is, and turned as it is: what the formation law leaves free.

The law knows relative positions alone, so nothing in it holds the team's middle or its heading: both wander with every
error that the vehicles share. A slow velocity, the same for everybody, and a slow turn about the middle take that back.
Both are motions of a rigid body, which change no distance; avoidance and limits see them as any commanded motion.
Unlike the law this needs the team frame. Refuses to hurry: it is limited to a share of the speed limit.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from groundstation.core.motion import Motion
from groundstation.core.quick import between, length, mean, norms, some
from groundstation.core.types import BoolArray, FloatArray

SPEED_SHARE = 0.2
"""Of the speed limit that keeping the place may ask for; the rest is for keeping the formation."""


@dataclass
class PlaceKeeper:
    """Where the team is to be, and the motion that brings it back there.

    Attributes:
        rate_1_s: share of the offset that is taken back in a second; 0 for the law alone.
        speed_limit_m_s: of the vehicles.
        place_enu_m: where the middle of those who count belongs, shape (3,); None before it is known.
        heading_rad: how the formation is to be turned against its points, counterclockwise; None while it is free.
    """

    rate_1_s: float
    speed_limit_m_s: float
    place_enu_m: FloatArray | None = None
    heading_rad: float | None = None
    _counted: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    _middle_enu_m: FloatArray = field(default_factory=lambda: np.zeros(3))

    def begin(self, pos_enu_m: FloatArray, counts: BoolArray, floor_m: float = -np.inf) -> None:
        """Takes the place of now for the one to keep, the first time; the heading is free until ``settle``.

        Args:
            pos_enu_m: shape (n, 3).
            counts: who flies the formation, and where is known, shape (n,).
            floor_m: least height of the middle that the formation is to have.
        """
        self.let_turn()
        if self.place_enu_m is None and some(counts):
            self.place_enu_m, self._counted = pos_enu_m[counts].mean(axis=0), counts.copy()
            self._middle_enu_m = self.place_enu_m.copy()
        if self.place_enu_m is not None:
            self.place_enu_m[2] = max(self.place_enu_m[2], floor_m)

    def let_turn(self) -> None:
        """The heading is free until ``settle``."""
        self.heading_rad = None

    def settle(self, pos_enu_m: FloatArray, counts: BoolArray, points_m: FloatArray) -> None:
        """Takes the heading of now for the one to keep, of those who count; arguments as for ``motion``.

        Where nobody counts, as when all have left OFFBOARD at once, nothing is known of how the formation is turned: it
        stays free, and is not turned later by an angle that nobody has measured.
        """
        if some(counts):
            self.heading_rad = heading_of(pos_enu_m[counts], points_m[counts])

    def shift(self, by_enu_m: FloatArray, turn_rad: float = 0.0) -> None:
        """Moves the kept place, and turns the kept heading, as the team was told to."""
        if self.place_enu_m is not None:
            self.place_enu_m = self.place_enu_m + by_enu_m
        if self.heading_rad is not None:
            self.heading_rad += turn_rad

    def motion(self, pos_enu_m: FloatArray, counts: BoolArray, points_m: FloatArray) -> Motion | None:
        """What the team does together to come back; None where nothing is to be kept.

        Args:
            pos_enu_m: of the vehicles, shape (n, 3).
            counts: who flies the formation, follows, and where is known, shape (n,).
            points_m: the formation's point of each vehicle, ENU, shape (n, 3).
        """
        if self.rate_1_s == 0.0 or self.place_enu_m is None or not some(counts):
            return None
        middle = mean(pos_enu_m[counts])
        if counts.tobytes() != self._counted.tobytes():
            # The middle of others: it is as far from its place as the one before was.
            self.place_enu_m = self.place_enu_m + middle - self._middle_enu_m
            self._counted = counts.copy()
        self._middle_enu_m = middle
        most_m_s = SPEED_SHARE * self.speed_limit_m_s
        vel_m_s = self.rate_1_s * (self.place_enu_m - middle)
        vel_m_s = vel_m_s * min(1.0, most_m_s / max(length(vel_m_s), 1e-12))
        turn_rad_s = 0.0
        if self.heading_rad is not None:
            level = norms(points_m[:, :2] - mean(points_m[:, :2]))
            off = np.angle(np.exp(1j * (self.heading_rad - heading_of(pos_enu_m[counts], points_m[counts]))))
            most_rad_s = 0.5 * most_m_s / max(float(level.max()), 1e-6)
            turn_rad_s = float(between(self.rate_1_s * off, -most_rad_s, most_rad_s))
        return Motion(vel_enu_m_s=vel_m_s, turn_rad_s=turn_rad_s, growth_1_s=0.0, scale=1.0)


def heading_of(pos_enu_m: FloatArray, points_m: FloatArray) -> float:
    """How a formation is turned about the vertical against its points, rad; 0 where that has no meaning."""
    pos, points = pos_enu_m[:, :2] - mean(pos_enu_m[:, :2]), points_m[:, :2] - mean(points_m[:, :2])
    turn = complex(((points[:, 0] - 1j * points[:, 1]) * (pos[:, 0] + 1j * pos[:, 1])).sum())
    spread = float((points**2).sum())
    return float(np.angle(turn)) if abs(turn) > 1e-3 * spread and spread > 1e-9 else 0.0


def added(first: Motion | None, second: Motion | None) -> Motion | None:
    """Two motions at once; the second neither grows nor scales anything."""
    if first is None or second is None:
        return first or second
    return Motion(
        vel_enu_m_s=first.vel_enu_m_s + second.vel_enu_m_s,
        turn_rad_s=first.turn_rad_s + second.turn_rad_s,
        growth_1_s=first.growth_1_s,
        scale=first.scale,
        ahead_rad=first.ahead_rad,
    )
