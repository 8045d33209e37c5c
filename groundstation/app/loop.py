"""The loops that fly: one on virtual time against the emulator, one on the wall clock against sockets.

The wall-clock loop is the one place in the program that waits for bytes and for the next tick.
"""

from __future__ import annotations

import selectors
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Protocol

from groundstation.app.session import Session
from groundstation.links.udp import UdpLink
from sitl.world import Outgoing

_MICROSECOND_NS = 1_000


Watcher = Callable[[Session, int], None]
"""Looks on after every tick, given its time: a progress display, or a measurement of the emulator's truth."""


class EmulatedWorld(Protocol):
    """What the virtual loop needs of an emulator; a test may stand in between and tamper."""

    def advance(self, now_ns: int) -> list[Outgoing]:
        """Moves everything to a time; returns what arrived at the ground on the way."""

    def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
        """Hands in what the ground station sent to a vehicle."""


class Interrupts:
    """Ctrl-C as the operator's commands: once to come back, twice to end the setpoints, a third time to leave."""

    def __init__(self) -> None:
        self.count = 0
        self._acted_on = 0

    def interrupt(self) -> None:
        """One Ctrl-C."""
        self.count += 1

    def apply(self, session: Session, now_ns: int) -> bool:
        """Passes new interrupts on as operator commands; returns False when the operator wants to leave at once."""
        while self._acted_on < min(self.count, 2):
            self._acted_on += 1
            session.operator("return" if self._acted_on == 1 else "silence", now_ns)
        return self.count < 3

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Takes SIGINT and SIGTERM as interrupts while the block runs."""

        def take(_signal: int, _frame: FrameType | None) -> None:
            self.interrupt()

        before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def fly_virtual(
    session: Session,
    world: EmulatedWorld,
    *,
    period_ns: int,
    watchers: Sequence[Watcher],
    interrupts: Interrupts,
    pace: Callable[[int], None] | None = None,
) -> None:
    """Flies against the emulator on virtual time, as fast as the machine can.

    Args:
        session: the flight.
        world: the emulator; vehicle i of it is vehicle i of the mission.
        period_ns: tick, ns.
        watchers: called after every tick.
        interrupts: operator's Ctrl-C.
        pace: called with the virtual time before every tick, to hold it to the wall clock; None to hurry.
    """
    fleet = session.runner.fleet
    peers = [f"emulator:{sysid}" for sysid in fleet.sysid]
    vehicle_of_peer = {peer: vehicle for vehicle, peer in enumerate(peers)}
    now_ns = 0
    while not session.runner.done:
        now_ns += period_ns
        if pace is not None:
            pace(now_ns)
        for sent in world.advance(now_ns):
            t_rx_ns = sent.t_ns - sent.t_ns % _MICROSECOND_NS
            session.deliver(int(fleet.link[sent.vehicle_index]), peers[sent.vehicle_index], sent.data, t_rx_ns)
        if not interrupts.apply(session, now_ns):
            return
        for datagram in session.tick(now_ns):
            if datagram.peer in vehicle_of_peer:
                world.receive(vehicle_of_peer[datagram.peer], b"".join(datagram.frames), now_ns)
        for watch in watchers:
            watch(session, now_ns)


def wall_clock_pace() -> Callable[[int], None]:
    """Makes a ``pace`` for ``fly_virtual`` that keeps virtual time from running ahead of the wall clock."""
    start_ns = time.monotonic_ns()

    def pace(now_ns: int) -> None:
        ahead_ns = start_ns + now_ns - time.monotonic_ns()
        if ahead_ns > 0:
            time.sleep(ahead_ns / 1e9)

    return pace


class FlightClock:
    """Time since the flight began, in ns cut to whole microseconds, which is what logs keep.

    Attributes:
        epoch_unix_us: unix time at which it began.
    """

    def __init__(self) -> None:
        self.epoch_unix_us = time.time_ns() // 1000
        self._start_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        """Time since the flight began."""
        elapsed_ns = time.monotonic_ns() - self._start_ns
        return elapsed_ns - elapsed_ns % _MICROSECOND_NS


def fly_real(
    session: Session,
    links: Sequence[UdpLink],
    clock: FlightClock,
    *,
    period_ns: int,
    watchers: Sequence[Watcher],
    interrupts: Interrupts,
) -> None:
    """Flies on the wall clock over sockets.

    A late tick is made at once and counted by the runner; the schedule goes on from where it should be, and ticks
    that were missed altogether are left out rather than made up for.

    Args:
        session: the flight.
        links: in the order of the plan's links.
        clock: the flight's time.
        period_ns: tick, ns.
        watchers: called after every tick.
        interrupts: operator's Ctrl-C.
    """
    with selectors.DefaultSelector() as selector:
        for number, link in enumerate(links):
            selector.register(link.socket, selectors.EVENT_READ, number)
        next_tick_ns = clock.now_ns() + period_ns
        while not session.runner.done:
            wait_s = max(0.0, (next_tick_ns - clock.now_ns()) / 1e9)
            for key, _ in selector.select(wait_s):
                for peer, data in links[key.data].receive():
                    session.deliver(key.data, peer, data, clock.now_ns())
            now_ns = clock.now_ns()
            if now_ns < next_tick_ns:
                continue
            if not interrupts.apply(session, now_ns):
                return
            for datagram in session.tick(now_ns):
                links[datagram.link].send(datagram.peer, b"".join(datagram.frames))
            for watch in watchers:
                watch(session, now_ns)
            next_tick_ns += period_ns * ((now_ns - next_tick_ns) // period_ns + 1)
