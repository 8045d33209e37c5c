"""What leads from phase to phase: every pair of a phase and an event, one by one, and the page drawn from it."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.phases import AIRBORNE_PHASES, Phase
from groundstation.mission.operator import Order
from groundstation.mission.phases.machine import Machine
from groundstation.mission.phases.state import Entry
from groundstation.mission.phases.table import EVENT_OF_ORDER, REFUSED, TABLE, Afterwards, Answer, Event, page
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.team import Team

PAGE = Path(__file__).parents[2] / "docs" / "phases.md"
# . for no change, - for what cannot come about (orders are refused), (x) for what follows when the hold is over,
# = for what was held. Columns are the events in their order.
EXPECTED = """
         READY CHECKED REFUSED TAKEN  ARMED   FORM HOLD MOVE LEAD DONE   WITHOUT GIVE_UP  NOW    FAULT    STOOD  BACK NOBODY DOWN hold  resume return land lead prep kill   silence
CONNECT  ARM   DONE    DONE    -      -       -    -    -    -    -      -       DONE     DONE   DONE     -      -    -      -    DONE  -      DONE   DONE -    .    SILENT SILENT
TAKEOVER -     -       DONE    RETURN -       -    -    -    -    -      -       .        .      SILENT   -      -    -      -    -     -      -      -    -    -    SILENT SILENT
ARM      -     -       -       -      TAKEOFF -    -    -    -    -      -       LAND     LAND   LAND     -      -    -      -    LAND  -      LAND   LAND -    -    SILENT SILENT
TAKEOFF  -     -       -       -      -       FORM HOLD MOVE -    -      -       RETURN   RETURN RETURN   -      -    -      -    PAUSE -      STOP   LAND -    -    SILENT SILENT
FORM     -     -       -       -      -       FORM HOLD MOVE LEAD RETURN FORM    RETURN   RETURN RETURN   -      -    -      -    PAUSE -      STOP   LAND -    -    SILENT SILENT
HOLD     -     -       -       -      -       FORM HOLD MOVE LEAD RETURN FORM    RETURN   RETURN RETURN   -      -    -      -    PAUSE -      STOP   LAND -    -    SILENT SILENT
MOVE     -     -       -       -      -       FORM HOLD MOVE LEAD RETURN FORM    RETURN   RETURN RETURN   -      -    -      -    PAUSE -      STOP   LAND -    -    SILENT SILENT
LEAD     -     -       -       -      -       FORM HOLD MOVE LEAD RETURN FORM    RETURN   RETURN RETURN   -      -    -      -    PAUSE -      STOP   LAND .    -    SILENT SILENT
STOP     -     -       -       -      -       -    -    -    -    -      -       .        .      .        RETURN -    -      -    PAUSE -      .      LAND -    -    SILENT SILENT
PAUSE    -     -       -       -      -       -    -    -    -    -      (FORM)  (RETURN) RETURN (RETURN) -      -    LAND   -    -     =      RETURN LAND -    -    SILENT SILENT
RETURN   -     -       -       -      -       -    -    -    -    -      -       .        .      .        -      LAND -      -    PAUSE -      .      LAND -    -    SILENT SILENT
LAND     -     -       -       -      -       -    -    -    -    -      -       .        .      .        -      -    -      DONE -     -      .      -    -    -    SILENT SILENT
SILENT   -     -       -       -      -       -    -    -    -    -      -       .        .      .        -      -    -      DONE -     -      -      .    -    -    .      -
DONE     -     -       -       -      -       -    -    -    -    -      -       .        .      .        -      -    -      -    -     -      -      -    -    -    -      -
"""  # noqa: E501 - a table
ROWS = {Phase[line.split()[0]]: line.split()[1:] for line in EXPECTED.strip().splitlines()[1:]}
PAIRS = [(phase, event) for phase in Phase for event in Event]


@pytest.mark.parametrize(("phase", "event"), PAIRS, ids=[f"{phase.name}-{event.name}" for phase, event in PAIRS])
def test_what_an_event_leads_to_in_a_phase(phase: Phase, event: Event) -> None:
    word = ROWS[phase][list(Event).index(event)]
    special = {".": Answer.STAY, "-": Answer.NEVER, "=": Answer.RESUME}
    expected = special.get(word) or (Afterwards(Phase[word[1:-1]]) if word.startswith("(") else Phase[word])
    assert TABLE[phase][event] == expected


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("order", Order)
def test_an_order_is_refused_where_it_cannot_come_about_and_nowhere_else(phase: Phase, order: Order) -> None:
    assert (order in REFUSED[phase]) == (TABLE[phase][EVENT_OF_ORDER[order]] is Answer.NEVER)


def test_setpoints_end_from_every_phase_in_the_air_and_a_fault_is_answered_in_every_phase() -> None:
    for phase in Phase:
        assert TABLE[phase][Event.FAULT] is not Answer.NEVER
        if phase in AIRBORNE_PHASES:
            assert TABLE[phase][Event.SILENCE] is TABLE[phase][Event.KILL_ALL] is Phase.SILENT


def test_what_cannot_come_about_is_a_fault_and_changes_nothing() -> None:
    plan = load_mission(packaged_configs() / "missions" / "first_flight2.yaml")
    machine = Machine(Team(plan, 0), 0)
    with pytest.raises(RuntimeError, match="everybody is back: that cannot come about in phase connect"):
        machine.happen(Event.BACK, 1)
    assert machine.phase is Phase.CONNECT
    first = machine.state
    machine.happen(Event.READY, 2)
    assert (machine.phase, machine.state.since_ns) == (Phase.ARM, 2)
    assert machine.state is not first


def test_a_hold_gives_back_the_very_phase_that_it_held_unless_something_else_has_to_follow() -> None:
    plan = load_mission(packaged_configs() / "missions" / "first_flight2.yaml")
    team = Team(plan, 0)
    poses = team.frame.poses(team.fleet, 0)
    for instead in (False, True):
        machine = Machine(team, 0)
        for event in (Event.READY, Event.ARMED, Event.NEXT_FORM):
            machine.happen(event, 10)
        held = machine.state
        machine.happen(Event.ORDER_HOLD, 30, poses)
        assert machine.phase is Phase.PAUSE
        if instead:
            machine.happen(Event.GIVE_UP, 40)
            assert machine.phase is Phase.PAUSE
        machine.happen(Event.ORDER_RESUME, 50)
        if instead:
            assert (machine.phase, machine.state.since_ns) == (Phase.RETURN, 50)
        else:
            assert machine.state is held
            assert held.since_ns == 10 + 20  # its clock stood still


def test_no_mission_begins_with_a_hold() -> None:
    plan = load_mission(packaged_configs() / "missions" / "first_flight2.yaml")
    team = Team(plan, 0)
    from groundstation.mission.phases.stand import PausePhase

    with pytest.raises(ValueError, match="follows an order"):
        PausePhase(team, Entry(0))


def test_the_page_is_drawn_from_the_table() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run `make docs`"
