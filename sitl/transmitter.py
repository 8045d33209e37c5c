"""What the vehicles send: streamed messages made for all at once, frames of their own, datagrams on their links.

Refuses to decide who sends what and when.
"""

from __future__ import annotations

import heapq
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from groundstation.mavlink.codec import encode_batch, message_id
from sitl.messages import Message
from sitl.network import PERFECT, Channel
from sitl.state import State
from sitl.telemetry import View
from sitl.wire import V1_LAST_ID

_DATAGRAM_BYTES = 1200


class Outgoing(NamedTuple):
    """One datagram of one vehicle, at the time at which it arrives at the ground."""

    t_ns: int
    vehicle_index: int
    data: bytes


class _Late(NamedTuple):
    """A datagram under way; ``order`` is never twice the same, so that what follows it is never compared."""

    t_ns: int
    order: int
    vehicle: int
    data: bytes


class Transmitter:
    """Sending of all vehicles of a world.

    Args:
        state: of the world.
        downlinks: link from each vehicle.
        messages: streamed types and how they are made.
        plain: vehicles that send one packet a datagram, and nothing that is MAVLink.
    """

    def __init__(
        self,
        state: State,
        downlinks: Sequence[Channel],
        messages: Mapping[str, Message],
        plain: Container[int] = (),
    ) -> None:
        self._state, self._downlinks, self._messages, self._plain = state, downlinks, messages, plain
        self._pending: list[tuple[list[int], list[bytes]]] = []  # vehicles, and a frame of each, as they were made
        self._under_way: list[_Late] = []
        self._order = 0
        self._sent: list[Outgoing] = []
        self._view: View | None = None

    def begin_step(self) -> None:
        """Forgets what the vehicles believed: the state moves."""
        self._view = None

    def collect(self) -> list[Outgoing]:
        """The list into which everything is put that arrives at the ground from now on, in order of arrival."""
        self._sent = []
        return self._sent

    def emit(self, index: int, frame: bytes) -> None:
        """Takes a frame that a vehicle sends now."""
        if self._state.talking[index]:
            self._pending.append(([index], [frame]))

    def make(self, name: str, vehicles: NDArray[np.int64]) -> int:
        """Makes one message type for some vehicles; returns how many were sent."""
        state = self._state
        message = self._messages[name]
        known = state.known
        needed = [state.talking]
        if message.position:
            needed.append(known.has_position)
        elif message.origin:
            needed.append(known.has_origin)
        if message.gps:
            needed.append(known.has_gps)
        if name in state.broken.muted:
            needed.append(~state.broken.muted[name])
        for able in needed:
            if b"\0" in able.tobytes():  # somebody is not, mostly nobody
                vehicles = vehicles[able[vehicles]]
        if message_id(name) > V1_LAST_ID:
            vehicles = vehicles[[state.pilots[i].voice.encoder.version == 2 for i in vehicles.tolist()]]
        who = vehicles.tolist()
        if not who:
            return 0
        if self._view is None:
            self._view = View(state)
        encoders = [state.pilots[i].voice.encoder for i in who]
        rows = message.make(state, self._view, vehicles)
        self._pending.append((who, encode_batch(name, rows, encoders)))
        return len(who)

    def flush(self) -> None:
        """Puts what each vehicle has to send onto its link, as few datagrams as fit."""
        if not self._pending:
            return
        pending, self._pending = self._pending, []
        state, outgoing = self._state, self._sent
        for index, made in _by_vehicle(pending):
            frames, signing = made, state.signing[index]
            if signing.on:
                if state.known.has_gps[index]:
                    signing.date(state.unix_us())
                frames = [signing.sign(frame) for frame in made]
            channel = self._downlinks[index]
            for data in frames if index in self._plain else _datagrams(frames):
                if channel.config is PERFECT:
                    outgoing.append(Outgoing(state.now_ns, index, data))
                    continue
                for t_ns, arrived in channel.carry(state.now_ns, data):
                    self._order += 1
                    heapq.heappush(self._under_way, _Late(t_ns, self._order, index, arrived))

    def deliver(self) -> None:
        """Lets what is due arrive at the ground."""
        while self._under_way and self._under_way[0].t_ns <= self._state.now_ns:
            late = heapq.heappop(self._under_way)
            self._sent.append(Outgoing(late.t_ns, late.vehicle, late.data))


def _by_vehicle(pending: list[tuple[list[int], list[bytes]]]) -> Iterable[tuple[int, Sequence[bytes]]]:
    """What each vehicle has to send, in the order in which it was made; the vehicles in theirs."""
    first = pending[0][0]
    if all(who == first for who, _ in pending):  # mostly: types that all of them stream
        return zip(first, zip(*(frames for _, frames in pending), strict=True), strict=True)
    of_each: dict[int, list[bytes]] = {}
    for who, frames in pending:
        for index, frame in zip(who, frames, strict=True):
            of_each.setdefault(index, []).append(frame)
    return sorted(of_each.items())


def _datagrams(messages: Sequence[bytes]) -> list[bytes]:
    whole = b"".join(messages)
    if len(whole) <= _DATAGRAM_BYTES:
        return [whole]
    out, size, start = [], 0, 0
    for k, message in enumerate(messages):
        if size and size + len(message) > _DATAGRAM_BYTES:
            out.append(b"".join(messages[start:k]))
            size, start = 0, k
        size += len(message)
    out.append(b"".join(messages[start:]))
    return out
