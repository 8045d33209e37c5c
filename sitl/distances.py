"""Smallest distances between vehicles of which one at least is off the ground: the emulator's own witness.

Refuses to judge them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sitl.frames import Array

_STEPS_AT_ONCE = 64


class Distances:
    """Smallest distance of each pair of n vehicles, wrecks included."""

    def __init__(self, n: int) -> None:
        self.n = n
        self._pairs = np.triu_indices(n, 1)
        self._history: list[tuple[Array, NDArray[np.bool_]]] = []
        self._nearest_squared = np.full(len(self._pairs[0]), math.inf)

    def note(self, pos_enu_m: Array, airborne: NDArray[np.bool_]) -> None:
        """Takes one step: positions, shape (3, n), kept as they are now, and who is off the ground, shape (n,)."""
        self._history.append((pos_enu_m.copy(), airborne))
        if len(self._history) >= _STEPS_AT_ONCE:
            self.measure()

    def measure(self) -> None:
        """Works out the steps that have been noted."""
        if not self._history:
            return
        pos = np.stack([item[0] for item in self._history])
        air = np.stack([item[1] for item in self._history])
        self._history.clear()
        first, second = self._pairs
        counted = air[:, first] | air[:, second]  # whoever stands may be landed on
        if counted.any():
            delta = pos[:, :, first] - pos[:, :, second]
            squared = np.where(counted, (delta * delta).sum(axis=1), math.inf)
            np.minimum(self._nearest_squared, squared.min(axis=0), out=self._nearest_squared)

    def smallest_m(self) -> float:
        """Of all pairs; infinite before anybody was off the ground."""
        self.measure()
        return math.sqrt(float(self._nearest_squared.min(initial=math.inf)))

    def of_pairs_m(self) -> Array:
        """Of each pair, symmetric, infinite on the diagonal, shape (n, n)."""
        self.measure()
        distances = np.full((self.n, self.n), math.inf)
        distances[self._pairs] = distances.T[self._pairs] = np.sqrt(self._nearest_squared)
        return distances

    def reset(self) -> None:
        """Forgets the smallest distances."""
        self._history.clear()
        self._nearest_squared[:] = math.inf
