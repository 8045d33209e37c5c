"""Vehicles whose own north and level are off: they fly what they are told turned by that, and do not know it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sitl.fleet import fleet
from sitl.own_frame import OwnFrameConfig, OwnFrames
from sitl.world import World, WorldConfig
from tests.sitl.virtual_ground import Ground, hovering

TURNED = OwnFrameConfig(heading_rad=math.radians(30.0), alike=True)


def _level_deg(ground: Ground) -> float:
    """True heading of a level vehicle, from north clockwise."""
    w, _, _, z = ground.world.truth.quat_ned_from_frd[0]
    return math.degrees(2.0 * math.atan2(z, w))


def test_frames_are_rotations_of_the_size_that_was_asked_for() -> None:
    config = OwnFrameConfig(heading_rad=0.4, level_rad=0.1)
    own = OwnFrames(config, 50, np.random.default_rng(3))
    for rot, heading in zip(own.rot_enu_from_own, own.heading_rad, strict=True):
        assert Rotation.from_matrix(rot).as_matrix() == pytest.approx(rot)  # it would mend a matrix that is none
        assert abs(heading) == pytest.approx(0.4)
        level = Rotation.from_matrix(rot) * Rotation.from_euler("z", -heading)
        assert level.magnitude() == pytest.approx(0.1)
        assert level.as_rotvec()[2] == pytest.approx(0.0, abs=1e-12)
    assert 10 < (own.heading_rad > 0).sum() < 40
    there = np.random.default_rng(1).normal(size=(3, 50))
    assert own.believed(own.flown(there)) == pytest.approx(there)
    by_scipy = np.array(
        [Rotation.from_matrix(rot).apply(x) for rot, x in zip(own.rot_enu_from_own, there.T, strict=True)]
    )
    assert own.flown(there) == pytest.approx(by_scipy.T)


def test_alike_means_one_frame_for_all() -> None:
    own = OwnFrames(OwnFrameConfig(0.4, 0.1, alike=True), 5, np.random.default_rng(3))
    assert np.ptp(own.rot_enu_from_own, axis=0).max() == 0.0
    assert own.heading_rad.tolist() == [0.4] * 5


def test_a_wrong_north_turns_what_is_flown_and_nothing_that_is_reported_of_it() -> None:
    ground = hovering(own_frames=TURNED)
    ground.run(6.0, each=lambda: ground.velocity(vx=0.8))
    true = ground.world.truth.vel_enu_m_s[0]
    # North was asked for. A vehicle that is turned to the left of what it believes flies to the left: north-west.
    assert math.degrees(math.atan2(-true[0], true[1])) == pytest.approx(30.0, abs=1.0)
    assert np.hypot(true[0], true[1]) == pytest.approx(0.8, abs=0.05)
    _, told = ground.all("LOCAL_POSITION_NED")[-1]
    assert (told.vy, told.vx) == pytest.approx((true[0], true[1]), abs=0.02)
    _, attitude = ground.all("ATTITUDE")[-1]
    assert math.degrees(attitude.yaw) == pytest.approx(30.0, abs=0.5)  # and in truth it faces north
    assert _level_deg(ground) == pytest.approx(0.0, abs=2.0)


def test_a_velocity_of_its_own_body_is_flown_along_its_true_nose() -> None:
    ground = hovering(own_frames=TURNED)
    ground.run(6.0, each=lambda: ground.velocity(vx=0.8, frame=8))
    east, north, _ = ground.world.truth.vel_enu_m_s[0]
    assert math.degrees(math.atan2(east, north)) == pytest.approx(0.0, abs=2.0)


def test_a_heading_that_is_asked_for_is_missed_by_as_much() -> None:
    ground = hovering(own_frames=TURNED)
    ground.run(6.0, each=lambda: ground.velocity(mask=0x09C7, yaw=0.0))
    _, attitude = ground.all("ATTITUDE")[-1]
    assert math.degrees(attitude.yaw) == pytest.approx(0.0, abs=1.0)
    assert _level_deg(ground) == pytest.approx(-30.0, abs=2.0)


def test_a_wrong_level_makes_level_flight_climb_or_sink() -> None:
    ground = hovering(own_frames=OwnFrameConfig(level_rad=math.radians(10.0), alike=True))
    own = ground.world.state.own_frames
    assert own is not None
    rot = own.rot_enu_from_own[0]
    uphill = rot.T[:2, 2] / np.hypot(*rot.T[:2, 2])  # the level direction of its own that leads upwards
    east, north = 0.8 * uphill
    ground.run(6.0, each=lambda: ground.velocity(vx=north, vy=east))
    assert ground.world.truth.vel_enu_m_s[0, 2] == pytest.approx(0.8 * math.sin(math.radians(10.0)), abs=0.02)


def test_a_place_is_reached_all_the_same() -> None:
    """What is held by position is corrected by position: on a bent way, as real ones do with a wrong compass."""
    ground = hovering(own_frames=OwnFrameConfig(math.radians(40.0), math.radians(5.0), alike=True))
    ground.run(12.0, each=lambda: ground.velocity(mask=0x0DF8, x=3.0, z=-4.0))
    assert ground.world.truth.pos_enu_m[0] == pytest.approx([0.0, 3.0, 4.0], abs=0.1)


def test_frames_are_drawn_from_a_generator_of_their_own() -> None:
    """Whoever flew a seed before has the same flight: all other numbers are the same with wrong frames and without."""

    def reports(own_frames: OwnFrameConfig | None) -> list[bytes]:
        team = World(WorldConfig(vehicles=fleet(3), own_frames=own_frames), 7)
        return [item.data for item in team.advance(5_000_000_000)]

    straight = reports(None)
    assert straight == reports(OwnFrameConfig())
    assert straight != reports(TURNED)
    ways = [World(WorldConfig(vehicles=fleet(8), own_frames=OwnFrameConfig(0.4)), seed) for seed in (1, 1, 2)]
    sides = [team.state.own_frames.heading_rad.tolist() for team in ways if team.state.own_frames is not None]
    assert sides[0] == sides[1] != sides[2]
