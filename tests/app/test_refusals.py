"""What a vehicle that cannot fly is told of: its own words, what arrives of it, and nobody else's fault."""

from __future__ import annotations

from dataclasses import replace

import pytest

from groundstation.mission.runner import Phase
from sitl.faults import Fault
from tests.app.flights import SECOND_NS, Flight, pair


def _refused(flight: Flight) -> str:
    """The reason of a flight that has ended with nothing armed."""
    assert flight.runner.outcome == "refused"
    assert not flight.world.truth.armed.any()
    assert Phase.ARM not in flight.phase_seen
    return flight.runner.reason


def _never_armed(vehicle: int) -> Fault:
    return Fault("arming_refused", at_s=0.0, vehicles=(vehicle,))


def test_a_vehicle_whose_own_checks_fail_for_good_is_refused_in_its_own_words() -> None:
    flight = Flight(
        pair("limits.preflight_s=25"), change=lambda world: replace(world, faults=(_never_armed(2),))
    )
    assert _refused(flight) == (
        "vehicle 2: not ready to arm: it says: PreArm: Compass not healthy; its own checks have to pass"
    )
    # Asked every ten seconds, not more often.
    assert 2 <= flight.texts("info").count("vehicle 2 says: PreArm: Compass not healthy") <= 3


def test_one_that_says_nothing_when_asked_is_told_to_give_no_reason() -> None:
    asked: list[int] = []

    def silent(flight: Flight) -> bool:
        def heard(_params: object, _frame: object) -> int:
            asked.append(flight.now_ns)
            return 0

        flight.world.autopilots[0].commands[401] = heard
        return False

    plan = pair("limits.preflight_s=25")
    flight = Flight(plan, change=lambda world: replace(world, faults=(_never_armed(1),)), interrupt_when=silent)
    assert _refused(flight).startswith("vehicle 1: not ready to arm, and gives no reason (it was asked); see what ")
    assert len(asked) == 2
    assert asked[1] - asked[0] >= 10 * SECOND_NS


def test_words_of_the_start_are_forgotten_when_a_vehicle_says_something_newer() -> None:
    flight = Flight(
        pair("limits.preflight_s=70", autopilots=("arducopter", "arducopter")),
        change=lambda world: replace(world, real_boot=True, faults=(_never_armed(2),)),
    )
    assert "EKF attitude" not in _refused(flight)
    assert "vehicle 2: not ready to arm: it says: PreArm: Compass not healthy" in flight.runner.reason
