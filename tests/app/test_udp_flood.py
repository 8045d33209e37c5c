"""Strangers flood a UDP port in flight: what the vehicle says is fresh all the same. Real sockets, in virtual time."""

from __future__ import annotations

import socket
from collections.abc import Collection, Sequence
from contextlib import ExitStack

import pytest

from groundstation.app.loop import Interrupts, Waiting, fly_real
from groundstation.app.session import Session
from groundstation.links import udp
from groundstation.links.udp import UdpLink, open_udp
from tests.app.test_flood import HELLO, MS, PERIOD, SECOND, Clock, Watched
from tests.links.alone import alone_on_a_port

END = 3 * SECOND
WORD_BYTES = 45
WORD_NS = WORD_BYTES * SECOND // 200_000  # 200 kB/s, as eight vehicles say that stream all they have
STRANGE_BYTE_NS, BYTE_NS = 1_800, 130  # measured: to split hostile bytes, and ordinary telemetry
CALL_NS = 300_000


class Flooded:
    """A link of real sockets, to which everybody sends what is due by the flight's clock before it is read."""

    def __init__(self, link: UdpLink, clock: Clock, stack: ExitStack, size: int, rate_hz: int) -> None:
        self.link, self.clock = link, clock
        self.url, self.errors, self.state, self.behind = link.url, 0, "", False
        self._where = link.socket.getsockname()
        self._vehicle, self._stranger = (
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)
        )
        self._vehicle.bind(("127.0.0.1", 0))
        self.vehicle = f"127.0.0.1:{self._vehicle.getsockname()[1]}"
        self._strange, self._every_ns = bytes(size), SECOND // rate_hz
        self._word_ns = self._strange_ns = 0

    @property
    def left_out(self) -> str:
        return self.link.left_out

    def sources(self) -> Sequence[int]:
        return self.link.sources()

    def peers(self) -> Sequence[str]:
        return ()

    def service(self, now_ns: int) -> None:
        pass

    def know(self, peers: Collection[str]) -> None:
        self.link.know(peers)

    def receive(self, most: int = 4_096) -> list[tuple[str, bytes]]:
        now_ns = self.clock.now
        while self._word_ns <= now_ns or self._strange_ns <= now_ns:
            if self._word_ns <= self._strange_ns:
                first = self._word_ns == 0
                word = HELLO if first else str(self._word_ns).encode().ljust(WORD_BYTES)
                self._vehicle.sendto(word, self._where)
                self._word_ns += WORD_NS
            else:
                self._stranger.sendto(self._strange, self._where)
                self._strange_ns += self._every_ns
        self.clock.now += CALL_NS
        return self.link.receive(most)

    def send(self, peer: str, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass


class Aged(Watched):
    """Keeps how old words were when they came, once their sender was known; what is taken in costs time."""

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock)
        self.ages: list[int] = []
        self.strange = 0
        self.words: list[int] = []

    def deliver(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> None:
        if data == HELLO:
            super().deliver(link, peer, data, t_rx_ns)
        elif len(data) == WORD_BYTES:
            self.clock.now += WORD_BYTES * BYTE_NS
            self.words.append(int(data))
            if self.words[-1] > SECOND // 2:
                self.ages.append(self.clock.now - self.words[-1])
        else:
            self.clock.now += len(data) * STRANGE_BYTE_NS
            self.strange += 1


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize(
    ("size", "rate_hz"), [(60_000, 30), (60_000, 200), (20_000, 600), (4_096, 5_000), (1_400, 20_000)]
)
def test_words_of_vehicles_are_fresh_and_ticks_on_time_whatever_strangers_send(
    size: int, rate_hz: int, *, alone: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if alone:
        monkeypatch.setattr(udp, "open_pair", alone_on_a_port)
    monkeypatch.setattr(Waiting, "wait", lambda _self, _timeout_s: [0])
    clock, interrupts = Clock(), Interrupts()
    session = Aged(clock)

    def watch(_session: Session, now_ns: int) -> None:
        if now_ns >= END:
            interrupts.count = 3

    with ExitStack() as stack:
        link = Flooded(stack.enter_context(open_udp("udpin://127.0.0.1:0")), clock, stack, size, rate_hz)
        fly_real(session, [link], clock, period_ns=PERIOD, watchers=(watch,), interrupts=interrupts)
        assert session.runner.fleet.peer[0] == link.vehicle
    assert max(session.ages) < 100 * MS
    assert session.words == sorted(session.words)
    assert max(after - before for before, after in zip(session.ticks, session.ticks[1:], strict=False)) <= 2 * PERIOD
    told = [note.text for note in session.notes if "left out" in note.text]
    if size <= 4_096:
        assert session.strange > 100, "strangers are heard in what is left"
        assert told == []
    else:
        assert session.strange == 0
        (words,) = told
        assert "datagrams of unknown senders, longer than 4096 bytes" in words
