"""Where the team is, in the air and on earth: a wrong sign or a wrong origin fails here in milliseconds."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.mavlink.vehicle import LANDED_IN_AIR, NEVER, Fleet
from groundstation.mission.flight.team_frame import TeamFrame
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS
from tests.app.flights import pair
from tests.mission.on_pads import EAST_5_M_DEG, HEIGHT_M, LAT_DEG, LON_DEG, NORTH_1_M_DEG, looked_at, standing

WEST, EAST = (0.0, -2.5, 0.0), (0.0, 2.5, 0.0)  # the pads, NED


@pytest.fixture(scope="module")
def plan() -> MissionPlan:
    """PX4, which tells its home in its own frame, and ArduCopter, which tells it on earth."""
    return pair()


def flying(plan: MissionPlan) -> Fleet:
    """Both hover 3 m above their pads; the frame of the second one begins 7 m higher, 1 m north and 2 m west of it."""
    fleet = standing(plan)
    fleet.landed_state[:] = LANDED_IN_AIR
    fleet.armed[:] = True
    fleet.home_deg_m[:] = fleet.place_deg_m
    fleet.home_local_ned_m[0] = (0.0, 0.0, 0.0)
    fleet.origin_deg_m[1] += (NORTH_1_M_DEG, -0.4 * EAST_5_M_DEG, 7.0)
    fleet.home_local_ned_m[1] = (99.0, 99.0, 99.0)  # its word for nothing
    fleet.pos_local_ned_m[:] = [(0.0, 0.0, -3.0), (-1.0, 2.0, 4.0)]
    fleet.place_deg_m[:, 2] += 3.0
    return fleet


def _looked(plan: MissionPlan, fleet: Fleet) -> TeamFrame:
    frame = TeamFrame(plan)
    frame.placement.look_in_flight(fleet, SECOND_NS)
    return frame


def _at(frame: TeamFrame, fleet: Fleet) -> list[tuple[float, ...]]:
    return [tuple(row) for row in frame.poses(fleet, SECOND_NS).pos_team_ned_m.round(2).tolist()]


def test_in_the_air_the_frame_hangs_on_where_the_first_one_took_off(plan: MissionPlan) -> None:
    fleet = flying(plan)
    frame = _looked(plan, fleet)
    np.testing.assert_allclose(
        frame.poses(fleet, SECOND_NS).pos_team_ned_m, [(0.0, -2.5, -3.0), (0.0, 2.5, -3.0)], atol=0.02
    )
    np.testing.assert_allclose(frame.home_off_pad_m(fleet), 0.0, atol=0.02)
    assert [frame.placement.known(vehicle) for vehicle in (0, 1)] == [True, True]


def test_who_took_off_elsewhere_is_that_far_from_its_pad_and_who_does_not_tell_is_nowhere(plan: MissionPlan) -> None:
    fleet = flying(plan)
    fleet.home_deg_m[1, 0] += 2.0 * NORTH_1_M_DEG
    frame = _looked(plan, fleet)
    np.testing.assert_allclose(frame.home_off_pad_m(fleet), [0.0, 2.0], atol=0.02)
    fleet.home_deg_m[1, :2] = fleet.place_deg_m[1, :2]
    fleet.home_deg_m[1, 2] += 3.0  # by GPS a height counts a third
    np.testing.assert_allclose(frame.home_off_pad_m(fleet), [0.0, 1.0], atol=0.02)
    fleet.home_deg_m[1] = np.nan
    assert np.isnan(frame.home_off_pad_m(fleet)).tolist() == [False, True]


def test_heights_are_settled_in_the_air_by_where_they_took_off(plan: MissionPlan) -> None:
    fleet = flying(plan)
    fleet.home_deg_m[1, 2] -= 1.5  # its own frame says that it took off 1.5 m lower than the first one
    frame = _looked(plan, fleet)
    assert _at(frame, fleet)[1][2] == pytest.approx(-3.0, abs=0.02)
    frame.settle_in_flight(fleet)
    np.testing.assert_allclose(frame.poses(fleet, SECOND_NS).pos_team_ned_m[:, 2], [-3.0, -4.5], atol=0.02)
    np.testing.assert_allclose(frame.poses(fleet, SECOND_NS).pos_team_ned_m[1, :2], EAST[:2], atol=0.02)
    fleet.origin_deg_m[:, 0] += 1.0  # settled: no origin is followed any more
    frame.placement.look_in_flight(fleet, 9 * SECOND_NS)
    np.testing.assert_allclose(frame.poses(fleet, SECOND_NS).pos_team_ned_m[0], (0.0, -2.5, -3.0), atol=0.02)
    # ENU: where a local position of zero lies, the second one's with the height that it was settled by.
    np.testing.assert_allclose(frame.local_origins_enu_m(), [(-2.5, 0.0, 0.0), (0.5, 1.0, 8.5)], atol=0.02)
    assert len(frame.words()) == 2
    assert frame.words()[1].startswith("vehicle 2: its local frame begins at ")


def test_where_the_first_one_tells_no_home_the_frame_hangs_on_the_next_one(plan: MissionPlan) -> None:
    fleet = flying(plan)
    fleet.home_deg_m[0] = np.nan
    frame = _looked(plan, fleet)
    np.testing.assert_allclose(
        frame.poses(fleet, SECOND_NS).pos_team_ned_m, [(0.0, -2.5, -3.0), (0.0, 2.5, -3.0)], atol=0.02
    )
    fleet.home_deg_m[1] = np.nan
    lost = _looked(plan, fleet)
    assert [lost.placement.known(vehicle) for vehicle in (0, 1)] == [False, False]


# By positions on earth


@pytest.fixture(scope="module")
def by_earth() -> MissionPlan:
    """The first one flies by global positions, the second one in its local frame."""
    return pair("vehicles.0.position=global")


def test_a_global_position_counts_from_the_anchor_and_is_brought_to_the_tick_by_its_own_velocity(
    by_earth: MissionPlan,
) -> None:
    fleet = standing(by_earth)
    frame = looked_at(by_earth, fleet)
    fleet.pos_local_ned_m[0] = fleet.vel_ned_m_s[0] = 50.0  # not what it flies by
    fleet.place_deg_m[0] = (LAT_DEG + 3.0 * NORTH_1_M_DEG, LON_DEG + 0.2 * EAST_5_M_DEG, HEIGHT_M + 2.0)
    fleet.place_vel_ned_m_s[0] = (1.0, -2.0, 0.5)
    poses = frame.poses(fleet, SECOND_NS + SECOND_NS // 5)
    np.testing.assert_allclose(poses.pos_team_ned_m, [(3.2, -1.9, -1.9), EAST], atol=0.02)
    np.testing.assert_array_equal(poses.vel_ned_m_s, [(1.0, -2.0, 0.5), (0.0, 0.0, 0.0)])
    long_ago = frame.poses(fleet, 9 * SECOND_NS).pos_team_ned_m[0]  # no further than its age may be
    np.testing.assert_allclose(long_ago, (3.5, -2.5, -1.75), atol=0.02)


def test_a_global_pose_is_as_old_as_its_global_position(by_earth: MissionPlan) -> None:
    fleet = standing(by_earth)
    frame = looked_at(by_earth, fleet)
    fleet.pose_ns[:], fleet.place_ns[:], fleet.attitude_ns[:] = (10, 20), (60, 5), (90, 90)
    assert frame.pose_ns(fleet).tolist() == [60, 20]
    fleet.attitude_ns[0] = NEVER
    assert frame.pose_ns(fleet)[0] == NEVER


def test_heights_by_global_positions_are_settled_on_the_pads_and_have_no_local_origin(by_earth: MissionPlan) -> None:
    fleet = standing(by_earth)
    frame = looked_at(by_earth, fleet)
    fleet.place_deg_m[0, 2] += 4.0
    off_m = frame.off_pad_m(frame.poses(fleet, SECOND_NS).pos_team_ned_m)
    np.testing.assert_allclose(off_m, [4.0 / 3.0, 0.0], atol=0.02)
    frame.settle(fleet, SECOND_NS)
    np.testing.assert_allclose(frame.poses(fleet, SECOND_NS).pos_team_ned_m, [WEST, EAST], atol=0.02)
    assert np.isnan(frame.local_origins_enu_m()).all(axis=1).tolist() == [True, False]
    for now_s in (1, 2, 3):
        fleet.place_ns[:] = fleet.pose_ns[:] = now_s * SECOND_NS
        drift_m = frame.drift_m(fleet, now_s * SECOND_NS)
    assert np.isnan(drift_m).tolist() == [True, False]  # it has one position only: nothing can disagree


def test_how_far_places_on_earth_are_from_the_pads_is_told_of_late_ones_alone(plan: MissionPlan) -> None:
    fleet = standing(plan)
    frame = looked_at(plan, fleet)
    fleet.place_deg_m[1, 0] += 20.0 * NORTH_1_M_DEG
    fleet.place_deg_m[1, 2] += 100.0  # horizontally
    np.testing.assert_allclose(frame.off_pad_on_earth_m(fleet, SECOND_NS, SECOND_NS), [0.0, 20.0], atol=0.02)
    fleet.place_ns[0] = 3 * SECOND_NS
    off_m = frame.off_pad_on_earth_m(fleet, 3 * SECOND_NS, SECOND_NS)
    assert np.isnan(off_m).tolist() == [False, True]
    fleet.place_ns[:] = 3 * SECOND_NS
    fleet.place_deg_m[1, :2] = (-LAT_DEG, LON_DEG - 180.0)  # right through the earth
    assert frame.off_pad_on_earth_m(fleet, 3 * SECOND_NS, SECOND_NS)[1] > 12e6


def test_two_positions_are_compared_where_the_global_one_was_measured(plan: MissionPlan) -> None:
    fleet = standing(plan)
    frame = looked_at(plan, fleet)
    fleet.vel_ned_m_s[1, 0] = 10.0
    for now_s in (21, 22):
        fleet.place_ns[:] = now_s * SECOND_NS
        fleet.pose_ns[:] = now_s * SECOND_NS - SECOND_NS // 10  # it has gone 1 m since that position
        drift_m = frame.drift_m(fleet, now_s * SECOND_NS)
    np.testing.assert_allclose(drift_m, [0.0, 1.0], atol=0.02)


def test_over_a_narrow_link_an_attitude_may_be_older_than_the_position() -> None:
    plan = pair("link_bytes_per_s={'udpin://0.0.0.0:14540': 1000}")
    assert [plan.rates_of(vehicle).lean for vehicle in (0, 1)] == [True, False]
    fleet = standing(plan)
    frame = looked_at(plan, fleet)
    late_ns = round(4.0 / plan.rates_of(0).attitude_hz * SECOND_NS)
    fleet.pose_ns[:], fleet.attitude_ns[:] = 10 * SECOND_NS, 9 * SECOND_NS
    assert frame.pose_ns(fleet).tolist() == [min(9 * SECOND_NS + late_ns, 10 * SECOND_NS), 9 * SECOND_NS]
    fleet.pose_ns[:] = 20 * SECOND_NS
    assert frame.pose_ns(fleet)[0] == 9 * SECOND_NS + late_ns


def test_a_frame_that_is_declared_to_be_the_teams_is_left_as_it_is() -> None:
    plan = pair("vehicles.1.origin=team")
    fleet = standing(plan)
    fleet.pos_local_ned_m[1] = (0.1, 2.4, 0.0)
    frame = looked_at(plan, fleet)
    frame.settle(fleet, SECOND_NS)
    np.testing.assert_allclose(frame.poses(fleet, SECOND_NS).pos_team_ned_m, [WEST, (0.1, 2.4, 0.0)], atol=0.02)
    assert [line[:10] for line in frame.words()] == ["vehicle 1:"]  # what the mission itself says is not told


def test_by_gps_a_frame_that_is_only_declared_is_shifted_to_the_pad_altogether() -> None:
    plan = pair("vehicles.1.origin=pad")
    fleet = standing(plan)
    frame = looked_at(plan, fleet)
    fleet.pos_local_ned_m[1] = (0.4, -0.3, 0.2)
    frame.settle(fleet, SECOND_NS)
    np.testing.assert_allclose(frame.poses(fleet, SECOND_NS).pos_team_ned_m, [WEST, EAST], atol=0.02)
    assert frame.words()[1].startswith("vehicle 2: its local frame begins at 2.800 -0.400 0.200 m")
