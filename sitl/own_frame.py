"""How far each vehicle's own idea of north and of level is off, for good: drawn once, from a generator of its own.

A vehicle takes a velocity in the frame that it believes in and flies it there, by what it sees from on board: in truth
it flies the velocity turned by its error. It reports the attitude that it believes. Its position and velocity come from
outside (motion capture, GPS) and are not turned: nobody on the ground can turn setpoints back by what is reported.

Refuses to change in flight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl.frames import Array


@dataclass(frozen=True)
class OwnFrameConfig:
    """Errors of all vehicles' frames.

    Attributes:
        heading_rad: of each heading, to one side or the other.
        level_rad: of each level, about a horizontal axis that is drawn.
        alike: all to the same side and about the same axis, which is the worst case of Theorem 2.
    """

    heading_rad: float = 0.0
    level_rad: float = 0.0
    alike: bool = False


class OwnFrames:
    """Frames of n vehicles.

    Args:
        config: how far they are off.
        n: how many.
        rng: draws to which side.

    Attributes:
        heading_rad: true heading minus believed heading, from east counter-clockwise, shape (n,).
        rot_enu_from_own: takes vectors of the frame that each believes in to true ENU, shape (n, 3, 3).
    """

    def __init__(self, config: OwnFrameConfig, n: int, rng: np.random.Generator) -> None:
        sides = 2.0 * rng.integers(0, 2, n) - 1.0
        towards = rng.uniform(-math.pi, math.pi, n)
        if config.alike:
            sides, towards = np.ones(n), np.full(n, towards[0])
        self.heading_rad: Array = np.asarray(config.heading_rad * sides)
        # Level is turned about an axis (x, y, 0), by Rodrigues' formula.
        x, y = np.cos(towards), np.sin(towards)
        c, s = math.cos(config.level_rad), math.sin(config.level_rad)
        zero = np.zeros(n)
        level = np.array(
            [
                [c + x * x * (1.0 - c), x * y * (1.0 - c), y * s],
                [x * y * (1.0 - c), c + y * y * (1.0 - c), -x * s],
                [-y * s, x * s, zero + c],
            ]
        )
        turn_c, turn_s = np.cos(self.heading_rad), np.sin(self.heading_rad)
        heading = np.array([[turn_c, -turn_s, zero], [turn_s, turn_c, zero], [zero, zero, zero + 1.0]])
        self.rot_enu_from_own: Array = np.einsum("abn,bcn->nac", level, heading)

    def flown(self, own: Array) -> Array:
        """What velocities of their own frames, shape (3, n), are in truth."""
        return np.asarray(np.einsum("nab,bn->an", self.rot_enu_from_own, own))

    def believed(self, vector_enu: Array) -> Array:
        """What they take true vectors for, shape (3, n)."""
        return np.asarray(np.einsum("nba,bn->an", self.rot_enu_from_own, vector_enu))
