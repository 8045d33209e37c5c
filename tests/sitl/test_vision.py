"""Flight without GPS: positions from outside, at which rates, in which messages."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from tests.sitl.virtual_ground import LAND, Ground, arducopter, world


def feeding(
    ground: Ground, name: str = "VISION_POSITION_ESTIMATE", every: int = 1, frame: int = 20
) -> Callable[[], None]:
    """What a motion capture bridge would send at 50 Hz (or every so many ticks): the truth, seen from (10, 20, 0)."""
    count = [0]

    def send() -> None:
        count[0] += 1
        if count[0] % every:
            return
        east, north, up = ground.world.truth.pos_enu_m[0]
        place = {"x": north - 10.0, "y": east - 20.0, "z": -up}
        stamp = (ground.now_ns - ground.start_ns) // 1000
        if name == "ODOMETRY":
            ground.send(name, time_usec=stamp, frame_id=frame, child_frame_id=12, q=(1, 0, 0, 0), **place)
        elif name == "ATT_POS_MOCAP":
            ground.send(name, time_usec=stamp, q=(1, 0, 0, 0), **place)
        else:
            ground.send(name, usec=stamp, **place)

    return send


@pytest.mark.parametrize(
    ("name", "frame", "every", "accepted"),
    [
        ("VISION_POSITION_ESTIMATE", 0, 1, True),
        ("ODOMETRY", 20, 1, True),
        ("ATT_POS_MOCAP", 0, 1, False),
        ("VISION_POSITION_ESTIMATE", 0, 10, False),  # 5 Hz: dropped without a word
    ],
)
def test_what_px4_fuses(name: str, frame: int, every: int, accepted: bool) -> None:
    ground = Ground(world(gps=False))
    ground.stream = feeding(ground, name, every, frame)
    ground.run(4.0)
    assert bool(ground.all("LOCAL_POSITION_NED")) == accepted
    assert ground.texts() == []
    assert ground.count()["GPS_RAW_INT"] == 0
    if accepted:
        local = ground.last("LOCAL_POSITION_NED")
        assert (local.x, local.y, local.z) == pytest.approx((-10.0, -20.0, 0.0), abs=1e-3)


def test_badly_stamped_samples_are_dropped() -> None:
    ground = Ground(world(gps=False))
    ground.run(3.0, lambda: ground.send("VISION_POSITION_ESTIMATE", usec=12345, x=1.0))
    assert ground.all("LOCAL_POSITION_NED") == []


def test_px4_ignores_vision_that_its_parameter_turns_off() -> None:
    ground = Ground(world(gps=False))
    ground.run(0.5)
    ground.send("PARAM_SET", target_system=1, param_id=b"EKF2_EV_CTRL", param_type=6, param_value=0.0)
    ground.run(3.0, feeding(ground))
    assert ground.all("LOCAL_POSITION_NED") == []


def test_px4_flies_by_vision_and_descends_when_it_is_lost() -> None:
    ground = Ground(world(gps=False))
    vision = feeding(ground)
    up = [-0.5]

    def both() -> None:
        vision()
        ground.velocity(vz=up[0])

    ground.run(3.0, vision)
    ground.run(0.1, both)
    ground.command(176, 1, 6)
    ground.command(400, 1)
    ground.run(8.0, both)
    up[0] = 0.0
    ground.run(2.0, both)
    height = ground.height()
    assert height > 1.5
    assert ground.last("LOCAL_POSITION_NED").z == pytest.approx(-height, abs=0.02)
    ground.run(3.0, ground.velocity)
    assert ground.last("HEARTBEAT").custom_mode == LAND
    assert (2, "Failsafe activated\t") in ground.texts()
    assert ground.height() < height - 0.5


@pytest.mark.parametrize(
    ("name", "frame", "accepted"),
    [
        ("VISION_POSITION_ESTIMATE", 0, True),
        ("VICON_POSITION_ESTIMATE", 0, True),
        ("ATT_POS_MOCAP", 0, True),
        ("ODOMETRY", 20, True),
        ("ODOMETRY", 1, False),  # only LOCAL_FRD
    ],
)
def test_what_arducopter_fuses_once_it_has_an_origin(name: str, frame: int, accepted: bool) -> None:
    ground = Ground(arducopter(gps=False))
    ground.run(0.5)
    for parameter, value in ((b"VISO_TYPE", 1.0), (b"EK3_SRC1_POSXY", 6.0)):
        ground.send("PARAM_SET", target_system=1, param_id=parameter, param_type=9, param_value=value)
    ground.interval("LOCAL_POSITION_NED", 20)
    ground.run(2.5, feeding(ground, name, 1, frame))
    assert ground.all("LOCAL_POSITION_NED") == []
    ground.send("SET_GPS_GLOBAL_ORIGIN", target_system=1, latitude=473977420, longitude=85455940, altitude=488000)
    ground.run(1.0, feeding(ground, name, 1, frame))
    assert bool(ground.all("LOCAL_POSITION_NED")) == accepted
    ground.run(0.04)
    assert ground.ask(176, 1, 4) == 0  # disarmed it takes the mode, with a position or without
    assert ground.ask(400, 1, 1) == (0 if accepted else 4)  # arming asks for the position


def test_without_gps_and_vision_offboard_cannot_be_armed() -> None:
    ground = Ground(world(gps=False))
    ground.run(3.0, ground.velocity)
    ground.stream = ground.velocity
    assert ground.ask(176, 1, 6) == 0
    assert ground.ask(400, 1) == 1
    assert math.isinf(ground.world.min_distance_airborne_m)
