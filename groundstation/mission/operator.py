"""What the operator may say, in one line of text, and in which phase it is obeyed.

The same line goes over the keyboard, the socket, the log and the replay. Reads lines and judges them; ``runner`` does
what they say. Refuses to guess: a line that is not understood, or that a phase does not allow, is refused in words.
"""

from __future__ import annotations

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


ORDERS_HELP = {
    Order.HOLD: "everyone stands still where they are until resume",
    Order.RESUME: "ends a hold",
    Order.RETURN: "everyone stops, flies back to the pads and lands",
    Order.LAND: "`land all` or `land 3 5`: lands here, when nobody is below",
    Order.KILL: "`kill all` or `kill 3 5`: motors stop at once, also in the air",
    Order.SILENCE: "setpoints stop; the autopilots' own failsafe acts",
}
_NAMES_VEHICLES = frozenset({Order.LAND, Order.KILL})
_ALL = "all"
_WORDS_SHOWN = 60


@dataclass(frozen=True)
class OperatorCommand:
    """One order.

    Attributes:
        order: what.
        vehicles: whom it concerns, rows counted from 0, rising; everybody where it says all or names nobody.
        everybody: it says ``all``, or is of a kind that concerns the whole team.
        text: the line in its plain form, for logs: ``kill 3 5``.
    """

    order: Order
    vehicles: tuple[int, ...]
    everybody: bool
    text: str


def parse_command(text: str, ids: Sequence[int]) -> OperatorCommand:
    """Reads a line.

    Args:
        text: ``hold``, ``resume``, ``return``, ``land all``, ``land 3``, ``kill all``, ``kill 3 5`` or ``silence``;
            capitals and spaces do not matter.
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
