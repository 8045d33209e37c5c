"""A formation that moves, turns and grows as commanded, while every agent stays on its own view.

What is commanded to the whole team is a velocity, a rate of turn about the vertical and a rate of growth, each smooth
from rest to rest. Every agent makes its own velocity of them, from where the formation's centre is as its own view has
it: nobody needs to know where the team is. Knows no vehicles and no limits; ``least_seconds`` tells how fast it may go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.core.types import FloatArray

PEAK_SPEED = 1.875
"""Largest slope of the way over time, which is 10 x^3 - 15 x^4 + 6 x^5: at rest, and unaccelerated, at both ends."""

PEAK_ACCELERATION = 10.0 / np.sqrt(3.0)
"""Largest second derivative of it."""


@dataclass(frozen=True)
class Motion:
    """What the team does together at one instant.

    Attributes:
        vel_enu_m_s: of the formation's centre, shape (3,).
        turn_rad_s: about the vertical, counterclockwise seen from above.
        growth_1_s: relative growth of all distances.
        scale: what all distances have grown to.
        ahead_rad: how far the formation turns until a setpoint takes effect.
    """

    vel_enu_m_s: FloatArray
    turn_rad_s: float
    growth_1_s: float
    scale: float
    ahead_rad: float = 0.0

    def rigid(self, from_centre_enu_m: FloatArray) -> FloatArray:
        """Velocities of agents that move and turn with the formation, shape (n, 3), ENU.

        Args:
            from_centre_enu_m: where each agent's place is from the centre, as its own view has it, shape (n, 3).
        """
        east, north = from_centre_enu_m[:, 0], from_centre_enu_m[:, 1]
        cos, sin = np.cos(self.ahead_rad), np.sin(self.ahead_rad)
        turned = np.zeros_like(from_centre_enu_m)
        turned[:, 0] = self.turn_rad_s * -(sin * east + cos * north)
        turned[:, 1] = self.turn_rad_s * (cos * east - sin * north)
        return turned + self.vel_enu_m_s

    def relative(self, rel_enu_m: FloatArray) -> FloatArray:
        """How relative positions change by this motion alone, shape (..., 3), ENU, m/s."""
        turned = np.stack([-rel_enu_m[..., 1], rel_enu_m[..., 0], np.zeros_like(rel_enu_m[..., 2])], axis=-1)
        return self.turn_rad_s * turned + self.growth_1_s * rel_enu_m


@dataclass(frozen=True)
class MovePlan:
    """A commanded motion from rest to rest.

    Attributes:
        by_enu_m: displacement of the centre, shape (3,).
        turn_rad: turn about the vertical, counterclockwise seen from above.
        scale: what all distances grow by.
        seconds: duration, > 0.
    """

    by_enu_m: FloatArray
    turn_rad: float
    scale: float
    seconds: float

    def share(self, time_s: float) -> float:
        """How much of the way is done."""
        x = min(max(time_s / self.seconds, 0.0), 1.0)
        return x * x * x * (10.0 + x * (6.0 * x - 15.0))

    def at(self, time_s: float, pace: float = 1.0, ahead_s: float = 0.0) -> Motion:
        """The motion at a time of its own clock.

        Args:
            time_s: since it began.
            pace: how fast that clock runs, 0 to 1.
            ahead_s: how long it takes a setpoint to take effect; the motion is that of then.
        """
        x = min(max((time_s + pace * ahead_s) / self.seconds, 0.0), 1.0)
        rate = pace * 30.0 * x * x * (1.0 - x) ** 2 / self.seconds
        ahead = self.share(time_s + pace * ahead_s) - self.share(time_s)
        return Motion(
            vel_enu_m_s=rate * self.by_enu_m,
            turn_rad_s=rate * self.turn_rad,
            growth_1_s=rate * float(np.log(self.scale)),
            scale=float(self.scale ** self.share(time_s)),
            ahead_rad=ahead * self.turn_rad,
        )

    def done(self, share: float) -> MovePlan:
        """The part of it that is done when a share of the way is, as a move of its own."""
        return MovePlan(share * self.by_enu_m, share * self.turn_rad, float(self.scale**share), self.seconds)

    def left(self, share: float) -> MovePlan:
        """The part of it that is left then, as a move of its own."""
        return self.done(1.0 - share)

    def carried(self, pos_enu_m: FloatArray, share: float = 1.0) -> FloatArray:
        """Where it takes places, shape (n, 3), when a share of the way is done; it turns them about their middle."""
        centre = pos_enu_m.mean(axis=0)
        offset = self.scale**share * (pos_enu_m - centre)
        cos, sin = np.cos(share * self.turn_rad), np.sin(share * self.turn_rad)
        turned = np.stack(
            [cos * offset[:, 0] - sin * offset[:, 1], sin * offset[:, 0] + cos * offset[:, 1], offset[:, 2]], axis=1
        )
        return np.asarray(centre + share * self.by_enu_m + turned)

    def speed_m_s(self, level_m: float, radius_m: float) -> float:
        """Largest speed that it asks of an agent.

        Args:
            level_m: how far the outermost agent is from the vertical through the centre, before the motion.
            radius_m: how far it is from the centre.
        """
        return PEAK_SPEED * self._length_m(level_m, radius_m) / self.seconds

    def acceleration_m_s2(self, level_m: float, radius_m: float) -> float:
        """Largest acceleration that it asks of an agent, at most; arguments as for ``speed_m_s``."""
        largest = max(self.scale, 1.0)
        along = PEAK_ACCELERATION * self._length_m(level_m, radius_m)
        bend = PEAK_SPEED**2 * largest * (self.turn_rad**2 * level_m + float(np.log(self.scale)) ** 2 * radius_m)
        across = 2.0 * PEAK_SPEED**2 * largest * abs(self.turn_rad * float(np.log(self.scale))) * level_m
        return float(along + bend + across) / self.seconds**2

    def _length_m(self, level_m: float, radius_m: float) -> float:
        largest = max(self.scale, 1.0)
        turned = abs(self.turn_rad) * level_m * largest
        return float(np.linalg.norm(self.by_enu_m)) + turned + abs(float(np.log(self.scale))) * radius_m * largest


def least_seconds(move: MovePlan, level_m: float, radius_m: float, speed_m_s: float, accel_m_s2: float) -> float:
    """The shortest time in which a motion stays within a speed and an acceleration."""
    by_speed = move.speed_m_s(level_m, radius_m) * move.seconds / speed_m_s
    by_acceleration = np.sqrt(move.acceleration_m_s2(level_m, radius_m) * move.seconds**2 / accel_m_s2)
    return float(max(by_speed, by_acceleration))
