"""What the high-level commander was asked for and has not answered: asked again, for one packet that is lost is a fall.

The firmware answers each command with its number and an error, 0 for none. A link by radio sends again by itself what
is not acknowledged; one over UDP does not. The end of the stream of setpoints, which goes before a landing or a hold,
has no answer, and without it that is not heard: it is sent three times, before the vehicle would level out (0.5 s).
"""

from __future__ import annotations

from collections.abc import Iterable

from groundstation.gateway.orders import (
    EmergencyStop,
    GoTo,
    HighLevelStop,
    LandAt,
    Order,
    SetpointsStop,
    TakeOff,
    Velocity,
)

_WAIT_NS = 400_000_000
_ENDS_NS = (150_000_000, 300_000_000)
"""So long after the first time the end of the stream is told again."""
_TIMES = {TakeOff: 3, GoTo: 3, HighLevelStop: 3}
"""How often it is asked for; a landing until it is answered."""
_NUMBER = {HighLevelStop: 3, TakeOff: 7, LandAt: 8, GoTo: 12}
_WORDS = {HighLevelStop: "to stand", TakeOff: "to take off", LandAt: "to land", GoTo: "to go to a place"}
_NOT_NOW, _BUSY = 1, 16
HighLevel = TakeOff | LandAt | GoTo | HighLevelStop


class Asked:
    """One vehicle's; only what it was asked for last counts."""

    def __init__(self) -> None:
        self._order: HighLevel | None = None
        self._asked_ns: int | None = None
        self._times = 0
        self._ends: list[int] = []

    def sent(self, orders: Iterable[Order]) -> None:
        """Takes note of what goes out."""
        for order in orders:
            if isinstance(order, HighLevel):
                self._times = self._times + 1 if order is self._order else 1
                self._order, self._asked_ns = order, None
                self._ends = [] if isinstance(order, TakeOff | HighLevelStop) else list(_ENDS_NS)
            elif isinstance(order, Velocity | EmergencyStop):
                self._order, self._ends = None, []

    def answered(self, number: int, error: int) -> str | None:
        """Takes an answer; returns what people are to be told, where it was refused."""
        order = self._order
        if order is None or _NUMBER[type(order)] != number:
            return None
        self._order = None
        done = error == _NOT_NOW and (isinstance(order, LandAt) or self._times > 1)  # it has begun already
        if error == 0 or done:
            return None
        why = {_NOT_NOW: "it is flown by another command or by setpoints", _BUSY: "its supervisor lets it not"}
        return f"its firmware refuses {_WORDS[type(order)]}: {why.get(error, f'error {error}')}"

    def due(self, now_ns: int) -> list[Order]:
        """What is to be asked for again."""
        order = self._order
        if self._asked_ns is None:
            self._asked_ns = now_ns
        if self._ends and now_ns - self._asked_ns >= self._ends[0]:
            self._ends.pop(0)
            return [SetpointsStop()]
        if order is None or now_ns - self._asked_ns < _WAIT_NS:
            return []
        if self._times >= _TIMES.get(type(order), self._times + 1):
            self._order = None
            return []
        return [order] if isinstance(order, TakeOff | HighLevelStop) else [SetpointsStop(), order]
