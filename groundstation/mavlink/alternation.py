"""Values that go to and fro as no single vehicle's do: two senders under one id, both believed.

One vehicle arms and disarms, changes modes, bounces on touching down. What comes back to the value before last again
and again within seconds is told by two. Reads no clock.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from groundstation.core.quick import every
from groundstation.core.types import BoolArray, IntArray

_RETURNS, _WITHIN_NS = 5, 8_000_000_000
_DOUBTED = 2  # returns after which nothing should be decided by the value until it is clear whose it is
_NONE = -(1 << 60)


class Alternation:
    """One value of each vehicle, a whole number.

    Args:
        n: number of vehicles.
        tolerance: differences up to this are none.

    Attributes:
        quiet: no value has ever come back.
    """

    def __init__(self, n: int, tolerance: int = 0) -> None:
        self._tolerance = tolerance
        self.quiet = True
        self._last: IntArray = np.full(n, _NONE, dtype=np.int64)
        self._before: IntArray = np.full(n, _NONE, dtype=np.int64)
        self._returns: list[deque[int]] = [deque(maxlen=_RETURNS) for _ in range(n)]

    def take(self, row: IntArray, value: IntArray, t_rx_ns: IntArray, counts: BoolArray | None = None) -> None:
        """Takes values in the order of their arrival, shape (k,) each; ``counts``: who may not change so by itself."""
        if len(set(row.tolist())) == len(row) and every(self._last[row] == value):
            return
        suspicious = [True] * len(row) if counts is None else counts.tolist()
        for vehicle, now, t_ns, marks in zip(row.tolist(), value.tolist(), t_rx_ns.tolist(), suspicious, strict=True):
            last = int(self._last[vehicle])
            if abs(now - last) <= self._tolerance:
                continue
            if marks and abs(now - int(self._before[vehicle])) <= self._tolerance:
                self.mark(vehicle, t_ns)
            self._before[vehicle], self._last[vehicle] = last, now

    def mark(self, vehicle: int, t_rx_ns: int) -> None:
        """Notes that a value has come back."""
        self._returns[vehicle].append(t_rx_ns)
        self.quiet = False

    def values(self, vehicle: int) -> tuple[int, int]:
        """The last value and the one before it."""
        return int(self._last[vehicle]), int(self._before[vehicle])

    def two_at_once(self, vehicle: int, now_ns: int) -> bool:
        """Whether two senders have been telling this value of late."""
        return self._of_late(vehicle, now_ns) >= _RETURNS

    def in_doubt(self, now_ns: int) -> BoolArray:
        """Vehicles whose value has begun to go to and fro, shape (n,)."""
        n = len(self._returns)
        if self.quiet:
            return np.zeros(n, dtype=np.bool_)
        return np.array([self._of_late(vehicle, now_ns) >= _DOUBTED for vehicle in range(n)])

    def _of_late(self, vehicle: int, now_ns: int) -> int:
        returns = self._returns[vehicle]
        return sum(t_ns > now_ns - _WITHIN_NS for t_ns in returns) if returns else 0
