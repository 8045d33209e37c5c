"""What ground stations send: on its way up, put together into frames, handed to the vehicle that it was sent to.

Refuses to act on anything: autopilots do.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Container, Sequence
from typing import NamedTuple

from groundstation.mavlink.codec import Frame, Splitters
from sitl.network import Channel


class _Arrival(NamedTuple):
    """Something under way; ``order`` is never twice the same, so that what follows it is never compared."""

    t_ns: int
    order: int
    vehicle: int
    peer: str
    data: bytes
    stream: bool


class Receiver:
    """Receiving of all vehicles of a world.

    Args:
        uplinks: link to each vehicle.
        plain: vehicles that get datagrams as they come, and no MAVLink frames.
    """

    def __init__(self, uplinks: Sequence[Channel], plain: Container[int] = ()) -> None:
        self._uplinks, self._plain = uplinks, plain
        self._splitters = Splitters()
        self._under_way: list[_Arrival] = []
        self._order = 0

    def send(self, vehicle: int, data: bytes, now_ns: int, peer: str, *, stream: bool) -> None:
        """Takes one datagram for a vehicle; see ``World.receive``."""
        for t_ns, arrived in self._uplinks[vehicle].carry(now_ns, data):
            self._order += 1
            heapq.heappush(self._under_way, _Arrival(t_ns, self._order, vehicle, peer, arrived, stream))

    def deliver(self, now_ns: int, take: Callable[[int, Frame | bytes], None]) -> None:
        """Hands over what has arrived, frame by frame; ``take`` gets the vehicle and the frame, or the datagram."""
        while self._under_way and self._under_way[0].t_ns <= now_ns:
            arrival = heapq.heappop(self._under_way)
            if arrival.vehicle in self._plain:
                take(arrival.vehicle, arrival.data)
                continue
            for piece in self._splitters.feed((arrival.vehicle, arrival.peer), arrival.data, stream=arrival.stream):
                if isinstance(piece, Frame):
                    take(arrival.vehicle, piece)
