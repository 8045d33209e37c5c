"""Keys of a flight: what they come to, and the terminal they are taken from."""

from __future__ import annotations

import os
import pty
import select
import termios
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.app.emulator import world_config
from groundstation.app.keyboard import HELP, Keyboard, KeyDialogue
from groundstation.app.loop import Interrupts, fly_virtual
from groundstation.app.session import Session
from groundstation.mission.operator import parse_command
from groundstation.mission.runner import Phase, Runner
from sitl.world import World
from tests.app.flights import pair

IDS = [1, 2, 13]


@pytest.mark.parametrize(
    ("typed", "orders"),
    [
        (b"h", ["hold"]),
        (b"R", ["resume"]),
        (b"b", ["return"]),
        (b"hrb", ["hold", "resume", "return"]),
        (b"l13\r", ["land 13"]),
        (b"l2 1\r", ["land 1 2"]),
        (b"la\r", ["land all"]),
        (b"lall\n", ["land all"]),
        (b"l12\x7f3\r", ["land 13"]),
        (b"k2\rkill\r", ["kill 2"]),
        (b"ka\rKILL\r", ["kill all"]),
        (b"k2\ryes\r", []),
        (b"k2\r\r", []),
        (b"k2\r\x1bh", ["hold"]),
        (b"l\x1bkill\r", []),
        (b"l7\r", []),
        (b"l\r", []),
        (b"lx\r", []),
        (b"\x1b[A\x1b[B\x1bOC\x1b[3~h", ["hold"]),  # arrows and delete are no keys of ours
        (b"xyz019 \r\n", []),
    ],
)
def test_what_is_typed(typed: bytes, orders: list[str]) -> None:
    at_once, one_by_one = KeyDialogue(IDS), KeyDialogue(IDS)
    assert at_once.feed(typed) == orders
    if b"\x1b" not in typed:  # a terminal sends the bytes of one key together
        assert [line for k in range(len(typed)) for line in one_by_one.feed(typed[k : k + 1])] == orders


def test_questions_are_shown_while_they_are_open() -> None:
    keys = KeyDialogue(IDS)
    assert keys.prompt == HELP
    keys.feed(b"k")
    assert keys.prompt.startswith("kill whom?")
    keys.feed(b"13")
    assert keys.prompt.endswith(": 13")
    keys.feed(b"\r")
    assert keys.prompt.startswith("vehicle 13 falls: type the word kill and Enter")
    keys.feed(b"kil\r")
    assert keys.prompt == HELP
    assert keys.problems == ["kill 13: not confirmed, nothing was done"]
    keys.feed(b"l99\r")
    assert "99 is no vehicle of this mission; those are 1, 2, 13" in keys.problems[-1]


@given(st.binary(max_size=200))
def test_no_typing_kills_without_the_word_or_gives_an_order_that_cannot_be_read(typed: bytes) -> None:
    for line in KeyDialogue(IDS).feed(typed):
        assert parse_command(line, IDS).text == line
        assert not line.startswith("kill") or b"kill" in typed.lower()


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    far, near = pty.openpty()
    yield far, near
    for descriptor in (far, near):
        os.close(descriptor)


def _modes(descriptor: int) -> list[object]:
    return list(termios.tcgetattr(descriptor))


def test_the_terminal_is_as_it_was_however_the_flight_ends(terminal: tuple[int, int]) -> None:
    _, near = terminal
    before = _modes(near)
    keyboard = Keyboard(near, IDS)

    def fly() -> None:
        with keyboard:
            assert _modes(near) != before
            assert keyboard.sources() == (near,)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fly()
    assert _modes(near) == before
    assert keyboard.sources() == ()


def test_keys_arrive_one_by_one_and_ctrl_z_does_not_stop_the_flight(terminal: tuple[int, int]) -> None:
    far, near = terminal
    session = Session(Runner(pair(), 0), None)
    os.write(far, b"b")  # typed before the flight: not meant for it
    with Keyboard(near, IDS) as keyboard:
        for key in (b"h", b"\x1a", b"\x13", b"\x1c", b"b"):
            os.write(far, key)
            assert select.select([near], [], [], 5.0)[0]
            keyboard.read()
        assert termios.tcgetattr(near)[3] & termios.ISIG  # Ctrl-C stays what it is
        keyboard.apply(session, 0)
    assert session.runner._lines == ["hold", "return"]
    assert session.notes == []


def test_reading_without_a_key_does_not_wait_and_a_terminal_that_is_gone_ends_it() -> None:
    far, near = pty.openpty()
    with Keyboard(near, IDS) as keyboard:
        os.close(far)
        keyboard.read()
        assert keyboard.sources() == ()
        assert keyboard.prompt() == ""
        keyboard.read()
    os.close(near)


def test_only_a_terminal_of_ours_is_a_keyboard(terminal: tuple[int, int]) -> None:
    read, write = os.pipe()
    assert not Keyboard.usable(read)
    assert not Keyboard.usable(terminal[1])  # a terminal, and not the one we are in the foreground of
    assert not Keyboard.usable(9999)
    os.close(read)
    os.close(write)


def test_keys_work_in_a_dry_run_which_looks_at_them_in_every_tick(terminal: tuple[int, int]) -> None:
    far, near = terminal
    plan = pair()
    session = Session(Runner(plan, 0), None)

    def type_late(now_ns: int) -> None:
        if now_ns == 500_000_000:
            os.write(far, b"b")
            assert select.select([near], [], [], 5.0)[0]
        assert now_ns <= 1_000_000_000, "the key was not taken"

    with Keyboard(near, IDS[:2]) as keyboard:
        fly_virtual(
            session,
            World(world_config(plan, 1), 1),
            period_ns=50_000_000,
            watchers=(),
            interrupts=Interrupts(),
            pace=type_late,
            controls=(keyboard,),
        )
        assert keyboard.prompt() == HELP
    assert session.runner.phase is Phase.DONE
    assert session.runner.reason == "stopped by the operator"
