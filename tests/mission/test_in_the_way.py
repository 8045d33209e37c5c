"""Obstacles in the mission file: what is refused when it is read, with the obstacle, the distance and the remedy."""

from __future__ import annotations

import json

import pytest

from groundstation.core.errors import UserError
from groundstation.mission.ground.failsafe import make_failsafe
from groundstation.mission.plan.reading import plan_from_record
from tests.app.flights import four

ROOM = "fence={min_m: [-3, -3, 0], max_m: [7, 7, 4]}"
POLE = "{name: pole, at_m: [3, 0.5, 0], radius_m: 0.3, height_m: 4}"


@pytest.mark.parametrize(
    ("obstacles", "steps", "words"),
    [
        ("{name: a, at_m: [0, 0, 0]}", "form: {}", "give radius_m for a sphere, radius_m and height_m for an upright"),
        ("{name: a, at_m: [0, 0, 0], height_m: 1, size_m: [1, 1, 1]}", "form: {}", "give radius_m for a sphere"),
        ("{name: a, at_m: [0, 0, 0], radius_m: 0}", "form: {}", "obstacles[0].radius_m"),
        (f"{POLE}, {POLE}", "form: {}", "obstacles[1].name: pole is the name of obstacles[0] too"),
        (
            "{name: tree, at_m: [-0.3, 0, 0], radius_m: 0.1, height_m: 2}",
            "form: {}",
            "vehicles[0].pad_m: takeoff and landing would come 0.20 m from obstacle tree, minimum is",
        ),
        (
            "{name: lamp, at_m: [0.5, 0.5, 1.4], radius_m: 0.3}",
            "form: {}",
            "steps[0].form: the team, expected above its pads and turned any way, would come",
        ),
        (
            POLE,
            "form: {}, move: {by_m: [5, 0, 0]}",
            "steps[1].move: the team would come 0.44 m from obstacle pole, minimum is 0.50 m",
        ),
        (POLE, "go_to: {to_m: [5.5, 0.5, 2]}", "steps[0].go_to: the team on its straight way would come"),
    ],
)
def test_what_an_obstacle_is_in_the_way_of_is_refused(obstacles: str, steps: str, words: str) -> None:
    with pytest.raises(UserError) as refused:
        four(ROOM, f"obstacles=[{obstacles}]", f"steps=[{steps}]")
    assert words in str(refused.value)


def test_a_mission_with_obstacles_goes_through_its_record_and_does_not_return_by_itself() -> None:
    plan = four(ROOM, f"obstacles=[{POLE}]", "steps=[form: {}, move: {by_m: [1, 0, 0]}]")
    again = plan_from_record(json.loads(json.dumps(plan.record())), plan.gains_npz, "manifest")
    assert again.record() == plan.record()
    assert [body.name for body in again.obstacles.bodies] == ["pole"]
    assert plan.obstacles.keep_m > plan.spec.avoidance.radius_m
    still = four(ROOM, f"obstacles=[{POLE}]")
    assert make_failsafe(still).action != "return"
