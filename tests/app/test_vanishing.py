"""The ground station is gone, from one moment to the next: vehicles keep apart until all of them are down."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.mission.runner import Phase
from sitl.personalities.px4.params import px4_params
from tests.app.flights import Flight, after, cube8, mission, pair
from tests.app.vanishing import Vanished


def _assert_safe(vanished: Vanished) -> None:
    plan, world = vanished.flight.plan, vanished.flight.world
    assert vanished.min_distance_m >= plan.spec.avoidance.radius_m
    assert vanished.down_s <= vanished.flight.runner.failsafe.down_s
    off_pad = np.linalg.norm(world.truth.pos_enu_m[:, :2] - plan.pads_enu_m[:, :2], axis=1)
    assert off_pad.max() < 0.3 + plan.margin_m


@pytest.mark.parametrize(
    ("phase", "seconds"), [(Phase.TAKEOFF, 3.2), (Phase.FORM, 1.5), (Phase.HOLD, 2.0), (Phase.RETURN, 1.5)]
)
def test_a_cube_of_two_layers_comes_home_one_by_one(phase: Phase, seconds: float) -> None:
    vanished = Vanished(cube8(), after(phase, seconds))
    _assert_safe(vanished)
    assert all(modes[:3] == ["OFFBOARD", "AUTO.LOITER", "AUTO.RTL"] for modes in vanished.modes)
    assert vanished.held_m < 0.05


def test_both_autopilots_in_one_cube_come_home_one_by_one() -> None:
    vanished = Vanished(mission("mixed8"), after(Phase.HOLD, 1.0))
    _assert_safe(vanished)
    assert [modes[0] for modes in vanished.modes] == ["OFFBOARD"] * 4 + ["GUIDED"] * 4
    assert all("AUTO.RTL" in modes or modes[-1] == "RTL" for modes in vanished.modes)


@pytest.mark.parametrize("autopilots", [("px4", "px4"), ("arducopter", "arducopter")])
def test_two_that_are_never_above_each_other_land_where_they_are(autopilots: tuple[str, str]) -> None:
    vanished = Vanished(pair(autopilots=autopilots), after(Phase.HOLD, 1.0))
    assert vanished.flight.runner.failsafe.action == "land"
    assert vanished.min_distance_m >= vanished.flight.plan.spec.avoidance.radius_m
    assert vanished.down_s <= vanished.flight.runner.failsafe.down_s


def test_with_the_firmwares_own_parameters_the_upper_half_lands_on_the_lower_half() -> None:
    """What preflight refuses: it shows that the measure can fail."""
    hold = after(Phase.HOLD, 2.0)

    def careless(flight: Flight) -> bool:
        if not hold(flight):
            return False
        for pilot in flight.world.autopilots:
            pilot.params = px4_params(pilot.sysid)
        return True

    assert Vanished(cube8(), careless, watch_s=15.0).min_distance_m < 0.3


def test_without_room_above_the_team_holds_and_says_so() -> None:
    vanished = Vanished(cube8("failsafe.ceiling_m=3"), after(Phase.HOLD, 2.0), watch_s=60.0)
    runner = vanished.flight.runner
    assert runner.failsafe.action == "hold"
    (told,) = [text for text in vanished.flight.texts("info") if text.startswith("when the ground station is gone")]
    assert "they are asked to hold until they are taken over" in told
    assert "need 5.6 m of height, there are 3 m (failsafe.ceiling_m)" in told
    assert vanished.min_distance_m >= 0.45
    assert all(modes == ["OFFBOARD", "AUTO.LOITER"] for modes in vanished.modes)
