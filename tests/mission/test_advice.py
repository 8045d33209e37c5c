"""What is told of a mission that may fly, but not well."""

from __future__ import annotations

from dataclasses import replace

import pytest

from groundstation.app.resources import packaged_configs
from groundstation.mission.plan.advice import advice, slowest_mode_1_s
from groundstation.mission.plan.reading import load_mission

MISSIONS = packaged_configs() / "missions"
WELL = ("cube8", "sequence8", "px4_cube8", "arducopter_two_squares8", "mixed8", "first_flight2", "hello1")


@pytest.mark.parametrize("name", WELL)
def test_missions_that_come_along_are_designed_and_tuned_well(name: str) -> None:
    assert advice(load_mission(MISSIONS / f"{name}.yaml")) == []


def test_an_f_that_is_too_strong_for_the_size_is_told_with_one_that_fits() -> None:
    plan = load_mission(MISSIONS / "px4_cube8.yaml", ["scale.gain=2.5"])
    told = advice(plan)
    assert len(told) == 1
    assert "scale.gain 2.5 is too strong" in told[0]
    better = float(told[0].split("it is then ")[-1])
    mended = load_mission(MISSIONS / "px4_cube8.yaml", ["scale={}"])
    assert mended.scale.gain == pytest.approx(better, rel=0.05)
    assert advice(mended) == []
    assert mended.control_gain > 1.5 * plan.control_gain


@pytest.mark.parametrize("name", ["px4_cube8", "mixed8", "arducopter_two_squares8", "first_flight2", "cube8"])
def test_what_was_tuned_by_hand_is_found_from_the_size_alone(name: str) -> None:
    by_hand = load_mission(MISSIONS / f"{name}.yaml")
    found = load_mission(MISSIONS / f"{name}.yaml", ["scale={}"])
    assert found.scale.gain == pytest.approx(by_hand.scale.gain, rel=0.35)
    assert found.control_gain == pytest.approx(by_hand.control_gain, rel=0.02)


def test_a_weak_design_is_told_with_the_time_that_it_needs() -> None:
    plan = load_mission(MISSIONS / "cube8.yaml")
    stage = plan.stages[0]
    assert slowest_mode_1_s(stage) == pytest.approx(5.0, rel=1e-3)
    gains = replace(stage.shape.gains, xy=3e-5 * stage.shape.gains.xy)
    weak = replace(plan, stages=(replace(stage, shape=replace(stage.shape, gains=gains)),))
    told = advice(weak)
    assert "its slowest mode is 0.00015 1/s" in told[0]
    assert "timeout_s is 60 s; give it more edges (gs design --suggest-graph balanced)" in told[0]


def test_a_gain_that_the_lag_does_not_allow_is_told() -> None:
    told = advice(load_mission(MISSIONS / "paper_cube8.yaml"))
    assert len(told) == 1
    assert "gain: 1 is " in told[0]
    assert "the team may swing" in told[0]


def test_it_is_held_against_the_gain_that_would_be_flown() -> None:
    """The automatic one, with the tick and tilted views in it: twice that is told and no less."""
    flown = load_mission(MISSIONS / "cube8.yaml").control_gain
    assert advice(load_mission(MISSIONS / "cube8.yaml", [f"gain={1.98 * flown}"])) == []
    (told,) = advice(load_mission(MISSIONS / "cube8.yaml", [f"gain={2.5 * flown}"]))
    assert f"is 2.5 times what lag and delay of crazyflie allow ({flown:.2g})" in told
    strong = load_mission(MISSIONS / "px4_cube8.yaml", ["scale.gain=2.5"])
    assert f"to {strong.control_gain:.2g} and the team forms that much later" in advice(strong)[0]


@pytest.mark.parametrize(
    ("sensing", "words"),
    [
        ("{range_m: 0.9}", "range_m: 0.9 m is less than the longest edge of cube8, 1.00 m"),
        ("{field_of_view_deg: 120, share: both}", "face one way never see each other"),
    ],
)
def test_a_sensor_that_loses_neighbours_in_the_very_formation_is_told(sensing: str, words: str) -> None:
    told = advice(load_mission(MISSIONS / "cube8.yaml", [f"sensing={sensing}"]))
    assert len(told) == 1
    assert words in told[0]


@pytest.mark.parametrize("sensing", ["{range_m: 1.1}", "{field_of_view_deg: 120}", "{loss: 0.3}"])
def test_one_that_does_not_is_not(sensing: str) -> None:
    assert advice(load_mission(MISSIONS / "cube8.yaml", [f"sensing={sensing}"])) == []
