"""What people are told at the end: who is still in the air and what to do, and everybody that a fault has struck."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.app.verify import verify_log
from groundstation.mavlink.codec import Encoder, message_id
from groundstation.mission.reasons.blame import Blame
from groundstation.mission.runner import Phase
from groundstation.mission.verdict import Verdict
from sitl.faults import Fault
from sitl.world import Outgoing
from tests.app.flights import SECOND_NS, Flight, after, four, pair, still_in
from tests.app.test_preflight import PARAM_SET, Checked, _defaults, _without
from tests.app.test_take_over import _holds, _left_in_the_air
from tests.mavlink.sender import Sender

REMEDY = "take it over (gs fly --take-over) or fly it down"
LANDED = message_id("EXTENDED_SYS_STATE")


# Before arming


def test_a_team_in_the_air_is_never_told_to_be_disarmed() -> None:
    world = _left_in_the_air(pair(), still_in(Phase.HOLD, 0.5), prepare=_holds)
    flight = Flight(pair(), world=world)
    assert flight.runner.outcome == "refused"
    one, two = flight.runner.reason.split("; vehicle ")
    assert one.startswith("vehicle 1: is in the air, in AUTO.LOITER; ")
    assert two.startswith("2: is in the air, in GUIDED; ")
    assert one.endswith(REMEDY)
    assert two.endswith(REMEDY)
    assert "disarm" not in flight.runner.reason
    assert world.truth.airborne.all()
    assert flight.runner.setpoints_sent == 0


def test_one_that_does_not_tell_whether_it_flies_is_taken_for_one_that_does() -> None:
    world = _left_in_the_air(pair(), still_in(Phase.HOLD, 0.5), prepare=_holds)
    flight = Flight(pair(), world=world, tamper=_without(LANDED))
    assert "vehicle 1: is armed, in AUTO.LOITER, and may be in the air; take it over" in flight.runner.reason
    assert "disarm" not in flight.runner.reason


def test_one_that_is_armed_on_the_ground_is_to_be_disarmed_and_the_other_counts_as_not_checked() -> None:
    checked = Checked(pair("failsafe.set_parameters=true"), prepare=lambda world: world.autopilots[0].arm())
    assert checked.runner.reason == "vehicle 1: is armed already; disarm it before the mission"
    rows = checked.runner.check_rows()
    assert [(row.ready, row.checked, bool(row.problems)) for row in rows] == [
        (False, False, True),
        (False, False, False),
    ]
    assert PARAM_SET not in checked.sent


# When it is over


def _pilot_holds(flight: Flight, told: list[int]) -> bool:
    """A pilot takes vehicle 1 into Hold and leaves it there."""
    if flight.runner.phase is Phase.HOLD and not told:
        told.append(flight.now_ns)
        hold = Encoder(254, 1).encode(
            "COMMAND_LONG", target_system=1, target_component=1, command=176, param1=1.0, param2=4.0, param3=3.0
        )
        flight.world.receive(0, hold, flight.now_ns)
    return False


def test_a_released_vehicle_that_flies_on_is_named_when_the_mission_ends(tmp_path: Path) -> None:
    told: list[int] = []
    log = tmp_path / "flight.tlog"
    flight = Flight(pair(), interrupt_when=lambda flight: _pilot_holds(flight, told), log=log)
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason == (
        "vehicle 1: left for mode AUTO.LOITER; it is released and not fought over, the others come back;"
        f" vehicle 1 is still in the air, in AUTO.LOITER; {REMEDY}"
    )
    assert flight.world.truth.airborne.tolist() == [True, False]
    assert verify_log(log).mismatches == 0


def test_a_released_vehicle_whose_state_is_not_known_is_named_too() -> None:
    told: list[int] = []
    landed = _without(LANDED)

    def mute(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if not told or datagram.vehicle_index != 0:
            return [datagram]
        silent = flight.now_ns > told[0] + 4 * SECOND_NS
        return [] if silent else landed(datagram, flight)

    flight = Flight(pair(), interrupt_when=lambda flight: _pilot_holds(flight, told), tamper=mute)
    assert flight.runner.reason == (
        "vehicle 1: left for mode AUTO.LOITER; it is released and not fought over, the others come back;"
        f" vehicle 1 may still be in the air, in AUTO.LOITER when last told; {REMEDY}"
    )


@pytest.mark.parametrize("kind", ["reboot", "position_frozen", "blackout"])
def test_everybody_that_a_fault_strikes_at_once_is_in_the_reason(kind: str) -> None:
    struck: list[int] = []

    def strike(flight: Flight) -> bool:
        if flight.runner.phase is Phase.HOLD and not struck:
            struck.append(flight.now_ns)
            flight.world.inject(Fault(kind))
        return False

    flight = Flight(pair(autopilots=("px4", "px4")), interrupt_when=strike, limit_s=400.0)
    first = [part for part in flight.runner.reason.split("; ") if part.startswith(("vehicle 1: ", "vehicle 2: "))]
    assert {part[:9] for part in first} == {"vehicle 1", "vehicle 2"}, flight.runner.reason
    assert "come back" not in flight.runner.reason, flight.runner.reason


def test_of_one_that_has_fallen_down_nobody_says_that_it_is_going_to_land() -> None:
    """It was "has hit the ground at 5.0 m/s ...; it lands where it is when nobody is below"."""
    other, holds, said = Sender(250, 190), after(Phase.HOLD, 0.5), list[int]()

    def stop_in_the_air(flight: Flight) -> bool:
        if holds(flight) and not said:
            said.append(flight.now_ns)
            stop = dialect.MAVLink_command_long_message(1, 1, 400, 0, 0, 21196, 0, 0, 0, 0, 0)  # disarm, by force
            flight.world.receive(0, other.raw(stop), flight.world.now_ns)
        return False

    flight = Flight(four(), interrupt_when=stop_in_the_air)
    (hit,) = [text for text in flight.texts("alarm") if text.startswith("vehicle 1: has hit the ground at ")]
    assert hit.endswith("before it flies again; it stays where it lies, the others come back")
    assert "it lands where it is" not in flight.runner.reason


def test_of_many_the_first_few_are_told_in_full_and_the_others_by_number() -> None:
    blame = Blame()
    aborts = {f"vehicle {k}": f"vehicle {k}: is gone" for k in range(1, 8)}
    reason = blame.of({"vehicle 1": aborts["vehicle 1"]}, "")
    assert reason == "vehicle 1: is gone"
    assert blame.of(aborts, reason) == (
        "vehicle 2: is gone; vehicle 3: is gone; vehicle 4: is gone; vehicles 5, 6, 7 too, see the alarms"
    )
    assert blame.of(aborts, reason) == ""
    assert Blame().of({"vehicle 3": "vehicle 3: low"}, "vehicle 3: landed by the operator; vehicle 30: x") == ""


def test_findings_that_are_only_counted_are_counted_once() -> None:
    """It was "3 more findings too, see the alarms; 1 more finding too, see the alarms"."""
    blame, verdict = Blame(), Verdict()
    ticks = (
        {f"vehicle {k}": f"vehicle {k}: is gone" for k in range(1, 6)},
        {"link a": "link a: is silent", "link b": "link b: is silent"},
        {"vehicle 9": "vehicle 9: is gone"},
    )
    for aborts in ticks:
        verdict.abort(blame.of(aborts, verdict.reason), instead_of=blame.outdated)
        verdict.abort("stands still")  # others add theirs
    assert verdict.reason == (
        "vehicle 1: is gone; vehicle 2: is gone; vehicle 3: is gone; vehicle 4: is gone; stands still;"
        " vehicles 5, 9 and 2 more findings too, see the alarms"
    )


# A check sets nothing unless it is told to


def test_a_check_tells_what_the_flight_will_set_and_sets_nothing() -> None:
    plan = pair("failsafe.set_parameters=true")
    checked = Checked(plan, change=_defaults, look_only=True)
    assert (checked.runner.outcome, PARAM_SET in checked.sent) == ("completed", False)
    rows = checked.runner.check_rows()
    assert all(row.ready and row.failsafe.endswith(" to be set") for row in rows)
    (told,) = (note for note in rows[0].notes if note.startswith("to be set before arming, by `gs fly`"))
    assert "NAV_DLL_ACT from 0 to 3" in told
    fixed = Checked(plan, change=_defaults)
    assert fixed.sent[PARAM_SET] > 5


def test_a_check_refuses_what_no_flight_would_set() -> None:
    checked = Checked(pair("limits.preflight_s=12"), change=_defaults, look_only=True)
    assert checked.runner.outcome == "refused"
    assert "`gs check --fix` sets" in checked.runner.reason
    assert PARAM_SET not in checked.sent
