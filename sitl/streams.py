"""Streams: which message each vehicle sends at which interval.

``Streams`` keeps the intervals of all vehicles and says who is due. Refuses to make messages, to encode and to send.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
_NEVER = np.iinfo(np.int64).max

QUIET_RATES_HZ: dict[str, float] = {"HEARTBEAT": 1.0}
"""Nothing that nobody has asked for: for many runs at once."""


class _Round:
    """Vehicles that send one message type at the same times."""

    def __init__(self, due_ns: int, interval_ns: int, members: set[int]) -> None:
        self.due_ns, self.interval_ns, self.members = due_ns, interval_ns, members
        self._vehicles: IntArray | None = None

    def change(self, *, add: Collection[int] = (), drop: Collection[int] = ()) -> None:
        """Lets some in, and some out."""
        self.members = (self.members | set(add)) - set(drop)
        self._vehicles = None

    def vehicles(self) -> IntArray:
        """In ascending order; not to be written."""
        if self._vehicles is None:
            self._vehicles = np.array(sorted(self.members), dtype=np.int64)
            self._vehicles.flags.writeable = False
        return self._vehicles


class Streams:
    """Intervals of all message types for all vehicles, and when each is next due.

    Due times are multiples of the interval, the same for all vehicles, so that a type can be made for all at once. Who
    sends a type at the same times is kept together, so that what is due is told by a few comparisons.

    Args:
        names: message types that can be streamed.
        n: number of vehicles.
        epoch_ns: time from which the multiples are counted.
    """

    def __init__(self, names: tuple[str, ...], n: int, epoch_ns: int = 0) -> None:
        self.names = names
        self._epoch_ns = epoch_ns
        self._row = {name: row for row, name in enumerate(names)}
        self._interval_ns = [[0] * n for _ in names]
        self._rounds: list[list[_Round]] = [[] for _ in names]
        self._row_due_ns = [_NEVER] * len(names)
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
        if interval_ns == self._interval_ns[row][vehicle] == 0:
            return True
        self._interval_ns[row][vehicle] = interval_ns
        now_ns -= self._epoch_ns
        rounds = self._rounds[row]
        for item in rounds:
            if vehicle in item.members:
                item.change(drop=(vehicle,))
        if interval_ns:
            rounds.append(_Round((now_ns // interval_ns + 1) * interval_ns, interval_ns, {vehicle}))
        self._arrange(row)
        return True

    def interval(self, vehicle: int, name: str) -> int | None:
        """Interval in ns, 0 for off, None for a type that is never streamed."""
        row = self._row.get(name)
        return None if row is None else self._interval_ns[row][vehicle]

    def take_due(self, now_ns: int) -> list[tuple[str, IntArray]]:
        """Lists the types that are due with the vehicles that are to send them, and moves them on."""
        now_ns -= self._epoch_ns
        if now_ns < self._soonest_ns:
            return []
        out: list[tuple[str, IntArray]] = []
        for row, due_ns in enumerate(self._row_due_ns):
            if due_ns <= now_ns:
                out.append((self.names[row], self._take_row(row, now_ns)))
        self._soonest_ns = min(self._row_due_ns)
        return out

    def _take_row(self, row: int, now_ns: int) -> IntArray:
        """Moves one type on; returns whom it is due from."""
        rounds = self._rounds[row]
        due = [item for item in rounds if item.due_ns <= now_ns]
        vehicles = due[0].vehicles() if len(due) == 1 else np.sort(np.concatenate([item.vehicles() for item in due]))
        for item in due:
            item.due_ns = (now_ns // item.interval_ns + 1) * item.interval_ns
        if len(rounds) > 1:
            self._arrange(row)
        self._row_due_ns[row] = min(item.due_ns for item in rounds)
        return vehicles

    def _arrange(self, row: int) -> None:
        """Puts together who sends a type at the same times."""
        rounds: dict[tuple[int, int], _Round] = {}
        for item in self._rounds[row]:
            same = rounds.setdefault((item.due_ns, item.interval_ns), item)
            if same is not item:
                same.change(add=item.members)
        self._rounds[row][:] = [item for item in rounds.values() if item.members]
        self._row_due_ns[row] = min((item.due_ns for item in self._rounds[row]), default=_NEVER)
        self._soonest_ns = min(self._row_due_ns)
