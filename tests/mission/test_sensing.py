"""What the law is shown by limited sensors: memory, waiting, what is told; and that avoidance sees all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.control import task_for_roles
from groundstation.core.types import FloatArray
from groundstation.mission.flight.guidance import Course, Guide
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.sensing import Sensing
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.plan.sensing_spec import SensingSpec

PLAN = load_mission(packaged_configs() / "missions" / "cube8.yaml")
IDS = (11, 12, 13)
LINE = ~np.eye(3, dtype=np.bool_) & (np.abs(np.subtract.outer(np.arange(3), np.arange(3))) == 1)
SECOND = 1_000_000_000


def _poses(*places_ned_m: tuple[float, float, float]) -> Poses:
    n = len(places_ned_m)
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))  # facing north: x forward, y to the left
    return Poses(np.array(places_ned_m), np.zeros((n, 3)), quat, np.zeros(n, dtype=np.bool_))


def _sensing(told: list[str], **keys: object) -> Sensing:
    return Sensing(SensingSpec.model_validate(keys), IDS, told.append)


NEAR = _poses((0.0, 0.0, -1.0), (1.0, 0.0, -1.0), (2.0, 0.0, -1.0))
FAR = _poses((0.0, 0.0, -1.0), (1.0, 0.0, -1.0), (2.0, -3.0, -1.0))


def test_without_limits_the_law_is_shown_its_neighbours() -> None:
    sight = _sensing([]).look(0, NEAR, LINE)
    assert (sight.views.visible == LINE).all()
    assert sight.views.rel_pos_flu_m[0, 1] == pytest.approx([1.0, 0.0, 0.0])
    assert not np.isfinite(sight.views.rel_pos_flu_m[0, 2]).any()  # no neighbour, though it is near
    assert not sight.waits.any()


def test_who_lacks_a_neighbour_waits_and_the_others_go_on() -> None:
    sight = _sensing([], range_m=1.5).look(0, FAR, LINE)
    assert sight.waits.tolist() == [False, True, True]
    assert not _sensing([], range_m=1.5, unseen="leave_out").look(0, FAR, LINE).waits.any()


def test_a_neighbour_is_remembered_where_it_was_for_as_long_as_was_said() -> None:
    sensing = _sensing([], range_m=1.5, memory_s=1.0)
    sensing.look(0, NEAR, LINE)
    moved = replace(FAR, pos_team_ned_m=FAR.pos_team_ned_m + np.array([0.0, 0.5, 0.0]), vel_ned_m_s=np.ones((3, 3)))
    sight = sensing.look(SECOND, moved, LINE)
    assert not sight.waits.any()
    # It stood one metre north of where the second one was; that one has gone half a metre to the east since.
    assert sight.views.rel_pos_flu_m[1, 2] == pytest.approx([1.0, 0.5, 0.0])
    assert sight.views.rel_vel_flu_m_s[1, 2] == pytest.approx([-1.0, 1.0, 1.0])  # taken to be at rest
    assert sensing.look(SECOND + 1, moved, LINE).waits.tolist() == [False, True, True]


def test_who_has_missed_a_neighbour_for_long_is_told_once() -> None:
    told: list[str] = []
    sensing = _sensing(told, range_m=1.5)
    for k in range(120):
        sensing.look(k * SECOND // 10, FAR, LINE)
    assert len(told) == 2
    assert told[0].startswith("vehicle 12 has not sensed all neighbours at once for 5 s, not at this moment 13 (3.16 m")
    assert told[0].endswith("it waits")
    sensing.look(13 * SECOND, NEAR, LINE)
    for k in range(140, 260):
        sensing.look(k * SECOND // 10, FAR, LINE)
    assert len(told) == 4  # it had them again in between


def test_a_turned_sensor_turns_what_the_law_is_shown() -> None:
    sight = _sensing([], heading_deg=90.0).look(0, NEAR, LINE)
    assert np.abs(sight.views.rel_pos_flu_m[0, 1]) == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)


def test_avoidance_keeps_clear_of_those_whom_nobody_senses() -> None:
    """Two that fly at each other with sensors that see nothing are told the same as with sensors that see all."""
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (8, 1))
    rng = np.random.default_rng(2)
    pos = rng.uniform([-0.8, -0.8, -2.8], [0.8, 0.8, -1.2], (8, 3))
    poses = Poses(pos, rng.uniform(-0.3, 0.3, (8, 3)), quat, np.zeros(8, dtype=np.bool_))
    task = task_for_roles(PLAN.formation, PLAN.gains, np.arange(8))
    blind = Sensing(SensingSpec(range_m=0.01, unseen="leave_out"), range(8), lambda _: None)
    course = Course(PLAN.stages[0], PLAN.control_gain, PLAN.formation.points_enu_m)
    sight = blind.look(0, poses, task.neighbours)
    assert not sight.views.visible.any()

    def told(course: Course, without_law: bool) -> FloatArray:
        gains = replace(task, gains_xy=0 * task.gains_xy, gains_z=0 * task.gains_z, rise_m=task.rise_m)
        of = gains if without_law else task
        return Guide(PLAN).formation(poses, of, course, np.zeros((8, 3))).vel_ned_m_s

    blind_told = told(replace(course, sight=sight), without_law=False)
    assert np.abs(blind_told).max() > 0.01  # too near to each other: the damper moves them apart
    alone = replace(course, sight=replace(sight, waits=np.ones(8, dtype=np.bool_)))
    assert told(alone, without_law=True) == pytest.approx(blind_told)
    assert np.abs(told(course, without_law=False) - blind_told).max() > 0.01  # with sensors the law is in it
