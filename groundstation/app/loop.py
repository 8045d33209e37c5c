"""The loops that fly: one on virtual time against the emulator, one on the wall clock against sockets.

A short third one talks with vehicles without flying them. This is the one place in the program that waits for bytes
and for the next tick.
"""

from __future__ import annotations

import selectors
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from types import FrameType
from typing import Protocol

from groundstation.app.session import Session
from groundstation.app.tick_times import TickTimes
from groundstation.core.errors import UserError
from groundstation.links.link import RECEIVE_BYTES, Link
from groundstation.mavlink.station import Outgoing as Datagram
from sitl.world import Outgoing

_MICROSECOND_NS = 1_000
_STOOD_STILL_NS = 300_000_000
_CATCH_UP_NS = 100_000_000
_TALK_TICK_NS = 100_000_000
_DRAIN_NS = 100_000_000
_SHARE_OF_PERIOD = 4  # a late tick leaves a quarter of a period to what arrives, no less


Watcher = Callable[[Session, int], None]
"""Looks on after every tick, given its time: a progress display, or a measurement of the emulator's truth."""


class EmulatedWorld(Protocol):
    """What the virtual loop needs of an emulator; a test may stand in between and tamper."""

    def advance(self, now_ns: int) -> list[Outgoing]:
        """Moves everything to a time; returns what arrived at the ground on the way."""

    def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
        """Hands in what the ground station sent to a vehicle."""


class Control(Protocol):
    """A way for the operator to speak: the keyboard, a local socket. Never waits and never raises."""

    def sources(self) -> Sequence[int]:
        """Descriptors to wait on; may change from call to call."""

    def read(self) -> None:
        """Takes what has arrived at the sources."""

    def apply(self, session: Session, now_ns: int) -> None:
        """Hands orders over, right before the tick that acts on them."""

    def answer(self, session: Session) -> None:
        """Tells, right after that tick, what became of them."""


class _Desk:
    """All that the operator speaks by; what fails there is told once and costs no tick."""

    def __init__(self, controls: Sequence[Control], session: Session) -> None:
        self.controls = controls
        self._session = session
        self._failed: set[int] = set()
        self._now_ns = 0

    def read(self, number: int) -> None:
        """Takes what has arrived at one of them."""
        self._guard(number, self.controls[number].read)

    def read_all(self) -> None:
        """The same at all of them."""
        for number in range(len(self.controls)):
            self.read(number)

    def apply(self, now_ns: int) -> None:
        """Hands orders over, right before the tick."""
        self._now_ns = now_ns
        for number, control in enumerate(self.controls):
            self._guard(number, partial(control.apply, self._session, now_ns))

    def answer(self) -> None:
        """Tells, right after the tick, what became of them."""
        for number, control in enumerate(self.controls):
            self._guard(number, partial(control.answer, self._session))

    def _guard(self, number: int, act: Callable[[], None]) -> None:
        try:
            act()
        except Exception as error:
            if number not in self._failed:
                self._failed.add(number)
                name = type(self.controls[number]).__name__
                text = f"fault in the ground station, {name}: {type(error).__name__}: {error}; the flight goes on"
                self._session.remark("alarm", text, self._now_ns)


class Interrupts:
    """Ctrl-C as the operator's commands: once to come back, twice to end the setpoints, a third time to leave.

    A terminal that is closed means that nobody is at the keyboard any more: everybody comes back, and the flight goes
    on to its end. Started with SIGHUP ignored (nohup), it flies on.
    """

    def __init__(self) -> None:
        self.count = 0
        self.hung_up = False
        self._acted_on = 0
        self._hang_up_acted_on = False

    def interrupt(self) -> None:
        """One Ctrl-C."""
        self.count += 1

    def apply(self, session: Session, now_ns: int) -> bool:
        """Passes new interrupts on as operator commands; returns False when the operator wants to leave at once."""
        while self._acted_on < min(self.count, 2):
            self._acted_on += 1
            session.operator("return" if self._acted_on == 1 else "silence", now_ns)
        if self.hung_up and not self._hang_up_acted_on:
            self._hang_up_acted_on = True
            session.remark("alarm", "the terminal was closed; everybody comes back", now_ns)
            session.operator("return", now_ns)
        return self.count < 3

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Takes SIGINT, SIGTERM and SIGHUP while the block runs.

        What job control does to a program that runs at a terminal would stop the setpoints, and is ignored: Ctrl-Z,
        and reading or writing from the background.
        """

        def take(_signal: int, _frame: FrameType | None) -> None:
            self.interrupt()

        def hang_up(_signal: int, _frame: FrameType | None) -> None:
            self.hung_up = True

        before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            before[signal.SIGHUP] = signal.signal(signal.SIGHUP, hang_up)
        for number in (signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU):
            before[number] = signal.signal(number, signal.SIG_IGN)
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
    controls: Sequence[Control] = (),
) -> None:
    """Flies against the emulator on virtual time, as fast as the machine can.

    Args:
        session: the flight.
        world: the emulator; vehicle i of it is vehicle i of the mission.
        period_ns: tick, ns.
        watchers: called after every tick.
        interrupts: operator's Ctrl-C.
        pace: called with the virtual time before every tick, to hold it to the wall clock; None to hurry.
        controls: what else the operator speaks by; looked at before every tick.

    Raises:
        UserError: the team would wait for an order that nobody can give.
    """
    fleet = session.runner.fleet
    peers, links = [f"emulator:{sysid}" for sysid in fleet.ids], fleet.link.tolist()
    vehicle_of_peer = {peer: vehicle for vehicle, peer in enumerate(peers)}
    if fleet.room is not None:  # one more, who speaks of all of them
        peers.append("emulator:room")
        links.append(fleet.room.config.link)
    if session.runner.plan.spec.takeoff.wait and not controls:
        raise UserError(
            f"{session.runner.plan.source}: takeoff.wait: nobody gives the order `start` in virtual time; fly it with"
            " --realtime, or with --set takeoff.wait=false"
        )
    desk = _Desk(controls, session)
    now_ns = 0
    while not session.runner.done:
        now_ns += period_ns
        if pace is not None:
            pace(now_ns)
        session.deliver_all(
            [
                (links[vehicle], peers[vehicle], data, t_ns - t_ns % _MICROSECOND_NS)
                for t_ns, vehicle, data in world.advance(now_ns)
            ]
        )
        if not interrupts.apply(session, now_ns):
            session.settle()
            return
        desk.read_all()
        desk.apply(now_ns)
        for datagram in session.tick(now_ns):
            vehicle = vehicle_of_peer.get(datagram.peer)
            if vehicle is not None:  # a greeting to an address of the real world reaches nobody
                world.receive(vehicle, b"".join(datagram.frames), now_ns)
        desk.answer()
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

    The date is asked once, for the stamp of the log; whoever sets the machine's clock steers nothing. Time in which the
    machine sleeps counts, where the system has a clock for it: the vehicles did not sleep.

    Attributes:
        epoch_unix_us: unix time at which it began.
    """

    def __init__(self) -> None:
        self.epoch_unix_us = time.time_ns() // 1000
        self._clock = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
        self._start_ns = time.clock_gettime_ns(self._clock)

    def now_ns(self) -> int:
        """Time since the flight began."""
        elapsed_ns = time.clock_gettime_ns(self._clock) - self._start_ns
        return elapsed_ns - elapsed_ns % _MICROSECOND_NS


def fly_real(
    session: Session,
    links: Sequence[Link],
    clock: FlightClock,
    *,
    period_ns: int,
    watchers: Sequence[Watcher],
    interrupts: Interrupts,
    controls: Sequence[Control] = (),
    times: TickTimes | None = None,
) -> None:
    """Flies on the wall clock over sockets.

    What arrives is taken in in small pieces, link by link, those that are known first, with a look at the clock after
    each: however much comes, the tick and the operator's orders follow when they are due (``_Intake``).

    A late tick is made at once and counted by the runner; the schedule goes on from where it should be, and ticks
    that were missed altogether are left out rather than made up for. After a longer standstill (the program was
    suspended, or the machine) what lies in the sockets is old: it is taken in first, and the next tick waits for a
    moment for what is new, so that nobody is judged, or steered, by where he was. Both take a tenth of a second at
    most, and never twice without a tick in between.

    Args:
        session: the flight.
        links: in the order of the plan's links.
        clock: the flight's time.
        period_ns: tick, ns.
        watchers: called after every tick.
        interrupts: operator's Ctrl-C.
        controls: what else the operator speaks by.
        times: counts how punctual every tick was.
    """
    desk = _Desk(controls, session)
    fleet = session.runner.fleet
    known: list[tuple[int, str]] | None = None
    told: list[Link] = []
    caught_up = False
    with Waiting([*links, *controls]) as waiting:
        intake = _Intake(links, waiting, clock, session.deliver)
        next_tick_ns = clock.now_ns() + period_ns
        while not session.runner.done:
            for number in intake.take(next_tick_ns, period_ns // _SHARE_OF_PERIOD):
                desk.read(number)
            now_ns = clock.now_ns()
            if now_ns < next_tick_ns:
                continue
            if now_ns - next_tick_ns >= _STOOD_STILL_NS and not caught_up:
                stood_s = (now_ns - next_tick_ns) / 1e9
                session.remark("alarm", f"the ground station stood still for {stood_s:.1f} s", now_ns)
                intake.drain(now_ns + _DRAIN_NS)
                next_tick_ns = clock.now_ns() + _CATCH_UP_NS
                caught_up = True
                continue
            caught_up = False
            if not interrupts.apply(session, now_ns):
                session.settle()
                return
            desk.apply(now_ns)
            for link in links:
                link.service(now_ns)
                if link.left_out and link not in told:
                    told.append(link)
                    session.remark("info", f"link {link.url}: left out: {link.left_out}; more is only counted", now_ns)
            if known != (heard := fleet.heard_at()):
                known = heard
                for number, link in enumerate(links):
                    link.know([peer for where, peer in known if where == number])
            setpoints = session.runner.setpoints_sent
            for datagram in session.tick(now_ns):
                links[datagram.link].send(datagram.peer, b"".join(datagram.frames))
            if times is not None:
                steers = session.runner.setpoints_sent > setpoints
                times.tick(next_tick_ns, now_ns, clock.now_ns(), intake.heard_ns, steers=steers)
                intake.heard_ns = None
            desk.answer()
            for watch in watchers:
                watch(session, now_ns)
            next_tick_ns += period_ns * ((now_ns - next_tick_ns) // period_ns + 1)


class _Intake:
    """Takes in what arrives on links, a small piece from each in turn, and never for longer than it may.

    Args:
        links: in the order of their numbers.
        waiting: waits on these links, then on controls.
        clock: looked at after every piece.
        deliver: takes number of the link, peer, bytes and time of arrival.

    Attributes:
        heard_ns: when the last datagram was taken in, ns; None since somebody set it so.
    """

    def __init__(
        self,
        links: Sequence[Link],
        waiting: Waiting,
        clock: FlightClock,
        deliver: Callable[[int, str, bytes, int], None],
    ) -> None:
        self._links, self._waiting, self._clock, self._deliver = links, waiting, clock, deliver
        self._turn = 0
        self.heard_ns: int | None = None

    def take(self, until_ns: int, least_ns: int) -> list[int]:
        """Waits until something comes, and takes in one round of it.

        Args:
            until_ns: neither waits nor takes in beyond this time.
            least_ns: so long it takes in what is there even when that time is near, or over.

        Returns:
            Numbers of the controls at which something has arrived.
        """
        links = self._links
        behind = {number for number, link in enumerate(links) if link.behind}
        now_ns = self._clock.now_ns()
        ready = self._waiting.wait(0.0 if behind else max(0.0, (until_ns - now_ns) / 1e9))
        until_ns = max(until_ns, self._clock.now_ns() + least_ns)
        self._round(sorted(behind.union(number for number in ready if number < len(links))), until_ns)
        return [number - len(links) for number in ready if number >= len(links)]

    def drain(self, until_ns: int) -> None:
        """Takes in all that lies in the sockets, as far as time allows."""
        while self._clock.now_ns() < until_ns and self._round(range(len(self._links)), until_ns):
            pass

    def _round(self, numbers: Sequence[int], until_ns: int) -> bool:
        """One piece from each of these links; another one begins every time. Returns whether anything came."""
        self._turn += 1
        came = False
        for place in range(len(numbers)):
            number = numbers[(place + self._turn) % len(numbers)]
            for peer, data in self._links[number].receive(RECEIVE_BYTES):
                self.heard_ns = self._clock.now_ns()
                self._deliver(number, peer, data, self.heard_ns)
                came = True
            if self._clock.now_ns() >= until_ns:
                break
        return came


def talk(
    links: Sequence[Link],
    clock: FlightClock,
    seconds: float,
    *,
    receive: Callable[[int, str, bytes, int], None],
    outgoing: Callable[[int], Sequence[Datagram]],
    interrupts: Interrupts,
    done: Callable[[], bool] = lambda: False,
) -> int:
    """Listens and speaks on links for some seconds, ten times a second, without flying anybody.

    Args:
        links: open ones, in the order of their numbers.
        clock: time, from which the seconds count.
        seconds: how long at most.
        receive: takes what has arrived: number of the link, peer, bytes, time in ns.
        outgoing: what is to be sent at a time in ns.
        interrupts: a Ctrl-C ends it.
        done: asked in between; True ends it early.

    Returns:
        The time at which it ended, ns.
    """
    with Waiting(links) as waiting:
        intake = _Intake(links, waiting, clock, receive)
        now_ns = next_tick_ns = 0
        while now_ns < seconds * 1e9 and not interrupts.count and not done():
            intake.take(next_tick_ns, _TALK_TICK_NS // _SHARE_OF_PERIOD)
            now_ns = clock.now_ns()
            if now_ns >= next_tick_ns:
                next_tick_ns = now_ns + _TALK_TICK_NS
                for link in links:
                    link.service(now_ns)
                for datagram in outgoing(now_ns):
                    links[datagram.link].send(datagram.peer, b"".join(datagram.frames))
    return now_ns


class _Source(Protocol):
    """Anything with descriptors to wait on."""

    def sources(self) -> Sequence[int]:
        """Descriptors; may change from call to call."""


class Waiting:
    """Waits for bytes on links and controls whose connections come and go: the one place that blocks.

    Args:
        links: in the order of the numbers that ``wait`` returns.
    """

    def __init__(self, links: Sequence[_Source]) -> None:
        self._links = links
        self._selector = selectors.DefaultSelector()
        self._known: list[tuple[int, ...]] = [()] * len(links)

    def __enter__(self) -> Waiting:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Gives the selector back; the links stay open."""
        self._selector.close()

    def wait(self, timeout_s: float) -> list[int]:
        """Waits until bytes arrive, at most for a time; returns the numbers of those that have some."""
        changed = []
        for number, link in enumerate(self._links):
            now = tuple(link.sources())
            if now != self._known[number]:
                # A descriptor that was closed has left the selector by itself, and its number may be in use again, even
                # by another link: all that has gone goes before anything new comes.
                for descriptor in self._known[number]:
                    with suppress(KeyError, ValueError, OSError):
                        self._selector.unregister(descriptor)
                changed.append((number, now))
        for number, now in changed:
            for descriptor in now:
                with suppress(OSError):  # one that cannot be waited on, such as a file in place of a terminal
                    self._selector.register(descriptor, selectors.EVENT_READ, number)
            self._known[number] = now
        return sorted({key.data for key, _ in self._selector.select(timeout_s)})
