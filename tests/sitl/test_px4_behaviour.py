"""PX4's behaviour on the wire, row by row as the real one was seen to act."""

from __future__ import annotations

import math
import struct

import numpy as np
import pymap3d
import pytest

from sitl.estimator import GPS, NOISELESS
from sitl.frames import Array
from sitl.world import VehicleConfig, WorldConfig
from tests.sitl.virtual_ground import (
    LAND,
    LOITER,
    OFFBOARD,
    POSCTL,
    TAKEOFF_MODE,
    VELOCITY_YAW,
    VELOCITY_YAW_RATE,
    Ground,
    hovering,
    world,
)

ARMED = 0x80


def test_identity_and_readiness_by_default_within_two_seconds() -> None:
    ground = Ground(world(3))
    ground.run(3.2)
    for vehicle in range(3):
        beat = ground.last("HEARTBEAT", vehicle)
        assert (beat.get_srcSystem(), beat.get_srcComponent()) == (vehicle + 1, 1)
        assert (beat.type, beat.autopilot, beat.custom_mode) == (2, 12, LOITER)
        assert beat.system_status == 3
        first_position = ground.all("LOCAL_POSITION_NED", vehicle)[0][0]
        assert 1.0 <= first_position <= 1.5
        ready = [t for t, m in ground.all("SYS_STATUS", vehicle) if m.onboard_control_sensors_health & 0x10000000]
        assert 1.8 <= ready[0] <= 2.2


def test_its_estimator_flags_are_those_of_the_real_one_at_rest_and_in_the_air() -> None:
    """PX4 from 1.16 on sets constant position mode (0x80) whenever it stands still."""
    ground = Ground(world())
    ground.interval("ESTIMATOR_STATUS", 5.0)
    ground.run(5.0)
    assert ground.last("ESTIMATOR_STATUS").flags == 0x3FF
    ground = hovering()
    ground.interval("ESTIMATOR_STATUS", 5.0)
    ground.run(1.0, lambda: ground.velocity(z=0.0))
    assert ground.last("ESTIMATOR_STATUS").flags == 0x37F


def test_real_boot_takes_as_long_as_the_real_one() -> None:
    ground = Ground(world(4, real_boot=True))
    ground.run(8.0)
    for vehicle in range(4):
        assert 1.2 <= ground.all("LOCAL_POSITION_NED", vehicle)[0][0] <= 1.9
        assert 2.1 <= ground.all("HEARTBEAT", vehicle)[0][0] <= 3.1
        ready = [t for t, m in ground.all("SYS_STATUS", vehicle) if m.onboard_control_sensors_health & 0x10000000]
        assert 5.0 <= ready[0] <= 7.8


def test_onboard_link_streams_unasked_at_the_seen_rates() -> None:
    ground = Ground(world())
    ground.run(3.0)
    since = ground.t_s + 1e-6
    ground.run(10.0)
    count = ground.count(since_s=since)
    rates = {
        "ATTITUDE": 99, "ATTITUDE_QUATERNION": 50, "HIGHRES_IMU": 50, "GLOBAL_POSITION_INT": 50,
        "LOCAL_POSITION_NED": 30, "ODOMETRY": 30, "TIMESYNC": 10, "ALTITUDE": 10, "VFR_HUD": 10,
        "GPS_RAW_INT": 8, "SYS_STATUS": 5, "EXTENDED_SYS_STATE": 5, "HEARTBEAT": 1, "ESTIMATOR_STATUS": 1,
        "SYSTEM_TIME": 1, "BATTERY_STATUS": 0.5, "HOME_POSITION": 0.5, "ATTITUDE_TARGET": 10, "DISTANCE_SENSOR": 10,
        "SERVO_OUTPUT_RAW": 10, "MISSION_CURRENT": 1, "PING": 1, "SCALED_PRESSURE": 1, "VIBRATION": 0.5,
    }  # fmt: skip
    for name, hz in rates.items():
        assert count[name] == pytest.approx(10 * hz, abs=1), name
    # a target exists only while something is held
    assert set(count) - set(rates) <= {"POSITION_TARGET_LOCAL_NED"}


def test_position_target_streams_in_the_air() -> None:
    ground = hovering()
    assert len(ground.all("POSITION_TARGET_LOCAL_NED", since_s=ground.t_s - 1.0)) == pytest.approx(10, abs=1)


def test_message_interval_and_request() -> None:
    ground = Ground(world())
    ground.run(2.5)
    assert ground.ask(511, 32, 10_000) == 0  # LOCAL_POSITION_NED at 100 Hz
    assert ground.ask(511, 30, -1) == 0  # ATTITUDE off
    assert ground.ask(511, 331, 20_000, 0.0, 0.0) == 0
    assert ground.ask(511, 32, 20_000, 1.0) == 4  # param 3 must be 0
    assert ground.ask(511, 32, 20_000, 0.0, 5.0) == 4
    assert ground.ask(510, 32) == 0
    assert ground.last("MESSAGE_INTERVAL").interval_us == 10_000
    start = ground.t_s
    ground.run(2.0)
    assert len(ground.all("LOCAL_POSITION_NED", since_s=start)) == pytest.approx(200, abs=2)
    assert ground.all("ATTITUDE", since_s=start + 0.02) == []
    assert ground.ask(511, 30, 0) == 0  # back to the default
    start = ground.t_s
    ground.run(1.0)
    assert len(ground.all("ATTITUDE", since_s=start)) == pytest.approx(99, abs=2)
    assert ground.ask(512, 148) == 0
    version = ground.last("AUTOPILOT_VERSION")
    assert version.capabilities & 0x10  # parameters travel bytewise
    assert version.capabilities & 0x2000  # MAVLink 2
    assert ground.ask(512, 115) == 0
    assert ground.last("HIL_STATE_QUATERNION").lat == pytest.approx(473977420, abs=2)
    before = ground.t_s
    ground.command(512, 148, system=0)  # to everybody: no answer, as seen
    ground.run(0.1)
    assert ground.acks(since_s=before) == []


def test_unknown_command_is_unsupported() -> None:
    ground = Ground(world())
    ground.run(2.5)
    assert ground.ask(31010) == 3
    assert ground.ask(611) == 3  # SET_GLOBAL_ORIGIN


def test_commands_of_others_are_ignored() -> None:
    ground = Ground(world())
    ground.run(2.5)
    before = ground.t_s
    ground.command(400, 1, system=7)
    ground.run(0.2)
    assert ground.acks(since_s=before) == []
    assert not ground.world.truth.armed[0]


def test_arming_before_the_estimate_is_refused_with_words() -> None:
    ground = Ground(world())
    ground.run(0.5)
    assert ground.ask(400, 1) == 1
    texts = [text for _, text in ground.texts()]
    assert any(text.startswith("Preflight Fail: ") for text in texts)
    assert any(text.startswith("Arming denied: ") for text in texts)
    assert all(text.endswith("\t") for text in texts)
    ground.run(2.0)
    assert ground.ask(400, 1) == 0


def test_offboard_on_the_ground_without_setpoints_is_acked_and_then_arming_refused() -> None:
    ground = Ground(world())
    ground.run(2.5)
    assert ground.ask(176, 1, 6) == 0
    ground.run(1.0)
    beat = ground.last("HEARTBEAT")
    assert (beat.custom_mode, beat.system_status) == (OFFBOARD, 0)
    assert ground.ask(400, 1) == 1
    ground.run(0.2, ground.velocity)
    ground.stream = ground.velocity
    assert ground.ask(400, 1) == 0
    ground.run(1.0)
    beat = ground.last("HEARTBEAT")
    assert beat.base_mode & ARMED
    assert beat.system_status == 4


def test_offboard_in_the_air_without_setpoints_is_refused() -> None:
    ground = Ground(world())
    ground.run(2.5)
    assert ground.ask(22, 0, 0, 0, math.nan, math.nan, math.nan, math.nan) == 0
    assert ground.ask(400, 1) == 0
    ground.run(6.0)
    assert ground.height() > 1.5
    assert ground.ask(176, 1, 6) == 1
    ground.run(1.0)
    assert ground.last("HEARTBEAT").custom_mode == LOITER
    ground.stream = ground.velocity
    ground.run(0.1)
    assert ground.ask(176, 1, 6) == 0
    ground.run(1.0)
    assert ground.last("HEARTBEAT").custom_mode == OFFBOARD


def test_setpoints_stop_then_failsafe_sinks_lands_and_disarms_and_offboard_is_shown_again() -> None:
    ground = hovering(4.0)
    start_height, stopped_at = ground.height(), ground.t_s
    ground.stream = None
    ground.interval("EXTENDED_SYS_STATE", 50)
    ground.interval("HEARTBEAT", 50)
    ground.run(3.0)
    failsafe = [(t, m) for t, m in ground.all("STATUSTEXT", since_s=stopped_at) if m.text == "Failsafe activated\t"]
    assert len(failsafe) == 1
    assert failsafe[0][1].severity == 2
    assert failsafe[0][0] - stopped_at == pytest.approx(1.02, abs=0.041)  # last setpoint left a tick before
    beat = ground.last("HEARTBEAT")
    assert (beat.custom_mode, beat.system_status) == (POSCTL, 5)
    middle, at = ground.height(), ground.t_s
    ground.run(1.0)
    assert middle - ground.height() == pytest.approx(0.6, abs=0.02)
    assert start_height - ground.height() < 0.6 * (ground.t_s - failsafe[0][0]) + 0.05
    assert at > stopped_at
    ground.run_until(lambda: ground.last("EXTENDED_SYS_STATE").landed_state == 1, 12.0)
    landed_at = ground.t_s
    assert ground.world.truth.armed[0]
    ground.run_until(lambda: not ground.world.truth.armed[0], 3.0)
    assert ground.t_s - landed_at == pytest.approx(2.0, abs=0.05)
    ground.run(0.1)
    beat = ground.last("HEARTBEAT")
    assert beat.custom_mode == OFFBOARD  # the intention persists
    assert not beat.base_mode & ARMED


def test_offboard_comes_back_by_itself_when_setpoints_return() -> None:
    ground = hovering(4.0)
    ground.stream = None
    ground.run(2.5)
    assert ground.last("HEARTBEAT").custom_mode == POSCTL
    ground.stream = ground.velocity
    ground.run(2.0)
    beat = ground.last("HEARTBEAT")
    assert (beat.custom_mode, beat.system_status) == (OFFBOARD, 4)
    height = ground.height()
    ground.run(2.0)
    assert ground.height() == pytest.approx(height, abs=0.05)


def test_one_setpoint_a_second_is_just_enough() -> None:
    ground = hovering(4.0)
    since = ground.t_s
    ground.stream = None
    for _ in range(6):
        ground.velocity()
        ground.run(1.0)
    assert ground.texts(since_s=since) == []


def test_takeoff_command_counts_altitude_from_the_sea_and_switches_to_auto_takeoff() -> None:
    ground = Ground(world())
    ground.run(2.5)
    ground.interval("HEARTBEAT", 20)
    ground.interval("EXTENDED_SYS_STATE", 20)
    assert ground.ask(400, 1) == 0
    assert ground.ask(22, 0, 0, 0, math.nan, math.nan, math.nan, 488.0 + 3.0) == 0
    ground.run(1.5)
    assert ground.last("HEARTBEAT").custom_mode == TAKEOFF_MODE
    ground.run(0.5)
    assert ground.last("EXTENDED_SYS_STATE").landed_state == 3
    ground.run(8.0)
    assert ground.last("HEARTBEAT").custom_mode == LOITER
    assert ground.height() == pytest.approx(3.0, abs=0.05)
    assert ground.last("EXTENDED_SYS_STATE").landed_state == 2


def test_takeoff_without_altitude_takes_the_parameter_and_raises_lower_ones_to_it() -> None:
    for altitude in (math.nan, 488.5):
        ground = Ground(world())
        ground.run(2.5)
        assert ground.ask(400, 1) == 0
        assert ground.ask(22, 0, 0, 0, math.nan, math.nan, math.nan, altitude) == 0
        ground.run(9.0)
        assert ground.height() == pytest.approx(2.5, abs=0.05)
        assert any("takeoff altitude: 2.50 m" in text for _, text in ground.texts())


@pytest.mark.parametrize("way", ["mode", "command"])
def test_landing_states_times_and_disarming(way: str) -> None:
    ground = hovering(4.0, profile="px4_quad")
    ground.run(8.0, lambda: ground.velocity(mask=0x0DF8, z=-4.0))
    assert ground.height() == pytest.approx(4.0, abs=0.05)
    ground.stream = None
    ground.interval("EXTENDED_SYS_STATE", 50)
    begun = ground.t_s
    assert (ground.ask(176, 1, 4, 6) if way == "mode" else ground.ask(21)) == 0
    ground.run(1.2)
    assert ground.last("EXTENDED_SYS_STATE").landed_state == 4
    assert ground.last("HEARTBEAT").custom_mode == LAND
    ground.run_until(lambda: ground.last("EXTENDED_SYS_STATE").landed_state == 1, 12.0)
    assert ground.t_s - begun == pytest.approx(6.8, abs=0.35)  # seen: 6.8 s from 4 m
    landed = ground.t_s
    ground.run_until(lambda: not ground.world.truth.armed[0], 4.0)
    assert ground.t_s - landed == pytest.approx(2.0, abs=0.05)


def test_disarms_by_itself_when_it_does_not_take_off() -> None:
    ground = Ground(world())
    ground.run(2.5)
    assert ground.ask(400, 1) == 0
    armed = ground.t_s
    ground.run_until(lambda: not ground.world.truth.armed[0], 15.0)
    assert ground.t_s - armed == pytest.approx(10.8, abs=0.06)


def test_disarm_in_the_air_only_by_force_and_then_it_falls() -> None:
    ground = hovering(4.0)
    assert ground.ask(400, 0) == 1
    assert ground.world.truth.armed[0]
    height = ground.height()
    assert ground.ask(400, 0, 21196) == 0
    assert not ground.world.truth.armed[0]
    ground.run(0.36)
    fallen = height - ground.height()
    assert fallen == pytest.approx(0.5 * 9.80665 * 0.4**2, rel=0.1)


def test_forced_arming_skips_the_checks() -> None:
    ground = Ground(world())
    ground.run(0.5)
    assert ground.ask(400, 1, 21196) == 0
    assert ground.world.truth.armed[0]


def test_frames_other_than_local_and_body_count_as_no_setpoint() -> None:
    for frame in (7, 9):
        ground = hovering(4.0)
        since = ground.t_s
        ground.stream = lambda frame=frame, ground=ground: ground.velocity(frame=frame)
        ground.run(1.5)
        texts = ground.texts(since_s=since)
        assert (2, f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported\t") in texts
        assert (2, "Failsafe activated\t") in texts


def test_body_frame_velocity_is_turned_by_the_heading_alone() -> None:
    ground = hovering(4.0)
    # heading 90 degrees: east; forward is east, right is south
    ground.stream = lambda: ground.velocity(mask=VELOCITY_YAW, yaw=math.pi / 2)
    ground.run(4.0)
    assert ground.last("ATTITUDE").yaw == pytest.approx(math.pi / 2, abs=0.02)
    ground.stream = lambda: ground.velocity(1.0, 0.5, 0.0, frame=8)
    ground.run(3.0)
    position = ground.last("LOCAL_POSITION_NED")
    assert position.vy == pytest.approx(1.0, abs=0.03)
    assert position.vx == pytest.approx(-0.5, abs=0.03)
    assert position.vz == pytest.approx(0.0, abs=0.02)


def test_yaw_rate_turns_clockwise_seen_from_above() -> None:
    ground = hovering(4.0)
    before = ground.last("ATTITUDE").yaw
    ground.stream = lambda: ground.velocity(mask=VELOCITY_YAW_RATE, yaw_rate=0.5)
    ground.run(2.0)
    assert ground.last("ATTITUDE").yaw - before == pytest.approx(1.0, abs=0.1)
    assert ground.last("ATTITUDE").yawspeed == pytest.approx(0.5, abs=0.01)


def test_setpoints_to_others_are_ignored_and_to_nobody_accepted() -> None:
    ground = hovering(4.0)
    ground.stream = lambda: ground.velocity(1.0, system=9)
    since = ground.t_s
    ground.run(1.5)
    assert (2, "Failsafe activated\t") in ground.texts(since_s=since)
    ground.stream = lambda: ground.velocity(1.0, system=0)
    ground.run(2.0)
    assert ground.last("LOCAL_POSITION_NED").vx == pytest.approx(1.0, abs=0.05)


def test_position_setpoint_with_velocity_as_feed_forward_not_as_limit() -> None:
    ground = hovering(4.0)
    only_position = 0x0DF8
    ground.stream = lambda: ground.velocity(mask=only_position, x=3.0, y=-2.0, z=-4.0)
    ground.run(8.0)
    position = ground.last("LOCAL_POSITION_NED")
    assert (position.x, position.y, position.z) == pytest.approx((3.0, -2.0, -4.0), abs=0.05)
    both = 0x0DC0
    ground.stream = lambda: ground.velocity(0.2, 0.0, 0.0, mask=both, x=3.0, y=-2.0, z=-4.0)
    ground.run(6.0)
    # pull of the position loop and feed-forward balance: error = velocity / gain, and nothing limited the way back
    assert ground.last("LOCAL_POSITION_NED").x == pytest.approx(3.0 + 0.2 / 2.0, abs=0.02)


def test_origin_is_where_it_starts_and_home_is_something_else() -> None:
    vehicles = [
        VehicleConfig(1, noise=NOISELESS, pad_enu_m=(0.0, 0.0, 0.0)),
        VehicleConfig(2, noise=NOISELESS, pad_enu_m=(5.0, 0.0, 0.0)),
    ]
    ground = Ground(WorldConfig(vehicles=vehicles))
    ground.run(2.5)
    for vehicle in (0, 1):
        local = ground.last("LOCAL_POSITION_NED", vehicle)
        assert (local.x, local.y, local.z) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
        assert ground.ask(512, 49, vehicle=vehicle) == 0
    first, second = (ground.last("GPS_GLOBAL_ORIGIN", vehicle) for vehicle in (0, 1))
    assert second.longitude - first.longitude > 600  # 5 m east, in degE7
    # moving home moves nothing
    assert ground.ask(179, 0, 0, 0, 0, 47.4, 8.55, 500.0, vehicle=1) == 0
    ground.run(0.2)
    assert ground.last("LOCAL_POSITION_NED", 1).y == pytest.approx(0.0, abs=1e-6)
    assert ground.last("HOME_POSITION", 1).latitude == pytest.approx(474000000, abs=25)  # a float carries it
    # one origin for both: the second finds itself 5 m east of it
    ground.send(
        "SET_GPS_GLOBAL_ORIGIN", 1, target_system=2, latitude=first.latitude, longitude=first.longitude,
        altitude=first.altitude,
    )  # fmt: skip
    ground.run(0.2)
    local = ground.last("LOCAL_POSITION_NED", 1)
    assert (local.x, local.y, local.z) == pytest.approx((0.0, 5.0, 0.0), abs=0.01)


def test_timesync_both_ways_and_ping() -> None:
    ground = Ground(world())
    ground.run(2.0)
    ground.send("TIMESYNC", tc1=0, ts1=123456789)
    ground.send("PING", time_usec=42, seq=7)
    ground.run(0.1)
    answers = [m for _, m in ground.all("TIMESYNC") if m.tc1]
    assert [(m.ts1, m.tc1) for m in answers] == [(123456789, 2_004_000_000)]
    ping = ground.last("PING")
    assert (ping.time_usec, ping.seq, ping.target_system) == (42, 7, 255)
    asked = [m for _, m in ground.all("TIMESYNC", since_s=1.0) if not m.tc1]
    assert len(asked) == pytest.approx(11, abs=1)


def test_link_to_a_ground_station_and_telemetry_radio_stream_as_seen() -> None:
    for streams, rates in (
        ("gcs", {"LOCAL_POSITION_NED": 50, "GLOBAL_POSITION_INT": 50, "ATTITUDE": 50}),
        ("radio", {"LOCAL_POSITION_NED": 1}),
    ):
        ground = Ground(world(streams=streams))
        ground.run(3.0)
        since = ground.t_s + 1e-6
        ground.run(4.0)
        for name, hz in rates.items():
            assert ground.count(since_s=since)[name] == pytest.approx(4 * hz, abs=1)


def test_without_sticks_offboard_goes_on_only_while_it_is_excepted() -> None:
    ground = hovering(3.0)
    since = ground.t_s
    ground.send("PARAM_SET", target_system=1, param_id=b"COM_RCL_EXCEPT", param_type=6, param_value=0.0)
    ground.run(1.2)
    assert (2, "Failsafe activated\t") in ground.texts(since_s=since)
    assert ground.last("HEARTBEAT").custom_mode == 84148224  # AUTO.RTL


def test_lost_ground_station_counts_only_when_asked_for_and_then_any_heartbeat_does() -> None:
    ground = hovering(3.0)
    ground.send("HEARTBEAT", type=6, autopilot=8)
    ground.run(12.0)
    assert ground.last("HEARTBEAT").custom_mode == OFFBOARD  # NAV_DLL_ACT is off
    ground.send("PARAM_SET", target_system=1, param_id=b"NAV_DLL_ACT", param_type=6, param_value=2.8e-45)  # 2: return
    stranger = Ground(world(), sysid=17).encoder
    for _ in range(12):
        ground.world.receive(0, stranger.encode("HEARTBEAT", type=6, autopilot=8), ground.now_ns, "stranger")
        ground.run(1.0)
    first = [t for t, m in ground.all("HEARTBEAT") if m.custom_mode == 84148224]
    assert first == []
    ground.run(12.0)
    assert ground.last("HEARTBEAT").custom_mode == OFFBOARD  # a heartbeat is missed 2.5 s after the last
    ground.run(1.5)
    assert ground.last("HEARTBEAT").custom_mode == 50593792  # held for COM_FAIL_ACT_T, 5 s
    ground.run(6.0)
    assert ground.last("HEARTBEAT").custom_mode == 84148224


RTL_MODE = 84148224


def _set_whole(ground: Ground, name: bytes, value: int) -> None:
    bits = struct.unpack("<f", struct.pack("<i", value))[0]
    ground.send("PARAM_SET", target_system=1, param_id=name, param_type=6, param_value=bits)


@pytest.mark.parametrize("command", [20, 21])
def test_after_landing_the_mode_of_before_is_wanted_again(command: int) -> None:
    ground = hovering(3.0)
    ground.interval("HEARTBEAT", 50)
    assert ground.ask(command) == 0
    ground.run(0.1)
    assert ground.last("HEARTBEAT").custom_mode == {20: RTL_MODE, 21: LAND}[command]
    ground.run_until(lambda: not ground.world.truth.armed[0], 20.0)
    ground.run(0.1)
    beat = ground.last("HEARTBEAT")
    assert (beat.custom_mode, beat.system_status) == (OFFBOARD, 3)
    assert ground.ask(400, 1) == 0  # the setpoints still come


def test_takeoff_and_landing_by_command_can_be_flown_again_and_again() -> None:
    ground = Ground(world())
    ground.run(2.5)
    for _ in range(2):
        assert ground.ask(400, 1) == 0
        assert ground.ask(22, 0, 0, 0, math.nan, math.nan, math.nan, math.nan) == 0
        ground.run_until(lambda: ground.height() > 2.4, 12.0)
        ground.run(1.0)
        assert ground.ask(21) == 0
        ground.run_until(lambda: not ground.world.truth.armed[0], 20.0)
        ground.run(1.1)
        assert ground.last("HEARTBEAT").custom_mode == LOITER


@pytest.mark.parametrize("name", [b"NAV_DLL_ACT", b"NAV_RCL_ACT"])
def test_a_failsafe_that_holds_keeps_its_height(name: bytes) -> None:
    ground = hovering(4.0)
    ground.send("HEARTBEAT", type=6, autopilot=8)
    since = ground.t_s
    if name == b"NAV_RCL_ACT":
        _set_whole(ground, b"COM_RCL_EXCEPT", 0)
    _set_whole(ground, name, 1)
    ground.run(14.0)
    beat = ground.last("HEARTBEAT")
    assert (beat.custom_mode, beat.system_status) == (LOITER, 5)
    assert (2, "Failsafe activated\t") in ground.texts(since_s=since)
    height = ground.height()
    ground.run(3.0)
    assert ground.height() == pytest.approx(height, abs=0.05)
    assert height > 3.0


def _local_errors(ground: Ground, places: Array) -> Array:
    """LOCAL_POSITION_NED minus true places (NED), shape (n, 3)."""
    local = [ground.last("LOCAL_POSITION_NED", vehicle) for vehicle in range(len(places))]
    return np.array([(m.x, m.y, m.z) for m in local]) - places


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_eight_given_one_origin_agree_with_their_true_places(seed: int) -> None:
    ground = Ground(world(8, noise=GPS, streams="gcs"), seed)
    ground.run(2.5)
    places = np.array([(0.0, 5.0 * vehicle, 0.0) for vehicle in range(8)])
    for vehicle in range(8):
        ground.send(
            "SET_GPS_GLOBAL_ORIGIN", vehicle, target_system=vehicle + 1, latitude=473977420, longitude=85455940,
            altitude=488000,
        )  # fmt: skip
    ground.run(0.3)
    errors = _local_errors(ground, places)
    # 0.12 m on each axis: one of the eight may be further off, the team as a whole is not
    assert 0.03 < float(np.sqrt(np.mean(errors**2))) < 0.2
    assert float(np.abs(errors).max()) < 0.45


def test_origins_from_gps_are_off_by_decimetres_and_by_no_more_than_was_seen() -> None:
    ground = Ground(world(8, noise=GPS, streams="gcs"), 1)
    ground.run(2.5)
    offsets = []
    for vehicle in range(8):
        assert ground.ask(512, 49, vehicle=vehicle) == 0
        m = ground.last("GPS_GLOBAL_ORIGIN", vehicle)
        east, north, up = pymap3d.geodetic2enu(
            m.latitude * 1e-7, m.longitude * 1e-7, m.altitude * 1e-3, 47.397742, 8.545594, 488.0
        )
        offsets.append((east - 5.0 * vehicle, north, up))
    off = np.abs(np.array(offsets))
    assert off[:, :2].max() <= 0.52  # a step of the message's own units on top
    assert off[:, 2].max() <= 0.61
    assert off[:, :2].mean() > 0.08
    assert off[:, 2].mean() > 0.1


def test_it_lifts_off_when_thrust_has_grown_and_says_so_before_and_says_when_it_lands() -> None:
    ground = Ground(world())
    ground.run(2.5)
    ground.interval("EXTENDED_SYS_STATE", 50)
    ground.stream = lambda: ground.velocity(vz=-1.0)
    ground.run(0.1)
    assert ground.ask(176, 1, 6) == 0
    assert ground.ask(400, 1) == 0
    armed_s = ground.t_s
    ground.run_until(lambda: ground.height() > 0.03, 6.0)
    assert ground.t_s - armed_s == pytest.approx(3.1, abs=0.25)  # 3.05 s recorded
    told = [t for t, message in ground.all("STATUSTEXT") if message.text == "Takeoff detected\t"]
    aloft = [t for t, message in ground.all("EXTENDED_SYS_STATE") if message.landed_state == 2]
    assert told[0] - armed_s == pytest.approx(1.9, abs=0.1)  # 1.83 to 2.0 s recorded
    assert aloft[0] - told[0] < 0.05
    ground.run(3.0)
    ground.stream = None
    assert ground.ask(21) == 0
    ground.run_until(lambda: not ground.world.truth.armed[0], 20.0)
    words = [text for _, text in ground.texts()]
    order = ["Takeoff detected\t", "Landing at current position\t", "Landing detected\t", "Disarmed by landing\t"]
    assert [text for text in words if text in order] == order


def test_in_its_own_simulator_it_counts_time_slowly_and_lands_slowly() -> None:
    ground = Ground(world(profile="px4_sih"))
    ground.run(5.0)
    first = ground.last("ATTITUDE").time_boot_ms
    ground.run(10.0)
    assert ground.last("ATTITUDE").time_boot_ms - first == pytest.approx(9_870, abs=15)
