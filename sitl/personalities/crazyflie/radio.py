"""A radio that several Crazyflies share: one packet at a time, to one vehicle after the other.

One transaction is a packet to a vehicle (an empty one where there is none) and its acknowledgement, in which one packet
of the vehicle comes back. What is lost is sent again when that vehicle's turn comes, as drivers do. What a vehicle has
to say waits in its queue, which is finite. A broadcast reaches whoever hears it, and nobody acknowledges it.

Refuses to know what packets mean, and to read a clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

_QUEUE_MAX = 120  # packets, as the firmware has it
_SECOND_NS = 1_000_000_000


class Arrived(NamedTuple):
    """A packet that arrived at a vehicle, or from one (``up`` is False)."""

    t_ns: int
    vehicle: int
    data: bytes
    up: bool


class SharedRadio:
    """One radio.

    Args:
        vehicles: numbers of those that it serves.
        packets_s: transactions a second.
        rng: of its losses.

    Attributes:
        loss: share of transactions that fail at the moment, 0 to 1.
        transactions, lost, dropped: counters; ``dropped`` are packets that found their vehicle's queue full.
    """

    def __init__(self, vehicles: Sequence[int], packets_s: float, rng: np.random.Generator) -> None:
        self.loss = 0.0
        self.transactions = self.lost = self.dropped = 0
        self._vehicles = list(vehicles)
        self._period_ns = round(_SECOND_NS / packets_s)
        self._rng = rng
        self._next_ns = 0
        self._turn = 0
        self._again: dict[int, bytes] = {}
        self._down: dict[int, deque[tuple[int, bytes]]] = {number: deque() for number in vehicles}
        self._broadcasts: deque[bytes] = deque()

    @property
    def vehicles(self) -> list[int]:
        """Whom it serves."""
        return self._vehicles

    def says(self, vehicle: int, data: bytes, t_ns: int) -> None:
        """A vehicle has something to say."""
        queue = self._down[vehicle]
        if len(queue) >= _QUEUE_MAX:
            self.dropped += 1
            return
        queue.append((t_ns, data))

    def broadcast(self, data: bytes) -> None:
        """Something for everybody; what still waits of that kind is old."""
        self._broadcasts.append(data)

    def forget(self) -> None:
        """Whoever sent has gone: what waits to be sent is gone as well."""
        self._again.clear()
        self._broadcasts.clear()

    def run(self, now_ns: int, pull: Callable[[int, int], bytes | None]) -> list[Arrived]:
        """Does the transactions until a time.

        Args:
            now_ns: until when.
            pull: asked for the next packet to a vehicle: its number, the time.

        Returns:
            What arrived, in order.
        """
        arrived: list[Arrived] = []
        self._next_ns = max(self._next_ns, now_ns - _SECOND_NS)
        while self._next_ns + self._period_ns <= now_ns:
            self._next_ns += self._period_ns
            self.transactions += 1
            self._one(self._next_ns, pull, arrived)
        return arrived

    def _one(self, t_ns: int, pull: Callable[[int, int], bytes | None], arrived: list[Arrived]) -> None:
        if self._broadcasts:
            data = self._broadcasts.popleft()
            heard = [number for number in self._vehicles if not self.loss or self._rng.random() >= self.loss]
            arrived += [Arrived(t_ns, number, data, True) for number in heard]
            return
        vehicle = self._vehicles[self._turn % len(self._vehicles)]
        self._turn += 1
        packet = self._again.pop(vehicle, None) or pull(vehicle, t_ns)
        if self.loss and self._rng.random() < self.loss:
            self.lost += 1
            if packet is not None:
                self._again[vehicle] = packet
            return
        if packet is not None:
            arrived.append(Arrived(t_ns, vehicle, packet, True))
        queue = self._down[vehicle]
        if queue and queue[0][0] <= t_ns:
            arrived.append(Arrived(t_ns, vehicle, queue.popleft()[1], False))
