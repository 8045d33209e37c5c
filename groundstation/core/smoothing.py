"""Places by what was reported over time: velocities carry them on, reported positions draw them back slowly.

The steady state of a Kalman filter for p' = v, v as reported with its error, and positions that wander. What positions
wander by from tick to tick does not show, and motion does, with no delay, for it is in the velocities. A velocity that
stays wrong by v pulls a place off by v / rate; no place is farther from what was reported than it may be. Knows no
vehicles.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.quick import between, finite_rows, some
from groundstation.core.types import BoolArray, FloatArray

_GAP_S = 0.5
"""After so long without a look places begin anew."""


class Smoother:
    """Smooths the places of one team.

    Args:
        n: of the team.
        rate_1_s: how fast reported positions draw places to them, > 0.
        most_m: farthest that a place may be from what was reported, on each axis, >= 0.
    """

    def __init__(self, n: int, rate_1_s: float, most_m: float) -> None:
        self._rate_1_s, self._most_m = rate_1_s, most_m
        self._measured_m: FloatArray = np.full((n, 3), np.nan)
        self._measured_s: FloatArray = np.full(n, -np.inf)

    def __call__(
        self, now_s: float, pos_m: FloatArray, vel_m_s: FloatArray, carried_s: FloatArray, poor: BoolArray
    ) -> FloatArray:
        """Places at an instant, shape (n, 3), any axes that stay the same.

        Args:
            now_s: does not go back.
            pos_m: as reported, carried on to that instant by the velocities, shape (n, 3); NaN where not known, and so
                are their places.
            vel_m_s: as reported, shape (n, 3).
            carried_s: for how long, shape (n,). Places are smoothed where they were measured: velocities of then do not
                tell what came later.
            poor: whose velocity is known to be poor: as reported, shape (n,).
        """
        measured_s = now_s - carried_s
        passed_s = np.maximum(measured_s - self._measured_s, 0.0)
        reported_m = pos_m - carried_s[:, None] * vel_m_s
        anew = poor | (passed_s > _GAP_S)
        passed_s = np.minimum(passed_s, _GAP_S)[:, None]
        off_m = self._measured_m + passed_s * vel_m_s - reported_m
        off_m = between(np.exp(-self._rate_1_s * passed_s) * off_m, -self._most_m, self._most_m)
        anew = anew | ~finite_rows(off_m)
        if some(anew):
            off_m = np.where(anew[:, None], 0.0, off_m)
        self._measured_m, self._measured_s = reported_m + off_m, np.maximum(measured_s, self._measured_s)
        return pos_m + off_m
