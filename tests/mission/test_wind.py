"""The wind that a mission allows: what there is room for, what is said of it, and what it excuses."""

from __future__ import annotations

import re

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core import frames
from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from tests.app.flights import cube8
from tests.core.test_wind import Blown
from tests.mission.test_monitors import Scene

MISSIONS = packaged_configs() / "missions"


def px4_cube8(*changes: str) -> MissionPlan:
    return load_mission(MISSIONS / "px4_cube8.yaml", changes)


def test_gusts_widen_what_is_kept_clear() -> None:
    calm, windy = px4_cube8("wind={gust_m_s: 0}"), px4_cube8()
    assert calm.keep_out_margin_m == calm.margin_m
    assert (windy.wind.mean_m_s, windy.wind.gust_m_s) == (8.0, 1.0)
    assert windy.keep_out_margin_m == pytest.approx(np.hypot(calm.margin_m, windy.gust_margin_m))
    assert windy.gust_margin_m == pytest.approx(2.0 * px4_cube8("wind={gust_m_s: 0.5}").gust_margin_m)
    assert px4_cube8("wind={mean_m_s: 3}").gust_margin_m < windy.gust_margin_m


def test_gusts_for_which_there_is_no_room_are_refused_and_those_that_are_named_are_taken() -> None:
    with pytest.raises(UserError, match=r"wind\.gust_m_s: 2 m/s with a mean of 8 m/s may bring two") as refused:
        px4_cube8("wind={gust_m_s: 2}")
    able = float(str(refused.value).split("gusts of ")[-1].split(" m/s could be allowed")[0])
    assert 1.0 < able < 2.0
    px4_cube8(f"wind={{gust_m_s: {able}}}")
    with pytest.raises(UserError, match="could be allowed"):
        px4_cube8(f"wind={{gust_m_s: {able + 0.02}}}")


def test_a_mean_wind_beyond_the_vehicles_or_over_the_fence_is_refused() -> None:
    with pytest.raises(UserError, match=r"wind\.mean_m_s: 9 m/s, maximum is 8 m/s, what the vehicles stand against"):
        px4_cube8("wind={mean_m_s: 9}")
    changes = ("wind={mean_m_s: 8}", "fence.min_m=[-6, -20, 0]", "speed_limit_m_s=0.5")
    with pytest.raises(
        UserError, match=r"aside at takeoff, and vehicles\[0\]\.pad_m is 1 m from the fence; "
    ) as refused:
        px4_cube8(*changes)
    able = float(str(refused.value).split("fence; ")[1].split(" m/s")[0])
    px4_cube8(f"wind={{mean_m_s: {able}}}", *changes[1:])


def test_without_a_word_of_the_mission_the_profile_counts_as_far_as_there_is_room() -> None:
    assert px4_cube8("avoidance={radius_m: 3.9, activation_m: 4.0}").wind.gust_m_s < 0.2
    narrow = px4_cube8("fence.min_m=[-6, -20, 0]", "speed_limit_m_s=0.5")
    assert 0.0 < narrow.wind.mean_m_s < 6.0


class Windy(Scene):
    """A team that is blown about, and stands against it, as ``Blown`` has it; the first may be told otherwise."""

    def __init__(self, gust_m_s: float, mean_m_s: tuple[float, float], *, obeys: bool = True) -> None:
        super().__init__(
            *(f"vehicles.{k}.profile=px4_quad" for k in range(8)),
            "fence={min_m: [-60, -60, 0], max_m: [60, 60, 60]}",
            "wind={mean_m_s: 8, gust_m_s: 0.4}",
            "profiles={px4_quad: {drag_1_s: 0.25, lag_s: 0.5}}",
        )
        self.team, self.obeys = Blown(8, gust_m_s, mean_m_s, seed=6), obeys
        self.spots = self.pos + 30.0 * (self.pos - self.pos.mean(axis=0)) * [1.0, 1.0, 0.0]

    def fly(self, seconds: float) -> list[str]:
        """Flies, each back to its place; returns what was said."""

        def blow() -> None:
            told: FloatArray = np.clip(-0.5 * (self.team.pos + self.team.vel), -0.5, 0.5)
            self.sent = told = self.monitor.told(told).copy()
            if not self.obeys:
                told = told.copy()
                told[0] = [0.45, 0.0, 0.0]  # goes its own way, by its own motors
            self.team.step(told)
            down = self.team.down_ned
            roll, pitch = np.arcsin(-down[:, 1]), np.arctan2(down[:, 0], down[:, 2])
            self.fleet.quat_ned_from_frd[:] = frames.quat_ned_from_frd_of_euler(roll, pitch, np.zeros(8))
            self.pos, self.vel = self.spots + self.team.pos, self.team.vel

        blow()
        self.run(seconds, blow)
        return self.alarms


def test_vehicles_that_gusts_within_the_limit_push_about_are_left_alone() -> None:
    (told,) = Windy(0.4, (0.0, -7.5)).fly(25.0)
    assert told.startswith("wind of 7.")
    assert told.endswith("the limit is mean 8 m/s, gusts 0.4 m/s; bring them back before it is more")


@pytest.mark.parametrize("gust_m_s", [0.0, 0.4])
def test_one_that_goes_its_own_way_in_a_wind_is_found(gust_m_s: float) -> None:
    alarms = Windy(gust_m_s, (4.0, 0.0), obeys=False).fly(20.0)
    (found,) = [text for text in alarms if "does not follow" in text]
    assert found.startswith("vehicle 1: does not follow its setpoints by ")
    assert "wind" not in found


def test_ones_that_a_wind_beyond_the_limit_carries_off_are_said_to_be_in_one() -> None:
    """Before the wind of the team is known, too: what a vehicle misses its setpoints by is then found first."""
    alarms = Windy(3.0, (11.0, 0.0)).fly(12.0)
    found = [text for text in alarms if "does not follow" in text]
    assert found
    for text in found:
        assert re.search(r"; a wind of (9|1\d)\.\d m/s pushes it, the limit is mean 8 m/s, gusts 0\.4 m/s", text), text


def test_gusts_and_winds_beyond_the_limit_are_told_and_bring_everybody_back() -> None:
    alarms = Windy(1.2, (0.0, 4.0)).fly(18.0)
    assert any(text.startswith("wind of ") and "; everybody comes back; wait for less wind" in text for text in alarms)
    assert "from the west with gusts of " in alarms[0]
    assert "the limit is mean 8 m/s, gusts 0.4 m/s" in alarms[0]
    alarms = Windy(0.0, (11.0, 0.0)).fly(18.0)
    assert any(text.startswith("wind of 1") and "; everybody comes back; wait for less wind" in text for text in alarms)


def test_calm_air_is_no_wind() -> None:
    scene = Windy(0.0, (0.0, 0.0))
    assert scene.fly(12.0) == []
    assert scene.monitor.wind.sway_m == 0.0


def test_a_mission_may_say_how_its_vehicles_take_the_wind() -> None:
    light = px4_cube8("profiles={px4_quad: {air_1_s: 0.1, air_1_m: 0.01, wind_settle_s: 2}}")
    frame = light.profile.airframe
    assert (frame.air_1_s, frame.air_1_m, frame.settle_s, frame.push_lag_s) == (0.1, 0.01, 2.0, 0.49)
    assert light.gust_margin_m < 0.5 * px4_cube8().gust_margin_m


def test_unasked_gusts_leave_room_to_move_in_a_tight_formation_and_stated_ones_take_what_they_need() -> None:
    tight: tuple[str, ...] = (
        "formation=../formations/two_squares9.yaml",
        "gains=../gains/two_squares9.npz",
        "position_error_m=0.02",
    )
    tight += ("avoidance={radius_m: 0.67, activation_m: 0.85}", "vehicles=" + _nine("px4_quad"))
    unasked = cube8(*tight)
    assert unasked.keep_out_margin_m <= 0.6 * unasked.room_m
    assert unasked.wind.gust_m_s < 0.15
    stated = cube8(*tight, "wind={mean_m_s: 4, gust_m_s: 0.22}")
    assert 0.8 * stated.room_m < stated.keep_out_margin_m <= 0.9 * stated.room_m
    with pytest.raises(UserError, match=r"gusts of 0\.2\d m/s could be allowed"):
        cube8(*tight, "wind={mean_m_s: 4, gust_m_s: 0.3}")


def _nine(profile: str) -> str:
    """Nine vehicles on a grid of 2 m."""
    pads = [[2.0 * (k % 3) - 2.0, 2.0 * (k // 3) - 2.0, 0.0] for k in range(9)]
    link = "'udpin://127.0.0.1:14540'"
    rows = [
        f"{{id: {k + 1}, link: {link}, autopilot: px4, profile: {profile}, pad_m: {pad}}}" for k, pad in enumerate(pads)
    ]
    return f"[{', '.join(rows)}]"


MIXED = MISSIONS / "mixed8.yaml"


def test_a_mean_wind_that_blows_one_kind_onto_another_at_takeoff_is_refused() -> None:
    """By hand: pads of different kinds are 5 m apart, r is 3 m."""
    with pytest.raises(
        UserError, match=r"wind\.mean_m_s: 8 m/s may bring vehicles 2 \(px4\) and 5 \(arducopter\) nearer by \d"
    ) as refused:
        load_mission(MIXED, ["wind={mean_m_s: 8}"])
    assert "their pads leave 2.00 m beside avoidance.radius_m 3 m" in str(refused.value)
    able = float(str(refused.value).split("radius_m 3 m; ")[1].split(" m/s")[0])
    assert load_mission(MIXED, [f"wind={{mean_m_s: {able}}}"]).wind.mean_m_s == able
    assert load_mission(MIXED).wind.mean_m_s == able < 6.0  # without a word as much as there is room for
    assert load_mission(MIXED, ["avoidance.radius_m=1.0", "avoidance.activation_m=2.0"]).wind.mean_m_s == 8.0
    assert px4_cube8().wind.mean_m_s == 8.0  # all are blown off alike


def test_two_kinds_of_one_autopilot_are_told_apart_by_their_profiles() -> None:
    heavy = ("profiles={heavy: {like: px4_quad, lag_s: 1.2}}", "vehicles.0.profile=heavy")
    with pytest.raises(UserError, match=r"may bring vehicles 1 \(heavy\) and 2 \(px4_quad\) nearer by"):
        px4_cube8("wind={mean_m_s: 8}", *heavy)


def test_what_nobody_calls_a_wind_is_allowed_to_teams_of_any_kinds() -> None:
    plan = cube8("vehicles.0.autopilot=arducopter", "vehicles.0.profile=arducopter")
    assert plan.wind.mean_m_s == 1.0
