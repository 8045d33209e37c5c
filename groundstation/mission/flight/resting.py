"""Where vehicles came to rest, and how far from there they say to be while they stand: what stands does not move."""

from __future__ import annotations

import numpy as np

from groundstation.core.quick import finite_rows, some
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.plan.plan import MissionPlan

_LEAST_M = 0.1
_OF_MARGIN = 0.5  # positions by GPS wander by 0.2 m within the half minute before takeoff; the margin is 1 m


def still_limit_m(plan: MissionPlan) -> float:
    """How far the position of one that stands may wander."""
    return _LEAST_M + _OF_MARGIN * plan.margin_m


class Rest:
    """The places at which n vehicles were first seen to stand.

    Attributes:
        place_ned_m: those places, shape (n, 3); NaN of those that do not stand.
        moved_ned_m: how far from there they say to be, shape (n, 3); zero where that is not known.
    """

    def __init__(self, n: int) -> None:
        self.place_ned_m: FloatArray = np.full((n, 3), np.nan)
        self.moved_ned_m: FloatArray = np.zeros((n, 3))
        self._stood = False

    def take(self, pos_ned_m: FloatArray, stands: BoolArray) -> None:
        """Takes positions of a tick, shape (n, 3), and who stands, shape (n,)."""
        if not some(stands):
            if self._stood:
                self.place_ned_m, self.moved_ned_m = np.full_like(pos_ned_m, np.nan), np.zeros_like(pos_ned_m)
            self._stood = False
            return
        self._stood = True
        known = finite_rows(pos_ned_m)
        new = stands & known & np.isnan(self.place_ned_m[:, 0])
        self.place_ned_m = np.where(stands[:, None], self.place_ned_m, np.nan)
        self.place_ned_m[new] = pos_ned_m[new]
        moved_ned_m = np.where(known[:, None], pos_ned_m - self.place_ned_m, 0.0)
        self.moved_ned_m = np.where(np.isnan(moved_ned_m), 0.0, moved_ned_m)

    def forget(self, rows: BoolArray) -> None:
        """They come to rest anew, shape (n,)."""
        self.place_ned_m[rows] = np.nan
        self.moved_ned_m[rows] = 0.0

    @property
    def moved_m(self) -> FloatArray:
        """How far that is horizontally, shape (n,)."""
        return np.asarray(np.hypot(self.moved_ned_m[:, 0], self.moved_ned_m[:, 1]))
