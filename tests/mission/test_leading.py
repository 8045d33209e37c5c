"""A step in which the operator leads: how it is judged when the mission is read, and when an order is given."""

from __future__ import annotations

import json

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core import frames
from groundstation.core.errors import UserError
from groundstation.core.motion import MovePlan
from groundstation.core.types import FloatArray
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.leading import Leading
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.step import Now, StepTick
from groundstation.mission.flight.steps import step_flight
from groundstation.mission.flight.under_way import UnderWay
from groundstation.mission.ground.battery_need import flight_time_s
from groundstation.mission.ground.failsafe import make_failsafe
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission, plan_from_record
from groundstation.mission.roster import enlist
from groundstation.mission.timing import SECOND_NS
from groundstation.mission.verdict import Verdict

CUBE8 = packaged_configs() / "missions" / "cube8.yaml"


def _plan(steps: str, *changes: str) -> MissionPlan:
    return load_mission(CUBE8, [f"steps=[{steps}]", *changes])


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ("lead: {}", "steps[0]: the first step has to be `form`, or to fly to places; there is nothing to lead"),
        (
            "form: {}, lead: {}, hold: {}, move: {by_m: [0.1, 0, 0]}",
            "steps[3]: nobody knows before the flight where and how large the operator leaves the formation; put a",
        ),
        ("form: {}, lead: {smallest: 0.3}", "steps[1].lead.smallest: 0.3 brings two points to 0.3 m, minimum is more"),
        ("form: {}, lead: {smallest: 0.46}", "steps[1].lead.smallest"),
        ("form: {}, lead: {smallest: 2, largest: 1}", "smallest is 2 and largest 1; give the smaller one first"),
        ("form: {}, hover: {}, lead: {}", "lead is of a formation, and steps[1] leaves it"),
        ("form: {}, lead: {second: 3}", "did you mean seconds?"),
    ],
)
def test_a_lead_step_that_cannot_be_flown_is_refused_when_the_mission_is_read(steps: str, words: str) -> None:
    with pytest.raises(UserError) as refused:
        _plan(steps)
    assert words in str(refused.value)


def test_a_mission_that_is_led_is_judged_as_one_that_moves() -> None:
    led, held = _plan("form: {}, lead: {seconds: 30}, form: {}"), _plan("form: {}, hold: {seconds: 30}, form: {}")
    assert (led.moved, held.moved) == (True, False)
    assert make_failsafe(led).action == "hold"
    assert flight_time_s(led, make_failsafe(led)) >= flight_time_s(held, make_failsafe(led))
    again = plan_from_record(json.loads(json.dumps(led.record())), led.gains_npz, "manifest")
    assert again.record() == led.record()
    assert _plan("form: {}, lead: {smallest: 0.8}").room_m < _plan("form: {}, lead: {}").room_m == held.room_m
    assert _plan("form: {}, lead: {}, form: {}, move: {by_m: [0.1, 0, 0]}").moves.keys() == {3}


class Scene:
    """A team that is led, and does at once what it is told."""

    def __init__(self, *changes: str, lead: str = "seconds: 100, smallest: 0.8, largest: 1.5") -> None:
        self.plan = _plan(f"form: {{}}, lead: {{{lead}}}", *changes)
        self.verdict = Verdict()
        self.flown = UnderWay(self.plan, enlist(self.plan), Guide(self.plan), self.verdict.figures, self.verdict.note)
        self.flown.advance()
        self.flown.advance()
        step = self.flown.step
        assert step is not None
        doing = step_flight(self.flown, 0, step)
        assert isinstance(doing, Leading)
        self.led, self.now_ns = doing, 0
        points = self.plan.formation.points_enu_m
        self.pos: FloatArray = points - points.mean(axis=0) + np.array([0.0, 0.0, 1.6])

    def say(
        self, text: str, by: tuple[float, float, float] = (0.0, 0.0, 0.0), turn: float = 0.0, scale: float = 1.0
    ) -> str:
        move = MovePlan(np.array(by), turn, scale, 1.0)
        taken, words = self.led.steer(text, move, frames.ned_from_enu(self.pos), self.now_ns)
        assert taken == ("takes" in words)
        return words

    def tick(self, for_s: float = 0.02, error_m: float = 0.0) -> StepTick:
        for _ in range(round(for_s * 50)):
            self.now_ns += SECOND_NS // 50
            n = len(self.pos)
            level, nobody = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), np.zeros(n, dtype=np.bool_)
            poses = Poses(frames.ned_from_enu(self.pos), np.zeros((n, 3)), level, nobody)
            tick = self.led.tick(Now(self.now_ns, poses, error_m, upright=True, absent=nobody))
            if tick.motion is not None:
                self.pos = self.pos + tick.motion.vel_enu_m_s / 50
            if tick.done or tick.give_up:
                break
        return tick

    def notes(self) -> list[str]:
        return [f"{note.kind}: {note.text}" for note in self.verdict.take_notes()]


def test_turning_and_scaling_take_the_time_that_the_farthest_agent_needs() -> None:
    small, large = Scene(), Scene("formation_scale=1.6")
    seconds = [float(scene.say("t", turn=1.5).split()[2]) for scene in (small, large)]
    assert seconds[1] > 1.4 * seconds[0]
    for scene, took_s in zip((small, large), seconds, strict=True):
        level_m = np.linalg.norm((scene.pos - scene.pos.mean(axis=0))[:, :2], axis=1).max()
        fastest = max(abs(scene.tick().motion.turn_rad_s) for _ in range(round(50 * took_s)))  # type: ignore[union-attr]
        limit = scene.plan.spec.speed_limit_m_s
        assert 0.3 * limit < fastest * level_m <= 0.5 * limit + 1e-9
    seconds = [float(Scene().say("s", scale=scale).split()[2]) for scale in (1.1, 1.5)]
    assert seconds[1] > 1.5 * seconds[0]


def test_an_order_is_judged_from_where_the_ones_before_it_lead() -> None:
    scene = Scene()
    assert "takes" in scene.say("a", by=(1.2, 0.0, 0.0))
    assert "takes" in scene.say("b", scale=1.4)
    why = scene.say("c", by=(1.2, 0.0, 0.0))
    assert "to x = " in why
    assert "beyond the fence" in why
    assert "1.54 times its size" in scene.say("d", scale=1.1)
    assert "takes" in scene.say("e", by=(-1.0, 0.0, 0.0))


def test_a_whole_turn_whose_end_lies_inside_is_refused_where_the_way_does_not() -> None:
    scene = Scene("fence.max_m=[1.25, 3, 3]", "vehicles.3.pad_m=[0.5, -1, 0]", "vehicles.5.pad_m=[0.5, 1, 0]")
    scene.pos = scene.pos + np.array([0.7, 0.0, 0.0]) if scene.pos[:, 0].max() < 0.56 else scene.pos
    assert "beyond the fence" in scene.say("turn 360", turn=2.0 * np.pi)
    assert "takes" in scene.say("turn 5", turn=np.radians(2.0))


def test_an_order_that_no_longer_fits_when_it_begins_is_told_and_those_after_it_are_dropped() -> None:
    scene = Scene()
    scene.say("a", by=(0.5, 0.0, 0.0))
    scene.say("b", by=(0.5, 0.0, 0.0))
    scene.pos = scene.pos + np.array([5.0, 0.0, 0.0])
    assert scene.tick() == StepTick()
    notes = scene.notes()
    assert any(text.startswith("alarm: a: move not begun: it would take vehicle") for text in notes)
    assert "info: dropped: b" in notes
    scene.pos = scene.pos - np.array([5.0, 0.0, 0.0])
    assert "takes" in scene.say("c", by=(0.5, 0.0, 0.0))


def test_a_move_that_a_wall_holds_up_for_too_long_is_told_and_the_step_goes_on() -> None:
    scene = Scene()
    seconds = float(scene.say("a", by=(0.5, 0.0, 0.0)).split()[2])
    scene.tick(0.5 * seconds)
    scene.led.left_room(0.0)
    tick = scene.tick(3.0 * seconds + 10.0)
    assert (tick.done, tick.give_up) == (False, "")
    notes = scene.notes()
    assert any("move not finished" in text and "the fence is in the way" in text for text in notes)
    assert "takes" in scene.say("b", by=(0.1, 0.0, 0.0))
    assert scene.tick(20.0) == StepTick()
    assert "info: b: done" in scene.notes()


def test_a_formation_that_is_lost_while_it_is_led_ends_the_mission() -> None:
    for moving in (False, True):
        scene = Scene()
        if moving:
            scene.say("a", by=(0.5, 0.0, 0.0))
        assert "formation lost while" in scene.tick(5.0, error_m=0.3).give_up


def test_staying_brings_the_team_to_rest_and_keeps_what_was_done() -> None:
    scene = Scene()
    seconds = float(scene.say("grow", scale=1.4).split()[2])
    scene.tick(0.5 * seconds)
    scene.led.stay()
    assert scene.tick(1.0) == StepTick()
    assert 1.1 < scene.flown.size < 1.35
    notes = scene.notes()
    assert "info: grow: ended early" in notes
    assert f"info: formation of step 1: cube8, scale {scene.flown.size:.6g}" in notes
    assert "times its size" in scene.say("again", scale=1.4)


def test_the_step_ends_with_its_time_or_at_the_operators_word_and_then_takes_no_orders() -> None:
    scene = Scene(lead="seconds: 20")
    scene.say("a", by=(0.5, 0.0, 0.0))
    assert not scene.tick(1.0).done
    scene.led.end("by the operator")
    assert scene.say("b", by=(0.1, 0.0, 0.0)) == "the lead step ends (by the operator)"
    assert scene.tick(2.0).done
    assert "info: lead is over, by the operator: 1 order was flown" in scene.notes()
    assert Scene(lead="seconds: 2").tick(2.1).done


def test_a_free_size_is_not_scaled_and_a_place_that_is_not_known_is_not_left() -> None:
    scene = Scene("scale.kind=free")
    assert "left free" in scene.say("s", scale=1.2)
    scene.pos[2] = np.nan
    assert scene.say("m", by=(0.1, 0.0, 0.0)) == "where vehicle 3 is, is not known at the moment"
