"""What the operator may say, in one line of text, and in which phase it is obeyed.

The same line goes over the keyboard, the socket, the log and the replay. Reads lines and judges them; ``runner`` does
what they say. Refuses to guess: a line that is not understood, or that a phase does not allow, is refused in words.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from groundstation.core.choices import nearest


class Order(Enum):
    """What can be ordered."""

    HOLD = "hold"
    RESUME = "resume"
    RETURN = "return"
    LAND = "land"
    KILL = "kill"
    SILENCE = "silence"
    MOVE = "move"
    TURN = "turn"
    SCALE = "scale"
    STAY = "stay"
    NEXT = "next"
    START = "start"
    FIX = "fix"


ORDERS_HELP = {
    Order.HOLD: "everyone stands still where they are until resume",
    Order.RESUME: "ends a hold",
    Order.RETURN: "everyone stops, flies back to the pads and lands",
    Order.LAND: "`land all` or `land 3 5`: lands here, when nobody is below",
    Order.KILL: "`kill all` or `kill 3 5`: motors stop at once, also in the air",
    Order.SILENCE: "setpoints stop; the autopilots' own failsafe acts",
    Order.MOVE: "in a lead step, `move 1 0 0.5`: the formation goes so far east, north and up, in metres",
    Order.TURN: "in a lead step, `turn 45`: degrees about the vertical, counterclockwise seen from above",
    Order.SCALE: "in a lead step, `scale 1.2`: multiplies all distances",
    Order.STAY: "in a lead step: the move under way comes to rest, those that wait are dropped",
    Order.NEXT: "in a lead step: ends it, the mission goes on",
    Order.START: "a team that waits on its pads (`gs fly --wait`) takes off, when preflight is through",
    Order.FIX: "on the ground: parameters that are not as the mission needs them are set, as by `--fix`",
}
LEADING = frozenset({Order.MOVE, Order.TURN, Order.SCALE, Order.STAY, Order.NEXT})
"""What leads the formation, in a step of the mission that is made for it."""
PREPARING = frozenset({Order.START, Order.FIX})
"""What is said before anybody is armed."""
_NAMES_VEHICLES = frozenset({Order.LAND, Order.KILL})
_ALL = "all"


@dataclass(frozen=True)
class _Numbers:
    """What an order takes after it: how many numbers, between which bounds, with how many decimals, and an example."""

    count: int
    least: float
    most: float
    decimals: int
    example: str
    nothing: float

    @property
    def words(self) -> str:
        """For people."""
        many = "a number" if self.count == 1 else f"{self.count} numbers"
        return f"{many} from {self.least:g} to {self.most:g}, for example `{self.example}`"


_TAKES_NUMBERS = {
    Order.MOVE: _Numbers(3, -1_000.0, 1_000.0, 3, "move 1 0 0.5", 0.0),
    Order.TURN: _Numbers(1, -360.0, 360.0, 2, "turn 45", 0.0),
    Order.SCALE: _Numbers(1, 0.1, 10.0, 4, "scale 1.2", 1.0),
}
_NUMBER = re.compile(r"[+-]?(\d{1,6}(\.\d{0,9})?|\.\d{1,9})", re.ASCII)
_WORDS_SHOWN = 60


@dataclass(frozen=True)
class OperatorCommand:
    """One order.

    Attributes:
        order: what.
        vehicles: whom it concerns, rows counted from 0, rising; everybody where it says all or names nobody.
        everybody: it says ``all``, or is of a kind that concerns the whole team.
        text: the line in its plain form, for logs: ``kill 3 5``.
        numbers: what follows ``move`` (metres east, north, up), ``turn`` (degrees) or ``scale``; empty for all others.
    """

    order: Order
    vehicles: tuple[int, ...]
    everybody: bool
    text: str
    numbers: tuple[float, ...] = ()


def parse_command(text: str, ids: Sequence[int]) -> OperatorCommand:
    """Reads a line.

    Args:
        text: ``hold``, ``resume``, ``return``, ``land all``, ``land 3``, ``kill all``, ``kill 3 5``, ``silence``,
            ``move 1 0 0.5``, ``turn 45``, ``scale 1.2``, ``stay``, ``next``, ``start`` or ``fix``; capitals and spaces
            do not matter.
        ids: system ids of the mission's vehicles, in the order of the rows.

    Raises:
        ValueError: in words for people: what was wrong and what can be said instead.
    """
    words = text.lower().split()
    shown = " ".join(words)[:_WORDS_SHOWN]
    names = [order.value for order in Order]
    if not words or words[0] not in names:
        near = nearest(words[0], names) if words else ""
        meant = f"; did you mean {near}?" if near else ""
        raise ValueError(f"operator command {shown!r} is none of {', '.join(names)}{meant}")
    order, rest = Order(words[0]), words[1:]
    everybody = tuple(range(len(ids)))
    if order in _TAKES_NUMBERS:
        numbers, text = _numbers(order, rest, shown)
        return OperatorCommand(order, everybody, True, text, numbers)
    if order not in _NAMES_VEHICLES:
        if rest:
            raise ValueError(f"operator command {shown!r}: {order.value} concerns everybody and takes nothing after it")
        return OperatorCommand(order, everybody, True, order.value)
    if not rest:
        raise ValueError(
            f"operator command {shown!r}: say whom, `{order.value} all` or for example `{order.value} {ids[0]}`"
        )
    if rest == [_ALL]:
        return OperatorCommand(order, everybody, True, f"{order.value} {_ALL}")
    row_of_id = {int(sysid): row for row, sysid in enumerate(ids)}
    rows = set()
    for word in rest:
        number = int(word) if word.isascii() and word.isdigit() and len(word) <= 3 else None
        if number not in row_of_id:
            known = ", ".join(str(sysid) for sysid in row_of_id)
            raise ValueError(f"operator command {shown!r}: {word} is no vehicle of this mission; those are {known}")
        rows.add(row_of_id[number])
    vehicles = tuple(sorted(rows))
    text = f"{order.value} {' '.join(str(ids[row]) for row in vehicles)}"
    return OperatorCommand(order, vehicles, False, text)


def _numbers(order: Order, words: Sequence[str], shown: str) -> tuple[tuple[float, ...], str]:
    """The numbers after an order, rounded as they are written, and the order in its plain form.

    Raises:
        ValueError: they are none, too many or too few, out of bounds, or ask for nothing.
    """
    takes = _TAKES_NUMBERS[order]
    numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
    if len(words) != takes.count or len(numbers) != takes.count:
        raise ValueError(f"operator command {shown!r}: {order.value} takes {takes.words}")
    written = [f"{number:.{takes.decimals}f}".rstrip("0").rstrip(".") for number in numbers]
    written = ["0" if number == "-0" else number for number in written]
    numbers = [float(number) for number in written]
    if not all(takes.least <= number <= takes.most for number in numbers):
        raise ValueError(f"operator command {shown!r}: {order.value} takes {takes.words}")
    if all(number == takes.nothing for number in numbers):
        raise ValueError(f"operator command {shown!r}: asks for nothing; `stay` ends a move")
    return tuple(numbers), f"{order.value} {' '.join(written)}"
