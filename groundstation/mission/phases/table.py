"""The phases of a mission: what each event leads to in each of them, and what the operator is refused there.

Complete: every pair of a phase and an event has an answer. docs/phases.md is drawn from this table.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from groundstation.core.phases import Phase
from groundstation.mission.operator import LEADING, PREPARING, Order


class Event(Enum):
    """What may lead from one phase to another."""

    READY = "everybody is ready"
    CHECKED = "everything was checked, and nothing shall be armed"
    REFUSED = "refused"
    TAKEN = "taken over"
    ARMED = "everybody is armed"
    NEXT_FORM = "a form step is next"
    NEXT_HOLD = "a hold step is next"
    NEXT_MOVE = "a move step is next"
    NEXT_LEAD = "a lead step is next"
    STEPS_DONE = "all steps are done"
    GO_ON_WITHOUT = "somebody drops out, the others go on"
    GIVE_UP = "the mission is given up"
    GIVE_UP_NOW = "given up, even out of a hold"
    FAULT = "fault of our own"
    STOOD = "stood still for a moment"
    BACK = "everybody is back"
    NOBODY_LEFT = "nobody is left to be held"
    DOWN = "everybody is down"
    ORDER_HOLD = "hold"
    ORDER_RESUME = "resume"
    ORDER_RETURN = "return"
    ORDER_LAND = "land all"
    ORDER_LEAD = "move, turn, scale, stay, next"
    ORDER_PREPARE = "start, fix"
    KILL_ALL = "kill all"
    SILENCE = "setpoints end"


NEXT = {
    Phase.FORM: Event.NEXT_FORM,
    Phase.HOLD: Event.NEXT_HOLD,
    Phase.MOVE: Event.NEXT_MOVE,
    Phase.LEAD: Event.NEXT_LEAD,
    Phase.RETURN: Event.STEPS_DONE,
}
"""What it is called that the mission goes on with a phase."""


class Answer(Enum):
    """An answer of the table that is no phase."""

    STAY = "stays"
    """Nothing changes."""
    NEVER = "never"
    """Cannot come about; an order is refused."""
    RESUME = "resumes"
    """Back to what was held, or to what follows instead."""


@dataclass(frozen=True)
class Afterwards:
    """The hold goes on; this phase follows when it is over."""

    phase: Phase


Next = Phase | Answer | Afterwards
_STAY = Answer.STAY

_ALWAYS: dict[Event, Next] = {Event.KILL_ALL: Phase.SILENT, Event.SILENCE: Phase.SILENT}
_ON_THE_GROUND: dict[Event, Next] = _ALWAYS | dict.fromkeys(
    (Event.GIVE_UP, Event.GIVE_UP_NOW, Event.FAULT, Event.ORDER_HOLD, Event.ORDER_RETURN, Event.ORDER_LAND), Phase.DONE
)
_UP: dict[Event, Next] = _ALWAYS | {
    Event.GIVE_UP: Phase.RETURN,
    Event.GIVE_UP_NOW: Phase.RETURN,
    Event.FAULT: Phase.RETURN,
    Event.ORDER_HOLD: Phase.PAUSE,
    Event.ORDER_RETURN: Phase.STOP,
    Event.ORDER_LAND: Phase.LAND,
}
_STEP: dict[Event, Next] = _UP | {event: phase for phase, event in NEXT.items()} | {Event.GO_ON_WITHOUT: Phase.FORM}
_COMING_BACK: dict[Event, Next] = _UP | dict.fromkeys(
    (Event.GIVE_UP, Event.GIVE_UP_NOW, Event.FAULT, Event.ORDER_RETURN), _STAY
)
_ENDING: dict[Event, Next] = dict.fromkeys((Event.GIVE_UP, Event.GIVE_UP_NOW, Event.FAULT), _STAY)

_ROWS: dict[Phase, dict[Event, Next]] = {
    Phase.CONNECT: _ON_THE_GROUND
    | {
        Event.READY: Phase.ARM,
        Event.CHECKED: Phase.DONE,
        Event.REFUSED: Phase.DONE,
        Event.ORDER_PREPARE: _STAY,
    },
    Phase.TAKEOVER: _ALWAYS
    | {
        Event.TAKEN: Phase.RETURN,
        Event.REFUSED: Phase.DONE,
        Event.GIVE_UP: _STAY,
        Event.GIVE_UP_NOW: _STAY,
        Event.FAULT: Phase.SILENT,
    },
    Phase.ARM: dict.fromkeys(_ON_THE_GROUND, Phase.LAND) | _ALWAYS | {Event.ARMED: Phase.TAKEOFF},
    Phase.TAKEOFF: _UP | {Event.NEXT_FORM: Phase.FORM, Event.NEXT_HOLD: Phase.HOLD, Event.NEXT_MOVE: Phase.MOVE},
    Phase.FORM: _STEP,
    Phase.HOLD: _STEP,
    Phase.MOVE: _STEP,
    Phase.LEAD: _STEP | {Event.ORDER_LEAD: _STAY},
    Phase.STOP: _COMING_BACK | {Event.STOOD: Phase.RETURN},
    Phase.PAUSE: _ALWAYS
    | {
        Event.ORDER_RESUME: Answer.RESUME,
        Event.GO_ON_WITHOUT: Afterwards(Phase.FORM),
        # A hold is the operator's: whatever stands below may be why. The team comes back when it is over.
        Event.GIVE_UP: Afterwards(Phase.RETURN),
        Event.FAULT: Afterwards(Phase.RETURN),
        Event.GIVE_UP_NOW: Phase.RETURN,
        Event.ORDER_RETURN: Phase.RETURN,
        Event.ORDER_LAND: Phase.LAND,
        Event.NOBODY_LEFT: Phase.LAND,
    },
    Phase.RETURN: _COMING_BACK | {Event.BACK: Phase.LAND},
    Phase.LAND: _ALWAYS | _ENDING | {Event.DOWN: Phase.DONE, Event.ORDER_RETURN: _STAY},
    Phase.SILENT: _ENDING | {Event.DOWN: Phase.DONE, Event.ORDER_LAND: _STAY, Event.KILL_ALL: _STAY},
    Phase.DONE: _ENDING,
}
TABLE: dict[Phase, dict[Event, Next]] = {
    phase: {event: _ROWS[phase].get(event, Answer.NEVER) for event in Event} for phase in Phase
}
"""What each event leads to in each phase."""

_NOTHING_HELD = "nothing is held"
_OVER = "the mission is over"
_SILENT = "setpoints have ended; `land` and `kill` are what is left"
_NOT_LED: dict[Order, str] = dict.fromkeys(LEADING, "the team is led in a `lead` step of the mission only")
_STARTED: dict[Order, str] = dict.fromkeys(PREPARING, "that is for a team that waits on its pads")
_WAITING: dict[Order, str] = {Order.RESUME: _NOTHING_HELD} | _NOT_LED
_FLYING: dict[Order, str] = _WAITING | _STARTED
REFUSED: dict[Phase, dict[Order, str]] = {
    # On the ground hold, return and land do the same: nobody takes off, the mission ends with nobody armed.
    Phase.CONNECT: _WAITING,
    Phase.TAKEOVER: _NOT_LED
    | _STARTED
    | {
        Order.HOLD: "everybody who is held stands still already",
        Order.RESUME: _NOTHING_HELD,
        Order.RETURN: "that comes next",
        Order.LAND: "where they are is being found out; they are brought home next",
    },
    Phase.ARM: _FLYING,
    Phase.TAKEOFF: _FLYING,
    Phase.FORM: _FLYING,
    Phase.HOLD: _FLYING,
    Phase.MOVE: _FLYING,
    Phase.LEAD: {Order.RESUME: _NOTHING_HELD} | _STARTED,
    Phase.STOP: _FLYING,
    Phase.RETURN: _FLYING,
    Phase.PAUSE: {Order.HOLD: "it is held already; `resume` goes on"}
    | dict.fromkeys(LEADING, "the team is held; `resume` first")
    | _STARTED,
    Phase.LAND: _NOT_LED
    | _STARTED
    | {
        Order.HOLD: "landing is the autopilots' own and cannot be held",
        Order.RESUME: _NOTHING_HELD,
        Order.LAND: "the team is landing already",
    },
    Phase.SILENT: dict.fromkeys(LEADING, _SILENT)
    | _STARTED
    | {
        Order.HOLD: _SILENT,
        Order.RESUME: _SILENT,
        Order.RETURN: _SILENT,
        Order.SILENCE: "setpoints have ended already",
    },
    Phase.DONE: dict.fromkeys(Order, _OVER),
}
"""Why an order is refused in a phase; what is not listed is obeyed."""
EVENT_OF_ORDER: dict[Order, Event] = (
    {
        Order.HOLD: Event.ORDER_HOLD,
        Order.RESUME: Event.ORDER_RESUME,
        Order.RETURN: Event.ORDER_RETURN,
        Order.LAND: Event.ORDER_LAND,
        Order.KILL: Event.KILL_ALL,
        Order.SILENCE: Event.SILENCE,
    }
    | dict.fromkeys(LEADING, Event.ORDER_LEAD)
    | dict.fromkeys(PREPARING, Event.ORDER_PREPARE)
)
"""What an order that concerns everybody comes to."""


def refusal(phase: Phase, order: Order) -> str | None:
    """Why an order is refused in a phase, None when it is obeyed."""
    return REFUSED[phase].get(order)


def page() -> str:
    """docs/phases.md, which ``make docs`` writes."""
    return (
        "# The phases of a mission\n\n"
        "Written by `make docs` from the table in groundstation/mission/phases/table.py: do not edit.\n\n"
        f"```mermaid\n{diagram()}\n```\n\n"
        "What each event leads to, in each phase. Where a cell is empty the event cannot come about there; orders are"
        f" refused.\n\n{matrix()}\n"
    )


def diagram() -> str:
    """The table as a Mermaid state diagram: arrows from phase to phase, with what leads along them."""
    lines = ["stateDiagram-v2", "    [*] --> connect", "    [*] --> takeover"]
    for phase, row in TABLE.items():
        ways: dict[str, list[str]] = {}
        for event, follows in row.items():
            if isinstance(follows, Phase):
                ways.setdefault(_name(follows), []).append(event.value)
            elif isinstance(follows, Afterwards):
                ways.setdefault(_name(follows.phase), []).append(f"({event.value}, when the hold is over)")
        lines += [f"    {_name(phase)} --> {to}: {', '.join(words)}" for to, words in ways.items()]
        if Answer.RESUME in row.values():
            lines.append(f"    note right of {_name(phase)}: resume leads back to what was held")
    return "\n".join([*lines, "    done --> [*]"])


def matrix() -> str:
    """The table as a Markdown table: phases down, events across."""
    words: dict[Answer, str] = {Answer.STAY: "stays", Answer.NEVER: "", Answer.RESUME: "what was held"}
    lines = [f"| in | {' | '.join(event.value for event in Event)} |", "| --- " * (len(Event) + 1) + "|"]
    for phase, row in TABLE.items():
        cells = []
        for follows in row.values():
            if isinstance(follows, Answer):
                cells.append(words[follows])
            else:
                cells.append(f"then {follows.phase.value}" if isinstance(follows, Afterwards) else follows.value)
        lines.append(f"| {phase.value} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _name(phase: Phase) -> str:
    return phase.value.replace("-", "")
