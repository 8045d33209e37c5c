"""Bodies of a room that are no vehicles: where each was seen last, how it moves, and when that was.

They are believed as they are told: one that is not there but told makes vehicles give way, which harms nobody. One that
is the same to the last bit for a while is not seen.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.types import FloatArray, IntArray
from groundstation.mocap.bodies import RoomFrame

FIRST_ROW = -2
NEVER = np.iinfo(np.int64).min // 2
_SMOOTH_S = 0.15
_FROZEN_NS = 150_000_000
_STEP_MAX_S = 0.5


class OtherBodies:
    """k bodies.

    Args:
        count: k.

    Attributes:
        pos_ned_m, vel_ned_m_s: where each was seen last, NaN before, and how it moved then, shape (k, 3).
        measured_ns: when that was, NEVER before, shape (k,).
    """

    def __init__(self, count: int) -> None:
        self.pos_ned_m: FloatArray = np.full((count, 3), np.nan)
        self.vel_ned_m_s: FloatArray = np.zeros((count, 3))
        self.measured_ns: IntArray = np.full(count, NEVER, dtype=np.int64)
        self._told: FloatArray = np.full((count, 3), np.nan)
        self._changed_ns: IntArray = np.full(count, NEVER, dtype=np.int64)

    def __len__(self) -> int:
        """How many."""
        return len(self.measured_ns)

    def take(self, frame: RoomFrame, measured_ns: int) -> None:
        """Takes those of a frame that are meant."""
        for row, place in zip((FIRST_ROW - frame.row).tolist(), frame.pos_ned_m, strict=True):
            if not 0 <= row < len(self) or not np.isfinite(place).all() or measured_ns < self.measured_ns[row]:
                continue
            if not np.array_equal(place, self._told[row]):
                self._told[row], self._changed_ns[row] = place, measured_ns
            elif measured_ns - int(self._changed_ns[row]) > _FROZEN_NS:
                continue
            step_s = (measured_ns - int(self.measured_ns[row])) / 1e9
            if 0.0 < step_s < _STEP_MAX_S:
                told = (place - self.pos_ned_m[row]) / step_s
                self.vel_ned_m_s[row] += step_s / (step_s + _SMOOTH_S) * (told - self.vel_ned_m_s[row])
            elif step_s > 0.0:
                self.vel_ned_m_s[row] = 0.0
            self.pos_ned_m[row], self.measured_ns[row] = place, measured_ns
