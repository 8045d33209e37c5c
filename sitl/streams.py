"""Streams: which message each vehicle sends at which interval.

``Streams`` keeps the intervals of all vehicles and says who is due. Refuses to make messages, to encode and to send.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
_NEVER = np.iinfo(np.int64).max

QUIET_RATES_HZ: dict[str, float] = {"HEARTBEAT": 1.0}
"""Nothing that nobody has asked for: for many runs at once."""


class Streams:
    """Intervals of all message types for all vehicles, and when each is next due.

    Due times are multiples of the interval, the same for all vehicles, so that a type can be made for all at once.

    Args:
        names: message types that can be streamed.
        n: number of vehicles.
        epoch_ns: time from which the multiples are counted.
    """

    def __init__(self, names: tuple[str, ...], n: int, epoch_ns: int = 0) -> None:
        self.names = names
        self._epoch_ns = epoch_ns
        self._row = {name: row for row, name in enumerate(names)}
        self.interval_ns: IntArray = np.zeros((len(names), n), dtype=np.int64)
        self._due_ns: IntArray = np.full((len(names), n), _NEVER, dtype=np.int64)
        self._soonest_ns = _NEVER

    def set_rates(self, vehicle: int, rates_hz: Mapping[str, float], now_ns: int) -> None:
        """Sets all streams of a vehicle: those that are not named are off."""
        for name in self.names:
            rate = rates_hz.get(name, 0.0)
            self.set_interval(vehicle, name, round(1e9 / rate) if rate else 0, now_ns)

    def set_interval(self, vehicle: int, name: str, interval_ns: int, now_ns: int) -> bool:
        """Sets one stream, 0 for off. Returns False for a type that is never streamed."""
        row = self._row.get(name)
        if row is None:
            return False
        self.interval_ns[row, vehicle] = interval_ns
        now_ns -= self._epoch_ns
        due = (now_ns // interval_ns + 1) * interval_ns if interval_ns else _NEVER
        self._due_ns[row, vehicle] = due
        self._soonest_ns = min(self._soonest_ns, due)
        return True

    def interval(self, vehicle: int, name: str) -> int | None:
        """Interval in ns, 0 for off, None for a type that is never streamed."""
        row = self._row.get(name)
        return None if row is None else int(self.interval_ns[row, vehicle])

    def take_due(self, now_ns: int) -> list[tuple[str, IntArray]]:
        """Lists the types that are due with the vehicles that are to send them, and moves them on."""
        now_ns -= self._epoch_ns
        if now_ns < self._soonest_ns:
            return []
        due = self._due_ns <= now_ns
        rows = np.flatnonzero(due.any(axis=1))
        out = [(self.names[row], np.flatnonzero(due[row])) for row in rows]
        interval = self.interval_ns[due]
        self._due_ns[due] = (now_ns // interval + 1) * interval
        self._soonest_ns = int(self._due_ns.min())
        return out
