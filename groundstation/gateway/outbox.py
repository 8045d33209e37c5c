"""What waits to be sent to one vehicle while its link is busy: orders in their sequence, and the newest of what ages.

Of velocities and poses only the newest waits; a velocity goes before a pose. What moves a vehicle and has waited for
too long is not sent at all: somebody may have gone near in the meantime.
"""

from __future__ import annotations

from collections import deque

from groundstation.gateway.orders import (
    EmergencyStop,
    ExternalPose,
    GoTo,
    LogRate,
    Order,
    Ping,
    SetpointsStop,
    TakeOff,
    Velocity,
)

OLD_NS = 500_000_000


class Outbox:
    """One vehicle's."""

    def __init__(self) -> None:
        self._orders: deque[tuple[int, Order]] = deque()
        self._velocity: tuple[int, Velocity] | None = None
        self._beside: dict[type[Order], tuple[int, Order]] = {}

    def __bool__(self) -> bool:
        """Whether anything waits."""
        return bool(self._orders or self._velocity or self._beside)

    def put(self, order: Order, now_ns: int) -> None:
        """Takes an order."""
        if isinstance(order, Velocity):
            self._velocity = now_ns, order
        elif isinstance(order, ExternalPose | Ping | LogRate):
            self._beside[type(order)] = now_ns, order
        elif isinstance(order, EmergencyStop):
            self._velocity = None
            self._orders.appendleft((now_ns, order))
        else:
            if isinstance(order, SetpointsStop):
                self._velocity = None  # it would outrank what follows
            self._orders.append((now_ns, order))

    def take(self, now_ns: int) -> Order | None:
        """Hands out what is to be sent next; None when there is nothing."""
        while self:
            if self._orders:
                asked_ns, order = self._orders.popleft()
            elif self._velocity is not None:
                asked_ns, order = self._velocity
                self._velocity = None
            else:
                asked_ns, order = self._beside.pop(next(iter(self._beside)))
            if not isinstance(order, Velocity | ExternalPose | TakeOff | GoTo) or now_ns - asked_ns <= OLD_NS:
                return order
        return None
