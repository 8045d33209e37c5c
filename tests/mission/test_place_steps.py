"""Steps that fly to places and form nothing: how they are judged, and when they are over."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.step import Now, StepFlight
from groundstation.mission.flight.steps import step_flight
from groundstation.mission.flight.under_way import UnderWay
from groundstation.mission.ground.battery_need import flight_time_s
from groundstation.mission.ground.failsafe import make_failsafe
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission, plan_from_record
from groundstation.mission.roster import enlist
from groundstation.mission.timing import SECOND_NS
from groundstation.mission.verdict import Verdict

_MISSIONS = packaged_configs() / "missions"


def _hello(*changes: str) -> MissionPlan:
    return load_mission(_MISSIONS / "hello1.yaml", changes)


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (
            "{hold: {seconds: 1}}",
            "steps[0]: the first step has to be `form`, or to fly to places; there is nothing to hold",
        ),
        ("{move: {by_m: [1, 0, 0]}}", "there is nothing to move"),
        ("{hover: {}}, {form: {}}", "formation: is missing, give it a value: steps[1] forms one"),
        ("{go_to: {to_m: [9, 0, 3]}}", "steps[0].go_to: takes the team to x = 9 m, fence ends at 8 m"),
        ("{go_to: {to_m: [0, 0, 1]}}", "takes the team to z = 1 m, min_altitude_m or fence.min_m ends at 2.4 m"),
        ("{waypoints: {through_m: [[0, 0, 3], [0, -9, 3]]}}", "steps[0].waypoints: takes the team to y = -9 m"),
        ("{waypoints: {through_m: []}}", "through_m: needs at least 1 item, has 0"),
        ("{go_to: {}}", "steps[0].go_to.to_m: is missing"),
        ("{go_too: {to_m: [0, 0, 3]}}", "steps[0].go_too: unknown key, did you mean go_to?"),
    ],
)
def test_steps_that_cannot_be_flown_are_refused(steps: str, words: str) -> None:
    with pytest.raises(UserError) as refused:
        _hello(f"steps=[{steps}]")
    assert words in str(refused.value)


@pytest.mark.parametrize("step", ["hold: {seconds: 1}", "move: {by_m: [1, 0, 0]}"])
def test_a_formation_that_was_left_is_not_held_or_moved(step: str) -> None:
    with pytest.raises(UserError, match=r"steps\[2\]: \w+ is of a formation, and steps\[1\] leaves it; put a `form`"):
        load_mission(_MISSIONS / "first_flight2.yaml", [f"steps=[{{form: {{}}}}, {{hover: {{}}}}, {{{step}}}]"])


def test_a_team_is_judged_with_its_width() -> None:
    pair = _MISSIONS / "first_flight2.yaml"
    with pytest.raises(UserError, match=r"steps\[0\]\.go_to: takes the team to x = 8\.5 m, fence ends at 8 m"):
        load_mission(pair, ["steps=[{go_to: {to_m: [6, 0, 3]}}]"])
    with pytest.raises(UserError, match=r"steps\[1\]\.go_to: takes the team to x = 8\.5 m"):  # 7 m apart by then
        load_mission(pair, ["steps=[{form: {tolerance_m: 0.4}}, {go_to: {to_m: [5, 0, 3]}}]"])
    assert load_mission(pair, ["steps=[{go_to: {to_m: [5, 0, 3]}}]"]).places_enu_m[0].tolist() == [[5.0, 0.0, 3.0]]


def test_a_mission_of_one_is_whole_without_a_formation_and_its_record_too() -> None:
    plan = _hello()
    assert (plan.size, plan.spec.formation, plan.gains_npz) == (1, None, b"")
    again = plan_from_record(plan.record(), plan.gains_npz, "manifest")
    assert again.record() == plan.record()
    assert {number: places.tolist() for number, places in again.places_enu_m.items()} == {
        0: [], 1: [[2.0, 0.0, 3.0]], 2: [[2.0, 2.0, 3.5], [0.0, 2.0, 3.5], [0.0, 0.0, 3.0]],
    }  # fmt: skip
    failsafe = make_failsafe(plan)
    assert failsafe.action == "return"
    far = _hello("steps=[{go_to: {to_m: [7, 0, 3]}}]")
    near = _hello("steps=[{go_to: {to_m: [1, 0, 3]}}]")
    assert flight_time_s(far, failsafe) - flight_time_s(near, failsafe) == pytest.approx(12.0)


class _Scene:
    """A step of the pair's mission, flown by hand."""

    def __init__(self, step: str) -> None:
        self.plan = load_mission(_MISSIONS / "first_flight2.yaml", [f"steps=[{step}]", "position_error_m=0.01"])
        self.verdict = Verdict()
        self.flown = UnderWay(self.plan, enlist(self.plan), Guide(self.plan), self.verdict.figures, self.verdict.note)
        self.flown.advance()
        first = self.flown.step
        assert first is not None
        self.doing: StepFlight = step_flight(self.flown, 0, first)
        self.pos: FloatArray = np.array([[0.0, -2.5, -3.0], [0.0, 2.5, -3.0]])

    def tick(self, t_s: float) -> tuple[bool, str, list[list[float]]]:
        level = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
        poses = Poses(self.pos, np.zeros((2, 3)), level, np.zeros(2, dtype=np.bool_))
        nobody = np.zeros(2, dtype=np.bool_)
        tick = self.doing.tick(Now(round(t_s * SECOND_NS), poses, float("nan"), upright=True, absent=nobody))
        assert tick.places_ned_m is not None
        return tick.done, tick.give_up, tick.places_ned_m.tolist()


def test_hovering_stays_where_everybody_was_and_ends_with_its_time() -> None:
    scene = _Scene("{hover: {seconds: 2}}")
    began = scene.pos.tolist()
    assert scene.tick(0.0) == (False, "", began)
    scene.pos = scene.pos + 0.3
    assert scene.tick(1.9) == (False, "", began)
    assert scene.tick(2.0)[0]


def test_a_team_goes_through_its_places_in_step_and_stays_a_second_at_the_last() -> None:
    scene = _Scene("{waypoints: {through_m: [[0, 2, 3], [0, 4, 4]], timeout_s: 9}}")
    assert scene.tick(0.0)[2] == [[2.0, -2.5, -3.0], [2.0, 2.5, -3.0]]
    scene.pos = scene.pos + np.array([1.9, 0.0, 0.0])
    assert scene.tick(5.0) == (False, "", [[4.0, -2.5, -4.0], [4.0, 2.5, -4.0]])
    scene.pos = np.array([[4.0, -2.5, -4.0], [4.0, 2.5, -3.8]])
    assert scene.tick(13.9)[:2] == (False, "")
    done, why, _ = scene.tick(14.1)
    assert (done, why) == (
        False, "not there after 9 s: vehicle 2 is 0.20 m from its place 2.50 4.00 4.00 m (ENU), limit is 0.15 m",
    )  # fmt: skip
    scene.pos[1, 2] = -3.9
    assert not scene.tick(14.2)[0]
    assert not scene.tick(15.1)[0]
    assert scene.tick(15.2)[:2] == (True, "")


def test_who_is_not_seen_is_waited_for_in_words() -> None:
    scene = _Scene("{go_to: {to_m: [0, 1, 3], timeout_s: 5}}")
    scene.pos[1] = np.nan
    places = scene.tick(0.0)[2]
    assert np.isfinite(places).all()
    assert "vehicle 2 is not known to be at its place" in scene.tick(5.0)[1]
