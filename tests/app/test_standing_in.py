"""What may happen to the ground station's own process: stood still, no terminal, no disk, another date."""

from __future__ import annotations

import ast
import io
import itertools
import os
import signal
import threading
import time
from collections.abc import Collection, Iterator
from pathlib import Path

import pytest
from rich.console import Console
from rich.text import Text

import groundstation
from groundstation.app.loop import FlightClock, Interrupts, Waiting, fly_real, talk
from groundstation.app.progress import FlightDisplay, Screen
from groundstation.app.session import Session
from groundstation.mavlink.station import Outgoing
from groundstation.mission.phases.table import Event
from groundstation.mission.runner import Note, Runner
from groundstation.records.tlog import TlogReader, TlogWriter
from tests.app.flights import SECOND_NS, pair


class Broken(io.StringIO):
    """A terminal that has gone."""

    def write(self, _text: str) -> int:
        raise OSError(5, "Input/output error")


class Stopped(io.StringIO):
    """A terminal that takes nothing, as after Ctrl-S."""

    def __init__(self) -> None:
        super().__init__()
        self.go_on = threading.Event()

    def write(self, text: str) -> int:
        self.go_on.wait()
        return super().write(text)


class Greedy(Console):
    """A console for which there is no memory left."""

    def print(self, *_objects: object, **_options: object) -> None:
        raise MemoryError


@pytest.mark.parametrize("console", [Console(file=Broken()), Greedy(file=io.StringIO())])
def test_a_display_that_fails_ends_itself_and_nothing_else(console: Console) -> None:
    session = Session(Runner(pair(), 0), None)
    with FlightDisplay(console, pair()) as display:
        for tick in range(200):
            session.remark("alarm", "something", tick)
            display(session, tick * SECOND_NS)
    assert display.screen.problem is not None
    assert session.notes == []


def test_a_terminal_that_is_stopped_does_not_stop_the_tick() -> None:
    file = Stopped()
    screen = Screen(Console(file=file, force_terminal=False))
    screen.start()
    for number in range(20_000):
        screen.line(Text(f"line {number}"))  # would wait for ever if it waited at all
    file.go_on.set()
    screen.stop()
    assert "line 19999" in file.getvalue()
    assert len(file.getvalue().splitlines()) <= 6_000  # the oldest were left out


def test_everything_is_shown_before_the_end() -> None:
    file = io.StringIO()
    screen = Screen(Console(file=file, force_terminal=False))
    screen.start()
    for number in range(300):
        screen.line(Text(f"line {number}"))
    screen.stop()
    assert file.getvalue().split("\n")[:-1] == [f"line {number}" for number in range(300)]


class Recording(Session):
    """Keeps the times of its ticks and the orders it was given."""

    def __init__(self) -> None:
        super().__init__(Runner(pair("limits.preflight_s=3"), 0), None)
        self.ticks: list[int] = []
        self.orders: list[str] = []
        self.delivered: list[bytes] = []

    def tick(self, now_ns: int) -> list[Outgoing]:
        self.ticks.append(now_ns)
        return super().tick(now_ns)

    def operator(self, command: str, now_ns: int) -> str:
        self.orders.append(command)
        return super().operator(command, now_ns)

    def deliver(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> None:
        self.delivered.append(data)
        super().deliver(link, peer, data, t_rx_ns)


class StoppedClock(FlightClock):
    """Runs from question to question, and leaps once, as after SIGSTOP or with the lid closed."""

    def __init__(self, leap_at_ns: int, leap_ns: int) -> None:
        super().__init__()
        self._now_ns, self._leap_at_ns, self._leap_ns = 0, leap_at_ns, leap_ns

    def now_ns(self) -> int:
        self._now_ns += 5_000_000
        if self._leap_ns and self._now_ns >= self._leap_at_ns:
            self._now_ns += self._leap_ns
            self._leap_ns = 0
        return self._now_ns


class OneLink:
    """A link on which old datagrams lie after the leap."""

    url, errors, state, left_out = "test", 0, "", ""

    def __init__(self, session: Recording) -> None:
        self._session = session
        self._old = [[("a:1", b"old")] * 3, [("a:1", b"old")] * 2]
        self.sent: list[tuple[str, bytes]] = []

    def sources(self) -> tuple[int, ...]:
        return ()

    def peers(self) -> tuple[str, ...]:
        return ()

    def service(self, now_ns: int) -> None:
        pass

    @property
    def behind(self) -> bool:
        return False

    def know(self, peers: Collection[str]) -> None:
        pass

    def receive(self, most: int = 0) -> list[tuple[str, bytes]]:
        return self._old.pop() if self._old else []

    def send(self, peer: str, data: bytes) -> None:
        self.sent.append((peer, data))

    def close(self) -> None:
        pass


def test_after_standing_still_what_is_old_is_taken_in_before_anybody_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Waiting, "wait", lambda _self, _timeout_s: [])
    session = Recording()
    link = OneLink(session)
    clock = StoppedClock(SECOND_NS, 3 * SECOND_NS)
    fly_real(session, [link], clock, period_ns=20_000_000, watchers=(), interrupts=Interrupts())
    gap = max(range(1, len(session.ticks)), key=lambda k: session.ticks[k] - session.ticks[k - 1])
    assert session.ticks[gap] - session.ticks[gap - 1] > 3 * SECOND_NS + 100_000_000
    assert session.delivered == [b"old"] * 5
    assert any("stood still for 3.0 s" in note.text for note in session.notes)


@pytest.mark.parametrize(("end", "ticks"), [("time", 10), ("done", 3), ("interrupt", 4)])
def test_who_only_talks_passes_on_what_comes_and_ends_in_time_when_done_or_by_ctrl_c(
    end: str, ticks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Waiting, "wait", lambda _self, _timeout_s: [0])
    link, interrupts = OneLink(Recording()), Interrupts()
    taken: list[tuple[int, str, bytes]] = []
    times_ns: list[int] = []

    def outgoing(now_ns: int) -> list[Outgoing]:
        times_ns.append(now_ns)
        if end == "interrupt" and len(times_ns) == ticks:
            interrupts.interrupt()
        return [Outgoing(0, "a:1", (b"one", b"two"))]

    ended_ns = talk(
        [link],
        StoppedClock(0, 0),
        1.0,
        receive=lambda number, peer, data, _now_ns: taken.append((number, peer, data)),
        outgoing=outgoing,
        interrupts=interrupts,
        done=lambda: end == "done" and len(times_ns) == ticks,
    )
    assert taken == [(0, "a:1", b"old")] * 5
    assert link.sent == [("a:1", b"onetwo")] * ticks
    assert all(after - before >= 100_000_000 for before, after in itertools.pairwise(times_ns))
    assert ended_ns >= SECOND_NS if end == "time" else ended_ns == times_ns[-1]


def _interrupted(interrupts: Interrupts, number: int) -> Recording:
    session = Recording()
    with interrupts.listening():
        os.kill(os.getpid(), number)
        for _ in range(3):
            assert interrupts.apply(session, 0)
    return session


def test_a_terminal_that_is_closed_brings_everybody_back_once(request: pytest.FixtureRequest) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests themselves may run under nohup
    request.addfinalizer(lambda: signal.signal(signal.SIGHUP, before))
    session = _interrupted(Interrupts(), signal.SIGHUP)
    assert session.orders == ["return"]
    assert any("terminal was closed" in note.text for note in session.notes)
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL


def test_under_nohup_a_closed_terminal_changes_nothing() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert _interrupted(Interrupts(), signal.SIGHUP).orders == []
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", [signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU])
def test_job_control_does_not_suspend_a_flight(number: int) -> None:
    assert _interrupted(Interrupts(), number).orders == []


def test_setting_the_clock_by_an_hour_steers_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = FlightClock()
    epoch, before = clock.epoch_unix_us, clock.now_ns()
    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() - 3600 * SECOND_NS)
    monkeypatch.setattr(time, "time", lambda: real() / 1e9 - 3600)
    assert clock.now_ns() >= before
    assert clock.epoch_unix_us == epoch


def test_the_date_is_asked_in_three_places_only_and_nowhere_below_app() -> None:
    """For the stamp of the log, for the name of its file, and for a stream of what others fly now."""
    package = Path(groundstation.__file__).parent
    found = set()
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                name = f"{node.value.id}.{node.attr}"
                if name in ("time.time", "time.time_ns", "time.strftime", "datetime.now", "datetime.utcnow"):
                    found.add((path.relative_to(package).as_posix(), name))
    flying = {item for item in found if "campaign" not in item[0] and "signing" not in item[0]}
    assert flying == {
        ("app/loop.py", "time.time_ns"),
        ("app/flying.py", "time.strftime"),
        ("app/commands/console.py", "time.time_ns"),
    }


@pytest.fixture
def log(tmp_path: Path) -> Iterator[tuple[Path, TlogWriter]]:
    path = tmp_path / "flights" / "a.tlog"
    path.parent.mkdir()
    with TlogWriter(path, 0) as writer:
        yield path, writer


def test_a_log_that_is_cut_off_at_once_is_a_log(log: tuple[Path, TlogWriter]) -> None:
    path, _ = log
    reader = TlogReader(path.read_bytes())
    assert reader.native
    assert list(reader) == []


def test_a_log_folder_that_vanishes_is_told_and_the_flight_goes_on(log: tuple[Path, TlogWriter]) -> None:
    path, writer = log
    session = Session(Runner(pair(), 0), writer)
    path.unlink()
    path.parent.rmdir()
    for tick in range(1, 120):
        session.tick(tick * 20_000_000)
    problems = [note.text for note in session.notes if "recording stopped" in note.text]
    assert len(problems) == 1
    assert "a.tlog" in problems[0]
    assert isinstance(session.notes[0], Note)


def test_descriptors_that_change_hands_between_sources_do_not_end_the_waiting() -> None:
    """One source closes a descriptor, and an earlier one gets its number in the same moment."""

    class Source:
        def __init__(self) -> None:
            self.now: tuple[int, ...] = ()

        def sources(self) -> tuple[int, ...]:
            return self.now

    first, second = Source(), Source()
    with Waiting([first, second]) as waiting:
        read, write = os.pipe()
        second.now = (read,)
        assert waiting.wait(0.0) == []
        os.close(read)
        again, other = os.pipe()
        assert again == read
        second.now, first.now = (), (again,)
        os.write(other, b"x")
        assert waiting.wait(1.0) == [0]
        for descriptor in (again, write, other):
            os.close(descriptor)


def test_no_distance_is_shown_before_there_is_one() -> None:
    session = Session(Runner(pair(), 0), None)
    session.runner._machine.happen(Event.READY, 0)
    display = FlightDisplay(Console(file=io.StringIO()), pair())
    assert "distance" not in display._line(session, 0).plain
    session.runner.figures.min_distance_m = 1.234
    assert "smallest distance 1.23 m" in display._line(session, 0).plain
