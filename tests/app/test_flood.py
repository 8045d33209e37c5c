"""A link that always has more starves neither the tick, nor the operator, nor other links; in virtual time."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence

import pytest

from groundstation.app.loop import FlightClock, Interrupts, Waiting, fly_real, talk
from groundstation.app.session import Session
from groundstation.app.tick_times import TickTimes
from groundstation.mavlink.codec import Encoder
from groundstation.mavlink.station import Outgoing
from groundstation.mission.runner import Runner
from tests.app.flights import pair

MS = 1_000_000
SECOND = 1_000 * MS
PERIOD = 20 * MS
HELLO = Encoder(1).encode("HEARTBEAT", type=2, autopilot=12, system_status=3, mavlink_version=3)


class Clock(FlightClock):
    """Goes on by what things cost, and leaps where it is told to."""

    def __init__(self, leap_at_ns: int = 0) -> None:
        super().__init__()
        self.now, self._leap_at_ns = 0, leap_at_ns

    def now_ns(self) -> int:
        self.now += 1_000
        assert self.now < 60 * SECOND, "the flight does not end"
        if self._leap_at_ns and self.now >= self._leap_at_ns:
            self.now += 3 * SECOND
            self._leap_at_ns = 0
        return self.now


class Pipe:
    """A link; ``pieces`` says what has arrived by now."""

    url, errors, state, left_out, behind = "test", 0, "", "", False

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.known: list[str] = []
        self.sent: list[tuple[int, str]] = []

    def sources(self) -> tuple[int, ...]:
        return ()

    def peers(self) -> tuple[str, ...]:
        return ()

    def service(self, now_ns: int) -> None:
        pass

    def know(self, peers: Collection[str]) -> None:
        self.known = list(peers)

    def receive(self, most: int = 1 << 30) -> list[tuple[str, bytes]]:
        return []

    def send(self, peer: str, data: bytes) -> None:
        self.sent.append((self.clock.now, peer))

    def close(self) -> None:
        pass


class Flood(Pipe):
    """50,000 datagrams a second, each of which takes as long as it took when this was seen: there is always more."""

    def receive(self, most: int = 1 << 30) -> list[tuple[str, bytes]]:
        count = min(2_000, most // 1_400 + 1)  # 2,000: what a link gave at a time before it was asked for less
        self.clock.now += count * 200_000
        return [("10.9.9.9:9", bytes(1_400))] * count


class Quiet(Pipe):
    """A vehicle that speaks every 20 ms."""

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock)
        self.next_ns = 0

    def receive(self, most: int = 1 << 30) -> list[tuple[str, bytes]]:
        if self.clock.now < self.next_ns:
            return []
        self.next_ns = self.clock.now + PERIOD
        return [("10.0.0.1:1", HELLO)]


class Watched(Session):
    """Keeps when it ticked, when it got orders, and when the vehicle was heard."""

    def __init__(self, clock: Clock) -> None:
        changes = ("limits.preflight_s=8", "vehicles.0.link=udpin://127.0.0.1:14541")
        super().__init__(Runner(pair(*changes), 0), None)
        self.clock = clock
        self.ticks: list[int] = []
        self.orders: list[tuple[int, str]] = []
        self.heard: list[int] = []

    def tick(self, now_ns: int) -> list[Outgoing]:
        self.ticks.append(now_ns)
        self.clock.now += 2 * MS
        return super().tick(now_ns)

    def operator(self, command: str, now_ns: int) -> str:
        self.orders.append((now_ns, command))
        return super().operator(command, now_ns)

    def deliver(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> None:
        if data == HELLO:
            self.heard.append(t_rx_ns)
            super().deliver(link, peer, data, t_rx_ns)


class Orders:
    """A control at which an order arrives."""

    def __init__(self, at_ns: int, clock: Clock) -> None:
        self._at_ns, self._clock = at_ns, clock
        self.read_ns: list[int] = []
        self.applied_ns: list[int] = []

    def sources(self) -> Sequence[int]:
        return ()

    def read(self) -> None:
        self.read_ns.append(self._clock.now)

    def apply(self, session: Session, now_ns: int) -> None:
        if self.read_ns and self.read_ns[-1] >= self._at_ns and not self.applied_ns:
            self.applied_ns.append(now_ns)

    def answer(self, session: Session) -> None:
        pass


def _gaps(times: Sequence[int]) -> list[int]:
    return [after - before for before, after in itertools.pairwise(times)]


def test_a_flood_starves_neither_the_tick_nor_orders_nor_other_links(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Waiting, "wait", lambda _self, _timeout_s: [0, 1, 2])
    clock = Clock()
    session, flood, quiet = Watched(clock), Flood(clock), Quiet(clock)
    orders, interrupts = Orders(2 * SECOND, clock), Interrupts()

    def watch(_session: Session, now_ns: int) -> None:
        if now_ns >= 4 * SECOND and not interrupts.count:
            interrupts.interrupt()

    # The order of links in a mission is that in which vehicles name them: the vehicle's is 0.
    fly_real(
        session, [quiet, flood], clock, period_ns=PERIOD, watchers=(watch,), interrupts=interrupts, controls=(orders,)
    )
    assert max(_gaps(session.ticks)) <= 2 * PERIOD
    assert len(session.ticks) >= 0.95 * session.ticks[-1] / PERIOD
    assert max(_gaps(session.heard)) <= 2 * PERIOD
    assert orders.applied_ns[0] <= 2 * SECOND + 2 * PERIOD
    ((returned_ns, order),) = session.orders
    assert order == "return"
    assert returned_ns <= 4 * SECOND + 2 * PERIOD
    assert quiet.known == ["10.0.0.1:1"]


def test_after_standing_still_amid_a_flood_ticks_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Waiting, "wait", lambda _self, _timeout_s: [0, 1])
    clock = Clock(leap_at_ns=2 * SECOND)
    session = Watched(clock)
    fly_real(session, [Quiet(clock), Flood(clock)], clock, period_ns=PERIOD, watchers=(), interrupts=Interrupts())
    gaps = _gaps(session.ticks)
    assert 3 * SECOND < max(gaps) <= 3 * SECOND + 400 * MS
    assert sorted(gaps)[-2] <= 2 * PERIOD


def test_ticks_that_are_always_late_leave_room_for_what_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tick that takes longer than its period: every other one is left out, and everybody is heard all the same."""
    monkeypatch.setattr(Waiting, "wait", lambda _self, _timeout_s: [0, 1])
    clock = Clock()

    class Slow(Watched):
        def tick(self, now_ns: int) -> list[Outgoing]:
            self.clock.now += 25 * MS
            return super().tick(now_ns)

    session, times = Slow(clock), TickTimes()
    links = [Quiet(clock), Flood(clock)]
    fly_real(session, links, clock, period_ns=PERIOD, watchers=(), interrupts=Interrupts(), times=times)
    figures = times.figures()
    assert list((figures["tick_work_ms"] or {}).values()) == pytest.approx([27.0] * 4, rel=0.02)
    late_ms = figures["tick_late_ms"]
    assert late_ms is not None
    assert 5.0 <= late_ms["p50"] <= late_ms["max"] <= 3 * PERIOD / MS
    assert max(_gaps(session.ticks)) <= 3 * PERIOD
    assert max(_gaps(session.heard)) <= 6 * PERIOD


def test_a_flood_does_not_keep_who_only_talks_from_speaking(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Waiting, "wait", lambda _self, _timeout_s: [0])
    clock, spoken = Clock(), []

    def outgoing(now_ns: int) -> list[Outgoing]:
        spoken.append(now_ns)
        return []

    ended_ns = talk([Flood(clock)], clock, 3.0, receive=lambda *_: None, outgoing=outgoing, interrupts=Interrupts())
    assert ended_ns <= 3.1 * SECOND
    assert max(_gaps(spoken)) <= 130 * MS
