"""Missions whose safety regions are no spheres: what they mean, what is refused, what the guidance makes of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from groundstation.core.errors import UserError
from groundstation.core.regions import SafetyCylinder, SafetyEllipsoid, SafetySphere
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.helm import Helm
from groundstation.mission.flight.poses import Poses
from groundstation.mission.plan.reading import plan_from_record
from tests.app.flights import FULL_RATE, cube8


def test_half_height_comes_from_the_mission_or_else_from_the_slowest_profile() -> None:
    assert cube8().region == SafetySphere(0.45, 0.5)
    assert cube8("avoidance.shape=cylinder").region == SafetyCylinder(0.45, 0.5, 0.75)
    assert cube8("avoidance={radius_m: 0.4, activation_m: 0.5, shape: ellipsoid, half_height_m: 0.6}").region == (
        SafetyEllipsoid(0.4, 0.5, 0.6)
    )
    big = ["avoidance.shape=ellipsoid", "formation_scale=9", "vehicles.3.profile=px4_quad", "fence.max_m=[9, 9, 19]"]
    assert cube8(*big, "fence.min_m=[-9, -9, 0]").region == SafetyEllipsoid(0.45, 0.5, 4.0)


def test_the_shape_is_in_the_record() -> None:
    plan = cube8("avoidance.shape=cylinder", "avoidance.half_height_m=0.6")
    again = plan_from_record(plan.record(), plan.gains_npz, "log")
    assert again.region == plan.region == SafetyCylinder(0.45, 0.5, 0.6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["avoidance.half_height_m=0.5"], "half_height_m belongs to shape: cylinder or ellipsoid"),
        (["avoidance.shape=cube"], "avoidance.shape: "),
        (["avoidance.shape=cylinder", "avoidance.half_height_m=0"], "avoidance.half_height_m: "),
        (
            ["avoidance.shape=cylinder", "avoidance.half_height_m=1.0"],
            "formation.points[4]: 0 m beside and 1 m above or below points[0], inside of the cylinder of"
            " avoidance.radius_m 0.45 m and half_height_m 1 m; scale the formation up",
        ),
        (
            ["avoidance.shape=cylinder", "vehicles.1.profile=px4_quad"],
            "inside of the cylinder of avoidance.radius_m 0.45 m and half_height_m 4 m",
        ),
        (
            ["avoidance.shape=ellipsoid", "vehicles.1.pad_m=[-0.8, -1.0, 0.0]"],
            "vehicles[1].pad_m: 0.2 m beside and 0 m above or below the pad of vehicles[0]",
        ),
        (
            ["avoidance.shape=cylinder", "avoidance.half_height_m=0.97"],
            "the cylinder cannot be kept with mocap positions: two of them may be 0.04 m off against each other, and"
            " around the cylinder there are 0.03 m of room in the formation cube8; lower radius_m or half_height_m",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_sizes_and_remedy(changes: list[str], message: str) -> None:
    with pytest.raises(UserError) as error:
        cube8(*changes)
    assert message in str(error.value)


@pytest.mark.parametrize("shape", ["cylinder", "ellipsoid"])
def test_who_comes_down_on_another_is_held_by_the_height_of_the_region_whatever_the_attitude(shape: str) -> None:
    """One right above another, 0.8 m: a sphere of 0.45 m would let it come down, a region of 0.75 m does not."""
    plan = cube8(FULL_RATE, f"avoidance.shape={shape}")
    pos = np.array([[0.0, 0.0, -1.0], [0.01, 0.0, -1.82], *([100.0 * k, 0.0, -1.0] for k in range(1, 7))])
    rng = np.random.default_rng(5)
    quat = rng.normal(0.0, 0.2, (8, 4)) + np.array([1.0, 0.0, 0.0, 0.0])
    poses = Poses(pos, np.zeros((8, 3)), quat / np.linalg.norm(quat, axis=1)[:, None], np.zeros(8, dtype=np.bool_))
    targets = pos.copy()
    targets[1, 2] = -1.4
    told: dict[str, float] = {}
    for mission in (plan, cube8(FULL_RATE)):
        guide = Helm(Guide(mission), mission.size)
        for _ in range(60):
            setpoints = guide.to_targets(poses, targets)
        told[mission.spec.avoidance.shape] = setpoints.vel_ned_m_s[1, 2]
    rate_1_s = 1.0 / (3 * (plan.profile.delay_s + 0.02) + plan.profile.lag_s)
    left_m = 0.82 - 0.75 - plan.keep_out_margin_m
    if shape == "cylinder":
        assert told[shape] <= 0.5 * rate_1_s * left_m + 1e-9
    assert 0.0 < told[shape] < 0.05 < told["sphere"]


def test_an_obstacle_is_avoided_in_the_shape_of_the_mission() -> None:
    plan = cube8(FULL_RATE, "avoidance.shape=cylinder")
    pos = np.array([[0.0, 0.0, -1.0], [0.05, 0.0, -1.9], *([100.0 * k, 0.0, -1.0] for k in range(1, 7))])
    poses = Poses(pos, np.zeros((8, 3)), np.tile([1.0, 0, 0, 0], (8, 1)), np.zeros(8, dtype=np.bool_))
    obstacle = dataclasses.replace(poses, extra_radius_m=np.array([0.0, 0.3, *[0.0] * 6]))
    told: dict[str, float] = {}
    for name, seen in (("plain", poses), ("obstacle", obstacle)):
        guide = Helm(Guide(plan), plan.size)
        for _ in range(60):
            setpoints = guide.to_targets(seen, pos)
        told[name] = setpoints.vel_ned_m_s[0, 2]
    rate_1_s = 1.0 / (3 * (plan.profile.delay_s + 0.02) + plan.profile.lag_s)
    assert told["plain"] == pytest.approx(0.0, abs=1e-9)
    assert told["obstacle"] == pytest.approx(
        rate_1_s * (0.75 + plan.keep_out_margin_m + 0.3 - 0.9), abs=1e-3
    )  # away: down
