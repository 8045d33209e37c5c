"""Numbers that wander: Gauss-Markov processes of first order, stationary from the start.

Refuses to draw from anything but the generator that it is given.
"""

from __future__ import annotations

import numpy as np

from sitl.frames import Array


class Wander:
    """Many of them at once.

    Args:
        start: their first values; changed in place from then on, any shape.
        keep: what is left of them after a step, of a shape that fits.
        drive: standard deviation of what is added in a step.
        rng: source of it.
        block: steps that are drawn at once.

    Attributes:
        now: their values, always the same array.
    """

    def __init__(
        self, start: Array, keep: Array | float, drive: Array, *, rng: np.random.Generator, block: int
    ) -> None:
        self.now = start
        self._keep, self._drive, self._rng, self._block = keep, drive, rng, block
        self._drawn = np.empty((0, *start.shape))
        self._next = 0

    def step(self) -> None:
        """Lets them wander by one step."""
        if self._next == len(self._drawn):
            self._drawn = self._rng.standard_normal((self._block, *self.now.shape))
            self._next = 0
        now = self.now
        now *= self._keep
        now += self._drawn[self._next] * self._drive
        self._next += 1
