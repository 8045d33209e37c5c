"""What a team does whose motion capture has gone for everybody: it parts by velocities while it sinks, then lands.

Nobody knows where it is, and each vehicle's own estimate drifts with the square of time. To land at once, beside and
above each other, would let them drift into each other on the way; to wait makes it worse. So each flies away from the
middle in a direction of its own, faster than the mission's speed limit if that is lower, and down, so that all come
near the ground at one time; then they are told to land. How long that is good for follows from the drift, which nobody
knows beforehand (docs/mocap.md).
"""

from __future__ import annotations

import numpy as np

from groundstation.core.scatter import scatter
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.timing import SECOND_NS

_OUT_M_S, _SINK_M_S = 1.0, 0.8
_LEAST_S = 1.2  # so that two that flew one above the other are beside each other at the end
_LOW_M = 0.3  # above the pad: from there it is told to land


class Dark:
    """The parting of one team.

    Args:
        pads_ned_m: where the ground is, shape (n, 3).
    """

    def __init__(self, pads_ned_m: FloatArray) -> None:
        n = len(pads_ned_m)
        self._ground_m = -pads_ned_m[:, 2]
        self._since_ns: int | None = None
        self._rows: BoolArray = np.zeros(n, dtype=np.bool_)
        self._seconds = 0.0
        self._vel_ned_m_s: FloatArray = np.zeros((n, 3))

    def step(self, dark: bool, flying: BoolArray, pos_ned_m: FloatArray, now_ns: int) -> BoolArray:
        """Begins when it is dark, and ends when that does, or in time; who is still to part, shape (n,).

        Args:
            dark: nobody is seen any more, and everybody is to land.
            flying: who is in the air, shape (n,).
            pos_ned_m: where everybody was seen last, shape (n, 3).
            now_ns: time of the tick.
        """
        if not dark:
            self._since_ns = None
            return np.zeros(len(flying), dtype=np.bool_)
        if self._since_ns is None:
            self._begin(flying & np.isfinite(pos_ned_m).all(axis=1), pos_ned_m, now_ns)
        return self.parting(now_ns)

    def _begin(self, rows: BoolArray, pos_ned_m: FloatArray, now_ns: int) -> None:
        self._since_ns = now_ns
        height_m = -pos_ned_m[:, 2] - self._ground_m
        self._rows = rows
        self._vel_ned_m_s = np.zeros_like(self._vel_ned_m_s)
        if not rows.any():
            return
        to_sink_m = np.maximum(0.0, height_m[rows] - _LOW_M)
        self._seconds = max(_LEAST_S, float(to_sink_m.max()) / _SINK_M_S)
        self._vel_ned_m_s[rows] = scatter(pos_ned_m[rows], to_sink_m / self._seconds, self._seconds, _OUT_M_S)

    def parting(self, now_ns: int) -> BoolArray:
        """Who flies by ``velocities`` at the moment, shape (n,)."""
        over = self._since_ns is None or (now_ns - self._since_ns) / SECOND_NS >= self._seconds
        return np.zeros_like(self._rows) if over else self._rows

    def velocities(self, sent_ned_m_s: FloatArray, gone: bool, now_ns: int) -> FloatArray:
        """What is sent, with the velocities of those that part in their places, shape (n, 3).

        Args:
            sent_ned_m_s: what would be sent otherwise, shape (n, 3).
            gone: nobody is seen any more: until they part all stand still.
            now_ns: time of the tick.
        """
        if self._since_ns is None:
            return np.zeros_like(sent_ned_m_s) if gone else sent_ned_m_s
        return np.where(self.parting(now_ns)[:, None], self._vel_ned_m_s, sent_ned_m_s)
