"""Lines of the operator: what is understood, and what each phase makes of each order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.core.phases import Phase
from groundstation.mission.operator import Order, parse_command
from groundstation.mission.phases.table import REFUSED, refusal

IDS = [3, 5, 12]


@pytest.mark.parametrize(
    ("line", "order", "vehicles", "everybody", "text"),
    [
        ("hold", Order.HOLD, (0, 1, 2), True, "hold"),
        ("  RESUME ", Order.RESUME, (0, 1, 2), True, "resume"),
        ("return", Order.RETURN, (0, 1, 2), True, "return"),
        ("silence", Order.SILENCE, (0, 1, 2), True, "silence"),
        ("land all", Order.LAND, (0, 1, 2), True, "land all"),
        ("Land 5", Order.LAND, (1,), False, "land 5"),
        ("kill  12 3 12", Order.KILL, (0, 2), False, "kill 3 12"),
        ("kill all", Order.KILL, (0, 1, 2), True, "kill all"),
        ("kill 3 5 12", Order.KILL, (0, 1, 2), False, "kill 3 5 12"),
        ("move 1 -0.50 .25", Order.MOVE, (0, 1, 2), True, "move 1 -0.5 0.25"),
        ("TURN -45.0", Order.TURN, (0, 1, 2), True, "turn -45"),
        ("scale 1.20", Order.SCALE, (0, 1, 2), True, "scale 1.2"),
        ("stay", Order.STAY, (0, 1, 2), True, "stay"),
        ("next", Order.NEXT, (0, 1, 2), True, "next"),
    ],
)
def test_lines_are_understood(line: str, order: Order, vehicles: tuple[int, ...], everybody: bool, text: str) -> None:
    command = parse_command(line, IDS)
    assert (command.order, command.vehicles, command.everybody, command.text) == (order, vehicles, everybody, text)
    assert parse_command(command.text, IDS) == command


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", "operator command '' is none of hold, resume, return, land, kill, silence"),
        ("fly", "'fly' is none of hold"),
        ("kill", "say whom, `kill all` or for example `kill 3`"),
        ("land", "say whom, `land all` or for example `land 3`"),
        ("kill 4", "4 is no vehicle of this mission; those are 3, 5, 12"),
        ("kill all 3", "all is no vehicle"),
        ("kill 3 all", "all is no vehicle"),
        ("kill -3", "-3 is no vehicle"),
        ("kill 3.0", "3.0 is no vehicle"),
        ("kill ³", "³ is no vehicle"),
        ("land 00000000003", "00000000003 is no vehicle"),
        ("hold 3", "hold concerns everybody and takes nothing after it"),
        ("move 1 2", "move takes 3 numbers from -1000 to 1000, for example `move 1 0 0.5`"),
        ("move 1 2 3 4", "move takes 3 numbers"),
        ("move 1 2 nan", "move takes 3 numbers"),
        ("move 1 2 1e3", "move takes 3 numbers"),
        ("move 0 -0.0001 0", "asks for nothing; `stay` ends a move"),
        ("turn 361", "turn takes a number from -360 to 360, for example `turn 45`"),
        ("turn ٣", "turn takes a number"),
        ("turn", "turn takes a number"),
        ("scale 1", "asks for nothing"),
        ("scale 0.05", "scale takes a number from 0.1 to 10"),
        ("stay 3", "stay concerns everybody and takes nothing after it"),
        ("return all", "return concerns everybody"),
    ],
)
def test_what_is_not_understood_is_refused_in_words(line: str, words: str) -> None:
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - the words are looked at below
        parse_command(line, IDS)
    assert words in str(refused.value)


@given(st.text(max_size=300))
def test_any_text_is_an_order_or_a_short_message(line: str) -> None:
    try:
        command = parse_command(line, IDS)
    except ValueError as error:
        assert len(str(error)) < 800  # noqa: PT017
    else:
        assert parse_command(command.text, IDS) == command


@given(st.lists(st.floats(-1200, 1200), min_size=1, max_size=3), st.sampled_from(["move", "turn", "scale"]))
def test_what_is_obeyed_is_what_the_line_in_the_log_says(numbers: list[float], word: str) -> None:
    try:
        command = parse_command(f"{word} {' '.join(f'{number:.5f}' for number in numbers)}", IDS)
    except ValueError:
        return
    assert parse_command(command.text, IDS) == command
    np.testing.assert_allclose(command.numbers, numbers, atol=0.006)


@given(st.lists(st.sampled_from(["kill", "land", "hold", "all", "3", "5", "12", "250"]), max_size=5))
def test_nobody_is_killed_or_landed_who_was_not_named(words: list[str]) -> None:
    try:
        command = parse_command(" ".join(words), IDS)
    except ValueError:
        return
    if not command.everybody:
        assert {str(IDS[row]) for row in command.vehicles} == set(words[1:])
    elif command.order in (Order.KILL, Order.LAND):
        assert words[1:] == ["all"]


def test_every_phase_judges_every_order_and_killing_is_refused_only_when_all_is_over() -> None:
    assert set(REFUSED) == set(Phase)
    for phase in Phase:
        assert (refusal(phase, Order.KILL) is None) == (phase is not Phase.DONE)
        assert (refusal(phase, Order.RESUME) is None) == (phase is Phase.PAUSE)
