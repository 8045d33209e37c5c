"""The campaign's witness: what the ground station says, held against what the emulated vehicles really do."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.app.campaign.words import KINDS, Verdict, Witness
from groundstation.app.emulator import world_config
from sitl.world import World
from tests.app.flights import four

SECOND_NS = 1_000_000_000


class Scene:
    """Four vehicles on pads 1 m apart, r = 0.45 m, moved by hand; words come from the test."""

    def __init__(self) -> None:
        self.plan = four()
        self.world = World(world_config(self.plan, 1), 1)
        self.witness = Witness(self.plan, self.world)
        self.run(0.1)

    def run(self, seconds: float, vehicle: int = 0, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        dynamics = self.world.dynamics
        dynamics.commands.vel_sp_enu_m_s[:, vehicle] = velocity
        for _ in range(round(seconds * 50)):
            self.world.advance(self.world.now_ns + SECOND_NS // 50)
            self.witness.look(self.world.now_ns, self.world.min_distance_airborne_of_pairs_m)

    def lift(self, vehicle: int = 0) -> None:
        self.world.dynamics.commands.flying[vehicle] = True
        self.run(2.5, vehicle, (0.0, 0.0, 0.5))

    def say(self, text: str) -> None:
        self.witness.hear(self.world.now_ns, text)

    def verdict(self, outcome: str = "aborted", reason: str = "stopped by the operator") -> Verdict:
        self.witness.ended(self.world.now_ns)
        return self.witness.verdict(outcome, reason, self.world.min_distance_airborne_of_pairs_m())


def _kinds(verdict: Verdict) -> set[str]:
    return {kind for kind, _ in verdict.found}


def test_a_flight_that_ends_as_it_is_told_agrees() -> None:
    scene = Scene()
    scene.lift()
    scene.run(6.0, 0, (0.0, 0.0, -0.5))
    found = scene.verdict("completed", "")
    assert found.found == ()
    assert not found.untold
    assert found.columns() == {**dict.fromkeys(KINDS, 0), "disagreements": 0, "disagreed": ""}


@pytest.mark.parametrize(
    ("said", "kinds"),
    [
        ("", {"crash_untold"}),
        ("vehicle 2: is tilted by 69 degrees, limit 60 degrees", {"crash_untold"}),
        ("aborted: landed by the operator", {"crash_untold"}),
        ("aborted: everybody: killed by the operator", set()),
        ("vehicle 1: is tilted by 69 degrees, limit 60 degrees", set()),
        ("vehicles 3, 1 too, see the alarms", set()),
    ],
)
def test_a_crash_that_nobody_is_told_of(said: str, kinds: set[str]) -> None:
    scene = Scene()
    scene.lift()
    scene.witness.upset(range(4))
    scene.world.dynamics.health.tumble(0, True)
    scene.world.dynamics.commands.flying[0] = False
    scene.run(0.2)
    scene.say(said)
    scene.run(2.0)
    assert scene.world.dynamics.motion.touchdown_m_s[0] > 3.0
    found = scene.verdict()
    assert _kinds(found) - {"pad_untold"} == kinds
    assert found.untold or not kinds


def test_a_hit_that_was_a_landing_is_no_hit() -> None:
    scene = Scene()
    scene.lift()
    scene.run(6.0, 0, (0.0, 0.0, -0.5))
    scene.say("vehicle 1: has hit the ground at 1.8 m/s, a landing ends below 1.3 m/s; look at its legs")
    assert _kinds(scene.verdict()) == {"said_hit"}


def test_what_was_said_long_before_is_no_word_about_a_fall() -> None:
    scene = Scene()
    scene.lift()
    scene.say("vehicle 1: battery at 29%, warning below 30%")
    scene.run(7.0)
    scene.world.dynamics.commands.flying[0] = False
    scene.run(2.0)
    found = scene.verdict("completed", "")
    assert {"crash_untold", "completed_untrue"} <= _kinds(found)
    assert "vehicle 1 hit the ground at" in str(found.columns()["disagreed"])


def test_who_lands_on_one_that_stands_there_is_no_completed_mission() -> None:
    scene = Scene()
    scene.lift()
    scene.run(2.0, 0, (0.5, 0.0, 0.0))
    scene.run(6.0, 0, (0.0, 0.0, -0.5))
    found = scene.verdict("completed", "")
    assert {"near_untold", "pad_untold", "completed_untrue"} <= _kinds(found)
    assert found.columns()["near_untold"] == 1

    scene.say("vehicles 1 and 2: 0.44 m apart, minimum is 0.45 m; everybody comes back")
    assert _kinds(scene.verdict()) == set()


@pytest.mark.parametrize(("said_then", "found"), [(True, set()), (False, {"said_near"})])
def test_a_reason_is_held_against_the_time_at_which_it_was_said_first(said_then: bool, found: set[str]) -> None:
    scene = Scene()
    scene.world.dynamics.commands.flying[0] = True
    scene.run(0.8, 0, (0.0, 0.0, 0.5))
    scene.run(1.4, 0, (0.5, 0.0, 0.0))
    reason = "vehicles 1 and 2: 0.44 m apart, minimum is 0.45 m; everybody comes back"
    if said_then:
        scene.say(f"aborted: {reason}")
    scene.run(1.4, 0, (-0.5, 0.0, 0.0))
    scene.run(3.0)
    scene.run(3.0, 0, (0.0, 0.0, -0.5))
    assert _kinds(scene.verdict(reason=reason)) == found


FAR = {"pad_untold", "completed_untrue"}


@pytest.mark.parametrize(
    ("drift_m_s", "flown_s", "found"),
    [(0.08, 0.0, set()), (0.13, 0.0, set()), (0.13, 16.0, FAR), (0.4, 0.0, FAR), (0.0, 0.0, FAR)],
)
def test_of_a_position_that_creeps_nobody_can_know(drift_m_s: float, flown_s: float, found: set[str]) -> None:
    scene = Scene()
    scene.lift()
    scene.run(flown_s)
    estimator = scene.world.state.estimator
    estimator.drift_enu_m_s[1, 0] = drift_m_s
    estimator.refresh()
    scene.run(0.8 / (drift_m_s or 0.4), 0, (0.0, -(drift_m_s or 0.4), 0.0))
    estimator.drift_enu_m_s[1, 0] = 0.0
    scene.run(6.0, 0, (0.0, 0.0, -0.5))
    assert _kinds(scene.verdict("completed", "")) == found


def test_a_position_that_jumps_while_it_creeps_can_be_known() -> None:
    scene = Scene()
    scene.lift()
    estimator = scene.world.state.estimator
    estimator.drift_enu_m_s[1, 0] = 0.08
    estimator.offset_enu_m[1, 0] = 0.8
    estimator.refresh()
    scene.run(2.0, 0, (0.0, -0.4, 0.0))
    estimator.drift_enu_m_s[1, 0] = 0.0
    scene.run(6.0, 0, (0.0, 0.0, -0.5))
    assert _kinds(scene.verdict("completed", "")) == FAR


def test_who_flies_on_or_stays_armed_is_named() -> None:
    scene = Scene()
    scene.lift()
    scene.world.autopilots[1].armed = True
    assert {"air_untold", "armed_untold"} <= _kinds(scene.verdict())
    scene.say("vehicle 1: is still in the air, in OFFBOARD; vehicle 2: still armed after 120 s of landing")
    assert _kinds(scene.verdict()) == set()


@pytest.mark.parametrize(
    "words", ["vehicles 1 and 4: 0.40 m apart, minimum is 0.45 m", "vehicle 4: too near to vehicle 1, 0.40 m apart"]
)
def test_two_that_are_called_near_and_are_not_are_found_in_either_words(words: str) -> None:
    scene = Scene()
    scene.run(3.0)
    scene.say(words)
    assert scene.verdict().columns()["said_near"] == 1


def test_words_about_what_is_not_so() -> None:
    scene = Scene()
    scene.lift()
    scene.world.autopilots[0].armed = True
    scene.run(3.0)
    scene.say("vehicle 1: disarmed by itself; it is released and not fought over")
    scene.say("vehicle 2 is still in the air, in AUTO.LOITER; take it over")
    scene.say("vehicles 1 and 4: 0.40 m apart, minimum is 0.45 m; everybody comes back")
    scene.say("vehicle 3: does not follow its setpoints by 0.47 m/s, limit 0.3 m/s; everybody comes back")
    assert {kind for kind, _ in scene.verdict().found} == {
        "said_disarmed", "said_in_the_air", "said_near", "said_sick"
    }  # fmt: skip

    scene = Scene()  # of those with which something is wrong all that may be so
    scene.witness.upset(range(4))
    scene.say("vehicles 1 and 4: 0.40 m apart, minimum is 0.45 m; everybody comes back")
    scene.say("vehicle 3: does not follow its setpoints by 0.47 m/s, limit 0.3 m/s; everybody comes back")
    assert _kinds(scene.verdict()) == set()


def test_a_mission_that_is_not_completed_has_a_reason() -> None:
    assert _kinds(Scene().verdict("aborted", "")) == {"untold"}
    assert _kinds(Scene().verdict("refused", "vehicle 1: is off its pad")) == set()


def test_the_order_to_land_all_is_a_word_about_everybodys_place() -> None:
    scene = Scene()
    scene.lift()
    scene.run(2.0, 0, (-0.5, 0.0, 0.0))
    scene.run(6.0, 0, (0.0, 0.0, -0.5))
    assert np.linalg.norm(scene.world.dynamics.motion.pos_enu_m[:2, 0] - scene.plan.pads_enu_m[0, :2]) > 0.8
    assert _kinds(scene.verdict()) == {"pad_untold"}
    scene.say("aborted: landed by the operator")
    assert _kinds(scene.verdict()) == set()
