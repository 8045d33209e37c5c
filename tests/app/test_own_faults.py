"""Faults of our own in any part of a tick: told, everybody comes back, and nobody is left in the air by them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from groundstation.mission.runner import Note, Phase, Runner
from tests.app.flights import Flight, after, pair

PARTS = (
    "_team.station.ingest", "_listen", "_team.frame.poses", "_team.landing.step", "_team.killing.step",
    "_team.station.transmit", "_lookout.measure",
)  # fmt: skip
TEXT = "fault in the ground station, FloatingPointError: made up"


def _break(runner: Runner, part: str, times: float) -> None:
    """Lets a part of the runner raise so many times, and then work again."""
    *path, name = part.split(".")
    owner: Any = runner
    for step in path:
        owner = getattr(owner, step)
    sound, left = getattr(owner, name), [times]

    def faulty(*given: object) -> object:
        left[0] -= 1
        if left[0] >= 0:
            raise FloatingPointError("made up")
        return sound(*given)

    setattr(owner, name, faulty)


def _broken(part: str, when: Callable[[Flight], bool], times: float = 1, *orders: str) -> Flight:
    """Flies two vehicles, with a part that fails from a moment on, and orders that are given right after."""
    done: list[bool] = []

    def look(flight: Flight) -> bool:
        if not done and when(flight):
            done.append(True)
            _break(flight.runner, part, times)
            for order in orders:
                flight.session.operator(order, flight.now_ns)
        return False

    plan = pair("failsafe.hold_s=10", autopilots=("px4", "px4"))
    flight = Flight(plan, interrupt_when=look, limit_s=400.0)
    assert flight.runner.outcome == "aborted"
    assert TEXT in flight.runner.reason
    assert Note("alarm", TEXT) in flight.notes
    assert flight.world.min_distance_airborne_m >= plan.spec.avoidance.radius_m
    return flight


@pytest.mark.parametrize("part", PARTS)
def test_a_part_that_fails_once_in_the_air_brings_everybody_home(part: str) -> None:
    flight = _broken(part, after(Phase.HOLD))
    assert flight.phase_seen[-3:] == [Phase.RETURN, Phase.LAND, Phase.DONE]
    truth = flight.world.truth
    assert not truth.armed.any()
    off_m = np.linalg.norm(truth.pos_enu_m[:, :2] - flight.plan.pads_enu_m[:, :2], axis=1)
    assert off_m.max() < 1.0


@pytest.mark.parametrize("phase", [Phase.FORM, Phase.LAND])
def test_where_poses_cannot_be_worked_out_any_more_the_autopilots_failsafe_takes_over(phase: Phase) -> None:
    flight = _broken("_team.frame.poses", after(phase), np.inf, "hold", "land all")
    assert flight.phase_seen[-2:] == [Phase.SILENT, Phase.DONE]
    assert "setpoints end, the autopilots' own failsafe takes over" in flight.runner.reason
    refused = [text for text in flight.texts("alarm") if text.endswith("cannot be worked out at the moment")]
    assert len(refused) == (2 if phase is Phase.FORM else 0)
    assert not flight.world.truth.armed.any()


@pytest.mark.parametrize(
    ("phase", "part"), [(Phase.CONNECT, "_machine.state.step"), (Phase.ARM, "_machine.state.step")]
)
def test_a_fault_before_takeoff_ends_the_mission_with_nobody_armed(phase: Phase, part: str) -> None:
    flight = _broken(part, after(phase))
    assert Phase.TAKEOFF not in flight.phase_seen
    assert not flight.world.truth.armed.any()


def test_a_setpoint_that_is_no_number_is_never_sent() -> None:
    sent: list[int] = []

    def spoil(flight: Flight) -> bool:
        if flight.runner.phase is Phase.HOLD and not sent:
            flight.runner._team.stance.yaw_ned_rad = np.array([np.nan, 0.0])  # whatever may have made it so
            sent.append(flight.runner.setpoints_sent)
        elif len(sent) == 1:
            sent.append(flight.runner.setpoints_sent)
            flight.runner._team.stance.yaw_ned_rad = np.zeros(2)
        return False

    flight = Flight(pair(autopilots=("px4", "px4")), interrupt_when=spoil)
    assert sent[0] == sent[1]
    assert flight.runner.reason.startswith("fault in the ground station, ValueError: ")
    assert not flight.world.truth.armed.any()
