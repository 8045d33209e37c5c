"""The team's place and heading are kept: for long, in a drift, through moves, and at no distance's cost."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core import frames
from groundstation.core.types import FloatArray
from groundstation.mission.flight.formation_flight import FormationFlight
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.helm import Helm
from groundstation.mission.flight.keeping import SPEED_SHARE, PlaceKeeper, heading_of
from groundstation.mission.flight.poses import Poses
from groundstation.mission.ground.failsafe import first_roles
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.roster import enlist
from groundstation.mission.verdict import Figures
from tests.mission.test_formation_flight import Team

FIRST2 = packaged_configs() / "missions" / "first_flight2.yaml"
TICK_S = 0.1
LONG = ("rate_hz=10", "steps.1.hold.seconds=7200")
NOBODY = np.zeros(2, dtype=np.bool_)


class Drifting:
    """Two vehicles that lag, carried off by what they share; what they believe of their places wanders too."""

    def __init__(self, *changes: str, drift_m_s: float = 0.03, noise_m: float = 0.05) -> None:
        self.plan = load_mission(FIRST2, (*LONG, *changes))
        self.flight = FormationFlight(
            self.plan,
            enlist(self.plan),
            Helm(Guide(self.plan), self.plan.size),
            Figures(),
            lambda kind, text, given: None,
        )
        self.flight.assign(first_roles(self.plan))
        self.pos: FloatArray = self.flight.gather_ned_m.copy()
        self.start = self.pos.mean(axis=0)
        self.vel: FloatArray = np.zeros((2, 3))
        self.rng, self.drift, self.noise_m = np.random.default_rng(7), np.array([drift_m_s, 0.0, 0.0]), noise_m
        self.error: FloatArray = np.zeros((2, 3))
        self.now_s = 0.0
        self.flight.next_step(0, self.poses())

    def poses(self) -> Poses:
        return Poses(self.pos + self.error, self.vel, np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), NOBODY)

    def fly(self, seconds: float) -> float:
        """Flies on; returns how far the middle went at most."""
        farthest = 0.0
        for _ in range(round(seconds / TICK_S)):
            tick = self.flight.step(round(1e9 * self.now_s), self.poses())
            assert not tick.give_up
            self.vel = self.vel + TICK_S * (tick.vel_ned_m_s - self.vel)
            self.pos = self.pos + TICK_S * (self.vel + self.drift)
            self.error = 0.998 * self.error + 0.063 * self.noise_m * self.rng.normal(size=(2, 3))
            self.now_s += TICK_S
            farthest = max(farthest, float(np.linalg.norm(self.pos.mean(axis=0) - self.start)))
        return farthest


def test_a_heading_that_nobody_shows_is_not_kept() -> None:
    # Seen: uplinks gone for all in a formation that was done a moment later. The heading became 0, which nobody had.
    keeper = PlaceKeeper(rate_1_s=0.1, speed_limit_m_s=1.0)
    pos, points = np.array([[0.0, -1.0, 2.0], [0.0, 1.0, 2.0]]), np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    keeper.begin(pos, ~NOBODY)
    keeper.settle(pos, NOBODY, points)
    assert keeper.heading_rad is None
    motion = keeper.motion(pos, ~NOBODY, points)
    assert motion is not None
    assert motion.turn_rad_s == 0.0
    keeper.settle(pos, ~NOBODY, points)
    assert keeper.heading_rad == pytest.approx(np.pi / 2)


def test_a_team_that_a_drift_carries_off_keeps_its_place() -> None:
    assert Drifting().fly(60.0) < 0.8
    assert Drifting("keep_place_1_s=0").fly(40.0) > 1.0  # the law alone lets it go


def test_the_distances_do_not_know_that_the_place_is_kept() -> None:
    kept, law = Drifting(noise_m=0.0), Drifting("keep_place_1_s=0", noise_m=0.0)
    kept.fly(20.0)
    law.fly(20.0)
    assert kept.pos[1] - kept.pos[0] == pytest.approx(law.pos[1] - law.pos[0], abs=5e-3)


def test_an_hour_in_a_drift_with_errors_that_wander() -> None:
    rng = np.random.default_rng(3)
    pos = np.array([[0.0, 0.0, 3.0], [4.0, 0.0, 3.0], [4.0, 4.0, 3.0]])
    points, everybody = pos.copy(), np.ones(3, dtype=np.bool_)
    keeper = PlaceKeeper(0.1, 1.0)
    keeper.begin(pos, everybody)
    keeper.settle(pos, everybody, points)
    start, error, farthest, turned = pos.mean(axis=0), np.zeros((3, 3)), 0.0, 0.0
    for second in range(3600):
        error = 0.98 * error + 0.04 * rng.normal(size=(3, 3))  # 0.2 m, for a minute
        motion = keeper.motion(pos + error, everybody, points)
        assert motion is not None
        drift = 0.05 * np.array([np.cos(second / 600.0), np.sin(second / 600.0), 0.2])
        spin = 0.002 * np.stack([-(pos - pos.mean(0))[:, 1], (pos - pos.mean(0))[:, 0], np.zeros(3)], axis=1)
        pos = pos + motion.rigid(pos - pos.mean(axis=0)) + drift + spin
        farthest = max(farthest, float(np.linalg.norm(pos.mean(axis=0) - start)))
        turned = max(turned, abs(heading_of(pos, points)))
    assert farthest < 0.9
    assert turned < 0.15


def test_it_is_slow_and_the_same_for_all_and_nothing_when_it_is_off() -> None:
    pos = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0]])
    both = np.ones(2, dtype=np.bool_)
    keeper = PlaceKeeper(0.1, 0.5)
    assert keeper.motion(pos, both, pos) is None  # nothing to keep yet
    keeper.begin(pos, both)
    motion = keeper.motion(pos + np.array([50.0, 0.0, 0.0]), both, pos)
    assert motion is not None
    assert motion.vel_enu_m_s == pytest.approx([-SPEED_SHARE * 0.5, 0.0, 0.0])
    assert (motion.turn_rad_s, motion.growth_1_s, motion.scale) == (0.0, 0.0, 1.0)
    law = PlaceKeeper(0.0, 0.5)
    law.begin(pos, both)
    assert law.motion(pos + 1.0, both, pos) is None


def test_the_place_of_those_who_are_left_is_where_it_was() -> None:
    pos = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [5.0, 0.0, 2.0]])
    counts = np.ones(3, dtype=np.bool_)
    keeper = PlaceKeeper(0.1, 5.0)
    keeper.begin(pos, counts)
    off = np.array([0.3, 0.0, 0.0])
    before = keeper.motion(pos + off, counts, pos)
    counts[2] = False
    pos[2] = np.nan
    after = keeper.motion(pos + off, counts, np.nan_to_num(pos))
    assert before is not None
    assert after is not None
    assert after.vel_enu_m_s == pytest.approx(before.vel_enu_m_s)


def test_moves_shift_the_place_and_the_heading() -> None:
    team = Team("steps=[form: {}, move: {by_m: [0.5, 0.2, 0.1], turn_deg: 40}, hold: {seconds: 30}]")
    assert team.ends() == "move"
    start, points = team.pos.mean(axis=0), frames.enu_from_ned(team.pos)
    assert team.ends() == "hold"
    for _ in range(500):
        team.pos = team.pos + np.array([4e-4, 0.0, 0.0])  # carried off by 0.02 m/s
        tick = team.flight.step(team.now_ns, team.poses())
        team.vel = tick.vel_ned_m_s
        team.pos = team.pos + 0.02 * team.vel
        team.now_ns += 20_000_000
    moved = frames.enu_from_ned(team.pos.mean(axis=0) - start)
    assert moved == pytest.approx([0.5, 0.2, 0.1], abs=0.25)
    assert np.degrees(heading_of(frames.enu_from_ned(team.pos), points)) == pytest.approx(40.0, abs=2.0)


def test_a_formation_that_was_turned_as_one_turns_back() -> None:
    team = Team("steps.1.hold.seconds=60")
    assert team.ends() == "hold"
    points = frames.enu_from_ned(team.pos)
    middle = team.pos.mean(axis=0)
    cos, sin = np.cos(0.2), np.sin(0.2)
    team.pos = middle + (team.pos - middle) @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    assert abs(heading_of(frames.enu_from_ned(team.pos), points)) == pytest.approx(0.2, abs=1e-6)
    assert team.ends(15.0) == "nothing"
    assert abs(heading_of(frames.enu_from_ned(team.pos), points)) < 0.07
