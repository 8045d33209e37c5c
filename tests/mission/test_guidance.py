"""Guidance around vehicles that nobody steers: the others make all the room."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.control import task_for_roles
from groundstation.mission.flight.guidance import Course, Guide
from groundstation.mission.flight.helm import Helm
from groundstation.mission.flight.poses import Poses
from groundstation.mission.plan.reading import load_mission

PLAN = load_mission(packaged_configs() / "missions" / "cube8.yaml")


def poses_of(first_m: list[float], second_m: list[float]) -> Poses:
    """Two vehicles that matter, the others far away from both and from each other."""
    pos = np.array([first_m, second_m, *([100.0 * k, 0.0, -1.0] for k in range(1, 7))])
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (8, 1))
    return Poses(pos, np.zeros((8, 3)), quat, np.zeros(8, dtype=np.bool_))


def settled(poses: Poses, target_m: list[float]) -> np.ndarray:
    """What the first vehicle is told once the slope of setpoints matters no more."""
    guide = Helm(Guide(PLAN), PLAN.size)
    targets = poses.pos_team_ned_m.copy()
    targets[0] = target_m
    for _ in range(100):
        told = guide.to_targets(poses, targets).vel_ned_m_s
    return np.asarray(told[0])


def test_an_obstacle_pushes_from_farther_and_twice_as_hard() -> None:
    near = poses_of([0.0, 0.0, -1.0], [0.6, 0.0, -1.0])
    assert abs(settled(near, [0.0, 0.0, -1.0])).max() < 1e-9
    extra = np.array([0.0, 0.25, *[0.0] * 6])
    obstacle = dataclasses.replace(near, extra_radius_m=extra)
    margin_m = PLAN.keep_out_margin_m
    pushed = settled(obstacle, [0.0, 0.0, -1.0])
    rate_1_s = 1.0 / (3 * (PLAN.profile.delay_s + 0.02) + PLAN.profile.lag_s)
    assert pushed[0] == pytest.approx(rate_1_s * (0.6 - 0.45 - margin_m - 0.25), abs=1e-6)
    # The obstacle's own row stays as it was: nobody steers it.
    assert abs(Helm(Guide(PLAN), PLAN.size).to_targets(obstacle, obstacle.pos_team_ned_m).vel_ned_m_s[1]).max() < 0.5


def test_a_fast_obstacle_is_seen_from_farther() -> None:
    far = poses_of([0.0, 0.0, -1.0], [3.7, 0.0, -1.0])
    vel = np.zeros((8, 3))
    vel[1, 0] = -5.0
    extra = np.array([0.0, 0.4, *[0.0] * 6])
    rushing = dataclasses.replace(far, vel_ned_m_s=vel, extra_radius_m=extra)
    assert settled(rushing, [0.0, 0.0, -1.0])[0] < -0.4


def test_one_that_comes_down_with_an_extra_radius_is_left_once_and_not_twice() -> None:
    """Beside its column; who is in it leaves as fast as it may."""
    beside_m = 0.6
    above = poses_of([0.0, 0.0, -1.0], [beside_m, 0.0, -2.0])
    sinking = np.zeros(8, dtype=np.bool_)
    sinking[1] = True
    extra = np.array([0.0, 0.2, *[0.0] * 6])
    falling = dataclasses.replace(above, sinking=sinking, extra_radius_m=extra)
    rate_1_s = 1.0 / (3 * (PLAN.profile.delay_s + 0.02) + PLAN.profile.lag_s)
    assert settled(falling, [0.0, 0.0, -1.0])[0] == pytest.approx(
        rate_1_s * (beside_m - 0.45 - PLAN.keep_out_margin_m - 0.2), abs=1e-6
    )


@pytest.mark.parametrize("height_m", [0.25, 0.41, 1.0])
def test_who_is_under_one_that_comes_down_leaves_at_full_speed_and_goes_down_where_there_is_room(
    height_m: float,
) -> None:
    above = poses_of([0.0, 0.0, -height_m], [0.02, 0.0, -height_m - 0.9])
    sinking = np.zeros(8, dtype=np.bool_)
    sinking[1] = True
    speed_m_s = PLAN.spec.speed_limit_m_s
    flees = settled(dataclasses.replace(above, sinking=sinking), [0.0, 0.0, -height_m - 1.0])
    assert np.linalg.norm(flees) == pytest.approx(speed_m_s, rel=0.02)
    assert flees[0] < -0.6 * speed_m_s  # away, though its target is straight above it
    floor_m = 0.5 * PLAN.min_altitude_m
    assert flees[2] >= 0.3 * min(speed_m_s, (height_m - floor_m) / 0.25)
    stays = settled(above, [0.0, 0.0, -height_m])
    assert abs(stays).max() < 1e-9


def test_who_flees_goes_no_lower_than_half_the_height_of_formation_flight() -> None:
    floor_m = 0.5 * PLAN.min_altitude_m
    helm, pos, vel = Helm(Guide(PLAN), PLAN.size), np.array([0.0, 0.0, -0.45]), np.zeros(3)
    sinking = np.zeros(8, dtype=np.bool_)
    sinking[1] = True
    heights = []
    for _ in range(150):
        # The one above follows, so that it has no end.
        poses = dataclasses.replace(poses_of(pos.tolist(), [*pos[:2].tolist(), -1.4]), sinking=sinking)
        poses.vel_ned_m_s[0] = vel
        told = helm.to_targets(poses, poses.pos_team_ned_m).vel_ned_m_s[0]
        vel = vel + 0.02 / PLAN.profile.lag_s * (told - vel)
        pos = pos + 0.02 * vel
        heights.append(-pos[2])
    assert floor_m - 0.02 < min(heights) < floor_m + 0.05


def test_extra_radii_belong_to_vehicles() -> None:
    poses = poses_of([0.0, 0.0, -1.0], [2.0, 0.0, -1.0])
    assert not poses.extra_radius_m.any()
    with pytest.raises(ValueError, match="extra_radius_m"):
        dataclasses.replace(poses, extra_radius_m=np.zeros(3))


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_large_teams_are_guided_as_small_ones_are(monkeypatch: pytest.MonkeyPatch, shape: str) -> None:
    """The same poses by all pairs and by search: obstacles, one that sinks and a fast one among them."""
    plan = load_mission(packaged_configs() / "missions" / "cube8.yaml", [f"avoidance.shape={shape}"])
    rng = np.random.default_rng(8)
    task = task_for_roles(plan.formation, plan.gains, np.arange(8))
    for _ in range(8):
        extra = np.where(rng.random(8) < 0.2, 0.3, 0.0)
        quat = rng.normal(0.0, 0.2, (8, 4)) + np.array([1.0, 0.0, 0.0, 0.0])
        poses = Poses(
            rng.uniform(-1.2, 1.2, (8, 3)) - np.array([0.0, 0.0, 1.5]),
            rng.normal(0.0, 0.5, (8, 3)),
            quat / np.linalg.norm(quat, axis=1)[:, None],
            np.asarray(rng.random(8) < 0.2, dtype=np.bool_),
            extra_radius_m=extra,
        )
        # In a small team the law takes those that sink where the avoidance takes them; in a large one it does not.
        calm = dataclasses.replace(poses, sinking=np.zeros(8, dtype=np.bool_))
        course = Course(plan.stages[0], plan.control_gain, plan.formation.points_enu_m)
        told = []
        for many in (64, 2):
            monkeypatch.setattr("groundstation.mission.flight.guidance._MANY", many)
            guide = Helm(Guide(plan), plan.size)
            for _ in range(10):
                formed = guide.formation(calm, task, course)
            told.append((formed, guide.to_targets(poses, np.zeros((8, 3)))))
        for by_pairs, by_search in zip(*told, strict=True):
            np.testing.assert_allclose(by_search.vel_ned_m_s, by_pairs.vel_ned_m_s, atol=1e-5)
            np.testing.assert_array_equal(by_search.blocked, by_pairs.blocked)
            near, seen = by_search.sensed.of_all(), by_search.sensed.of_all().visible
            np.testing.assert_array_equal(near.in_the_way, by_pairs.sensed.in_the_way)
            assert seen.any()
            assert not (seen & ~by_pairs.sensed.visible).any()
            np.testing.assert_allclose(near.rel_m[seen], by_pairs.sensed.rel_m[seen], atol=1e-9)
