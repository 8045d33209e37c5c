"""Smallest distances between vehicles of which one at least is off the ground: the emulator's own witness.

Refuses to judge them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sitl.frames import Array

_STEPS_AT_ONCE = 64
ALL_PAIRS_MAX = 128
"""Vehicles up to which every pair is kept; of more, the smallest distance of all and whose it was."""


class Distances:
    """Smallest distance of each pair of n vehicles, wrecks included; of large teams of the nearest pairs alone."""

    def __init__(self, n: int) -> None:
        self.n = n
        self._large = n > ALL_PAIRS_MAX
        self._pairs = np.triu_indices(0 if self._large else n, 1)
        self._history: list[tuple[Array, NDArray[np.bool_]]] = []
        self._nearest_squared = np.full(len(self._pairs[0]), math.inf)
        self._looked: tuple[Array, NDArray[np.bool_], float] | None = None
        self._records: dict[tuple[int, int], float] = {}
        self._record_m = math.inf

    def note(self, pos_enu_m: Array, airborne: NDArray[np.bool_]) -> None:
        """Takes one step: positions, shape (3, n), kept as they are now, and who is off the ground, shape (n,)."""
        if self._large:
            self._look(pos_enu_m, airborne)
            return
        self._history.append((pos_enu_m.copy(), airborne))
        if len(self._history) >= _STEPS_AT_ONCE:
            self.measure()

    def _look(self, pos_enu_m: Array, airborne: NDArray[np.bool_]) -> None:
        """Looks for the nearest pair where anybody may have come nearer than ever since it was looked for last."""
        if self._looked is not None:
            before, then, nearest_m = self._looked
            moved_m = math.sqrt(float(((pos_enu_m - before) ** 2).sum(axis=0).max()))
            if nearest_m - 2.0 * moved_m >= self._record_m and np.array_equal(then, airborne):
                return
        up = airborne.nonzero()[0]
        if not len(up):
            return
        points = pos_enu_m.T
        found_m, found = map(np.asarray, cKDTree(points).query(points[up], 2))
        k = int(found_m[:, 1].argmin())
        nearest_m = float(found_m[k, 1])
        if nearest_m < self._record_m:
            one, other = int(up[k]), next(int(j) for j in found[k] if j != up[k])
            self._record_m = self._records[min(one, other), max(one, other)] = nearest_m
        self._looked = pos_enu_m.copy(), airborne.copy(), nearest_m

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
        if self._large:
            return self._record_m
        self.measure()
        return math.sqrt(float(self._nearest_squared.min(initial=math.inf)))

    def of_pairs_m(self) -> Array:
        """Of each pair, symmetric, infinite on the diagonal, shape (n, n).

        Of large teams only pairs that were the nearest of all so far; infinite elsewhere.
        """
        self.measure()
        distances = np.full((self.n, self.n), math.inf)
        for (one, other), nearest_m in self._records.items():
            distances[one, other] = distances[other, one] = nearest_m
        distances[self._pairs] = distances.T[self._pairs] = np.sqrt(self._nearest_squared)
        return distances

    def reset(self) -> None:
        """Forgets the smallest distances."""
        self._history.clear()
        self._nearest_squared[:] = math.inf
        self._looked, self._record_m = None, math.inf
        self._records.clear()
