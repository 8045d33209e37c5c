"""Sequences in mission files: every formation and every move is judged before anything flies."""

from __future__ import annotations

import json

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError
from groundstation.mission.plan.reading import load_mission, plan_from_record

CUBE8 = packaged_configs() / "missions" / "cube8.yaml"
SQUARES = "formation: ../formations/two_squares8_low.yaml, gains: ../gains/two_squares8_low.npz"
STEPS = (
    f"steps=[form: {{}}, form: {{{SQUARES}, formation_scale: 1.2, tolerance_m: 0.08}}, move: {{by_m: [0.2, 0, 0]}},"
    " form: {formation_scale: 1.1}, form: {scale: {kind: free}, assignment: fixed}, form: {}]"
)


def test_each_step_has_its_own_formation_gains_law_and_roles() -> None:
    plan = load_mission(CUBE8, [STEPS])
    stages = [plan.stages[number] for number in plan.stage_of_step]
    assert [stage.formation.name for stage in stages] == ["cube8", *["two_squares8_low"] * 2, *["cube8"] * 3]
    assert [stage.key for stage in stages][1] == "steps[1].form"
    assert np.ptp(stages[1].formation.points_enu_m[:, 0]) == pytest.approx(1.2)
    assert np.ptp(stages[3].formation.points_enu_m[:, 0]) == pytest.approx(1.1)
    np.testing.assert_array_equal(stages[3].shape.gains.z, plan.gains.z)
    assert [stage.scale.kind for stage in stages] == ["arctan"] * 4 + ["free", "arctan"]
    assert [stage.upright_1_s for stage in stages] == [1.0] * 4 + [0.0, 1.0]
    assert [stage.swaps for stage in stages] == [True] * 4 + [False, True]
    assert plan.stage_of_step[0] == plan.stage_of_step[-1] == 0
    assert plan.moves[2].seconds > 0.0


def test_roles_are_swapped_where_vehicles_are_interchangeable_or_the_mission_says_so() -> None:
    assert load_mission(CUBE8).stages[0].swaps
    assert not load_mission(CUBE8, ["assignment=fixed"]).stages[0].swaps
    assert load_mission(CUBE8, ["assignment=fixed", "role_swaps=true"]).stages[0].swaps
    assert not load_mission(CUBE8, ["role_swaps=false"]).stages[0].swaps


def test_a_sequence_goes_through_its_record_to_the_bit() -> None:
    plan = load_mission(CUBE8, [STEPS])
    record = json.loads(json.dumps(plan.record()))
    again = plan_from_record(record, plan.gains_npz, "manifest")
    assert again.record() == plan.record()
    assert again.stage_of_step == plan.stage_of_step
    for mine, theirs in zip(plan.stages, again.stages, strict=True):
        np.testing.assert_array_equal(mine.formation.points_enu_m, theirs.formation.points_enu_m)
        np.testing.assert_array_equal(mine.shape.gains.xy, theirs.shape.gains.xy)
        assert (mine.control_gain, mine.scale, mine.upright_1_s) == (
            theirs.control_gain,
            theirs.scale,
            theirs.upright_1_s,
        )
    assert again.moves.keys() == plan.moves.keys()
    assert "../" not in json.dumps(record)


def test_a_mission_of_one_formation_has_the_record_that_it_always_had() -> None:
    record = load_mission(CUBE8).record()
    assert "shapes" not in record
    assert record["steps"] == [{"form": {"tolerance_m": 0.05, "timeout_s": 60.0}}, {"hold": {"seconds": 5.0}}]


@pytest.mark.parametrize("damage", [{"shapes": []}, {"shapes": [{"step": 1}]}, {"shapes": 3}])
def test_a_damaged_record_is_refused(damage: dict[str, object]) -> None:
    plan = load_mission(CUBE8, [STEPS])
    with pytest.raises(UserError, match=r"manifest: mission\.shapes: "):
        plan_from_record({**plan.record(), **damage}, plan.gains_npz, "manifest")


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ("form: {formation: ../formations/pyramid5.yaml}", "steps[1].form: vehicles: 8 listed, formation pyramid5"),
        ("form: {formation: nowhere.yaml}", "steps[1].form.formation: nowhere.yaml: no such file"),
        ("form: {gains: nowhere.npz}", "steps[1].form.gains: nowhere.npz: no such file"),
        ("form: {gains: ../gains/two_squares8_low.npz}", "gains of another formation"),
        ("form: {formation_scale: 0.4}", "steps[1].form: formation.points[1]: 0.4 m from points[0], minimum is more"),
        ("form: {formation_scale: 0.47}", "steps[1].form: avoidance.radius_m: 0.45 m cannot be kept with mocap"),
        ("form: {formation_scale: 9}", "steps[1].form: fence: 6 m of room along x, formation cube8 needs 12.7 m"),
        ("form: {formation: ../formations/twisted_cube8.yaml}", "steps[1].form.formation: ../formations/twisted"),
        ("form: {colour: red}", "steps[1].form.colour: unknown key"),
        ("move: {}", "steps[1].move: neither by_m, turn_deg nor scale is given"),
        ("move: {by_m: [1, 0]}", "steps[1].move.by_m"),
        ("move: {by_m: [1, 0, 0], seconds: 2}", "steps[1].move.seconds: 2 s is too short, at least 7.5 s are needed"),
        ("move: {turn_deg: 360, seconds: 5}", "steps[1].move.seconds: 5 s is too short, at least 33.4 s are needed"),
        ("move: {by_m: [2.6, 0, 0]}", "steps[1].move: takes the team to x = "),
        ("move: {by_m: [0, 0, -0.3]}", "steps[1].move: takes the team to z = "),
        ("move: {scale: 0.45}", "steps[1].move.scale: 0.45 brings two points to 0.45 m, minimum is more than 0.45 m"),
        ("move: {scale: 0.48}", "steps[1].move.scale: avoidance.radius_m: 0.45 m cannot be kept"),
        ("move: {scale: 0}", "steps[1].move.scale: expected a number of at least"),
        ("move: {by_m: [1.3, 0, 0]}, move: {by_m: [1.3, 0, 0]}", "steps[2].move: takes the team to x = "),
        ("move: {scale: 0.7}, move: {scale: 0.65}", "steps[2].move.scale: avoidance.radius_m: 0.45 m cannot be kept"),
    ],
)
def test_what_is_wrong_with_a_step_is_said_by_its_key(steps: str, message: str) -> None:
    with pytest.raises(UserError) as caught:
        load_mission(CUBE8, [f"steps=[form: {{}}, {steps}]"])
    assert str(CUBE8) in str(caught.value) or "gains of another" in str(caught.value)
    assert message in str(caught.value)
    assert caught.value.exit_code == 2


def test_the_margin_follows_the_smallest_size_of_the_mission() -> None:
    assert load_mission(CUBE8).room_m == pytest.approx(1.0 - 0.45)
    assert load_mission(CUBE8, ["steps=[form: {}, move: {scale: 0.6}]"]).room_m == pytest.approx(0.6 - 0.45)
