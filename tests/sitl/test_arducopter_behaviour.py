"""ArduCopter's behaviour on the wire, row by row as the real one was seen to act."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import pytest

from tests.sitl.virtual_ground import APM_LAND, GUIDED, VELOCITY_YAW, Ground, arducopter, guided_at

ARMED = 0x80


def test_unasked_it_sends_heartbeat_texts_and_timesync_after_bytes_that_are_no_mavlink() -> None:
    ground = Ground(arducopter())
    ground.run(12.0)
    assert set(ground.count()) == {"HEARTBEAT", "STATUSTEXT", "TIMESYNC"}
    assert ground.noise
    assert ground.noise[0].startswith(b"\r\n\r\nInit ArduCopter")
    beat = ground.last("HEARTBEAT")
    assert (beat.type, beat.autopilot, beat.custom_mode, beat.system_status) == (2, 3, 0, 3)
    assert not any(text.endswith("\t") for _, text in ground.texts())


def test_streams_on_request_by_interval_and_by_group_which_has_no_ack() -> None:
    ground = Ground(arducopter())
    ground.run(2.5)
    assert ground.ask(511, 32, 20_000) == 0
    start = ground.t_s
    ground.send(
        "REQUEST_DATA_STREAM", target_system=1, target_component=1, req_stream_id=10, req_message_rate=25, start_stop=1
    )
    ground.run(2.0)
    assert len(ground.all("LOCAL_POSITION_NED", since_s=start)) == pytest.approx(100, abs=1)
    assert len(ground.all("ATTITUDE", since_s=start)) == pytest.approx(50, abs=1)
    assert ground.acks(since_s=start) == []
    ground.send(
        "REQUEST_DATA_STREAM", target_system=1, target_component=1, req_stream_id=0, req_message_rate=4, start_stop=1
    )
    ground.run(1.0)
    assert {"SYS_STATUS", "VFR_HUD", "EKF_STATUS_REPORT", "RAW_IMU", "RC_CHANNELS"} <= set(ground.count())


def test_real_boot_heartbeat_origin_stabilize_then_guided_after_forty_seconds() -> None:
    ground = Ground(arducopter(real_boot=True))
    ground.run(2.5)
    assert 1.9 <= ground.all("HEARTBEAT")[0][0] <= 2.2
    assert ground.ask(176, 1, GUIDED) == 0  # at 2 s: acknowledged ...
    ground.interval("LOCAL_POSITION_NED", 10)
    ground.interval("GPS_GLOBAL_ORIGIN", 10)
    ground.run(2.0)
    assert ground.last("HEARTBEAT").custom_mode == 0  # ... and never in effect
    assert ground.ask(176, 1, GUIDED) == 0  # at 4.5 s, disarmed: acknowledged ...
    ground.run(1.5)
    assert ground.last("HEARTBEAT").custom_mode == GUIDED  # ... and shown, long before there is a position
    assert ground.ask(176, 1, 0) == 0
    ground.run(17.0)
    assert ground.ask(400, 1) == 4
    assert any(text.startswith("PreArm: ") for _, text in ground.texts())
    ground.run(2.0)
    assert ground.ask(400, 1) == 0
    assert ground.ask(176, 1, GUIDED) == 4
    assert (4, "Mode change to GUIDED failed: requires position") in ground.texts()
    assert 20.5 <= ground.all("GPS_GLOBAL_ORIGIN")[0][0] <= 21.7
    assert ground.ask(400, 0) == 0
    ground.run(17.6)
    assert ground.ask(176, 1, GUIDED) == 0
    assert 41.4 <= ground.all("LOCAL_POSITION_NED")[0][0] <= 42.7


def test_refused_arming_is_result_4_with_the_reason() -> None:
    ground = Ground(arducopter())
    ground.run(0.5)
    assert ground.ask(400, 1) == 4
    assert [text for severity, text in ground.texts() if severity == 2][-1].startswith("PreArm: ")
    ground.run(2.0)
    assert ground.ask(176, 1, APM_LAND) == 0
    assert ground.ask(400, 1) == 4
    assert ground.texts()[-1] == (2, "Arm: LAND mode not armable")
    assert ground.ask(176, 1, 77) == 4


def test_takeoff_only_when_guided_and_armed_height_above_home() -> None:
    ground = Ground(arducopter())
    ground.run(2.5)
    assert ground.ask(22, 0, 0, 0, 0, 0, 0, 3.0) == 4  # neither
    assert ground.ask(176, 1, GUIDED) == 0
    assert ground.ask(22, 0, 0, 0, 0, 0, 0, 3.0) == 4  # not armed
    assert ground.ask(400, 1) == 0
    assert ground.ask(22, 0, 0, 0, 0, 0, 0, 3.0) == 0
    ground.interval("EXTENDED_SYS_STATE", 20)
    ground.run(3.0)
    assert ground.last("EXTENDED_SYS_STATE").landed_state == 1  # motors spool up: lift-off was seen 3.5 s after arming
    ground.run(1.0)
    assert ground.last("EXTENDED_SYS_STATE").landed_state == 3
    ground.run(6.0)
    assert ground.height() == pytest.approx(3.0, abs=0.1)
    assert ground.last("EXTENDED_SYS_STATE").landed_state == 2
    assert ground.last("HEARTBEAT").custom_mode == GUIDED
    assert ground.last("HEARTBEAT").base_mode & ARMED


def test_upward_velocity_alone_does_not_lift_off() -> None:
    ground = Ground(arducopter())
    ground.run(2.5)
    assert ground.ask(176, 1, GUIDED) == 0
    assert ground.ask(400, 1) == 0
    ground.run(4.0, lambda: ground.velocity(vz=-1.0))
    assert ground.height() == 0.0
    assert ground.world.truth.armed[0]


def test_guided_needs_no_setpoints_before() -> None:
    ground = guided_at(3.0)
    ground.run(5.0)
    assert ground.last("HEARTBEAT").custom_mode == GUIDED
    assert ground.height() == pytest.approx(3.0, abs=0.1)


def test_disarms_by_itself_after_ten_seconds_and_on_landing() -> None:
    ground = Ground(arducopter())
    ground.run(2.5)
    assert ground.ask(400, 1) == 0
    armed = ground.t_s
    ground.run_until(lambda: not ground.world.truth.armed[0], 12.0)
    assert ground.t_s - armed == pytest.approx(10.0, abs=0.1)
    ground = guided_at(3.0)
    assert ground.ask(21) == 0
    ground.run(1.0)
    assert ground.last("EXTENDED_SYS_STATE").landed_state == 4
    assert ground.last("HEARTBEAT").custom_mode == APM_LAND
    ground.run_until(lambda: ground.last("EXTENDED_SYS_STATE").landed_state == 1, 12.0)
    assert ground.world.truth.armed[0]
    ground.run(0.6)  # 0.5 s were seen
    assert not ground.world.truth.armed[0]


def test_disarm_in_the_air_is_result_4_and_by_force_stops_the_motors() -> None:
    ground = guided_at(4.0)
    assert ground.ask(400, 0) == 4
    assert ground.world.truth.armed[0]
    assert ground.ask(400, 0, 21196) == 0
    before = ground.height()
    ground.run(0.4)
    assert before - ground.height() > 0.7


def test_setpoints_stop_then_the_last_velocity_is_kept_for_three_seconds_and_it_brakes_without_a_word() -> None:
    ground = guided_at(4.0)
    ground.run(3.0, lambda: ground.velocity(1.5))
    stopped, at = ground.t_s, float(ground.world.truth.pos_enu_m[0, 1])
    ground.run(2.9)
    assert ground.last("LOCAL_POSITION_NED").vx == pytest.approx(1.5, abs=0.05)
    ground.run(4.0)
    assert ground.last("LOCAL_POSITION_NED").vx == pytest.approx(0.0, abs=0.05)
    assert float(ground.world.truth.pos_enu_m[0, 1]) - at == pytest.approx(5.0, rel=0.2)
    assert ground.last("HEARTBEAT").custom_mode == GUIDED
    assert ground.texts(since_s=stopped) == []


@pytest.mark.parametrize("frame", [1, 7, 8, 9])
def test_frames_1_7_8_9_and_body_turned_by_the_heading(frame: int) -> None:
    ground = guided_at(4.0)
    ground.run(4.0, lambda: ground.velocity(mask=VELOCITY_YAW, yaw=math.pi / 2))  # facing east
    ground.run(3.0, lambda: ground.velocity(1.0, 0.5, frame=frame))
    position = ground.last("LOCAL_POSITION_NED")
    expected = (1.0, 0.5) if frame in (1, 7) else (-0.5, 1.0)
    assert (position.vx, position.vy) == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize(
    "change",
    [{"frame": 2}, {"vy": math.nan}, {"vx": 1001.0}, {"mask": 0x0DC7 | 0x10}],
    ids=["another frame", "NaN", "too fast", "one axis ignored ignores the triple"],
)
def test_what_stops_the_vehicle(change: dict[str, Any]) -> None:
    ground = guided_at(4.0)
    ground.run(2.5, lambda: ground.velocity(1.0))
    assert ground.last("LOCAL_POSITION_NED").vx > 0.8
    fields: dict[str, Any] = {"vx": 1.0, "vy": 0.0, **change}
    ground.run(2.5, lambda: ground.velocity(**fields))
    assert abs(ground.last("LOCAL_POSITION_NED").vx) < 0.1


def test_wrong_system_is_ignored_and_system_0_accepted() -> None:
    ground = guided_at(4.0)
    ground.run(2.0, lambda: ground.velocity(1.0, system=7))
    assert abs(ground.last("LOCAL_POSITION_NED").vx) < 0.02
    ground.run(2.5, lambda: ground.velocity(1.0, system=0))
    assert ground.last("LOCAL_POSITION_NED").vx > 0.9
    before = ground.t_s
    ground.command(512, 148, system=0)
    ground.run(0.1)
    assert ground.acks(since_s=before) == [(512, 0)]


def test_position_setpoint_goes_there() -> None:
    ground = guided_at(4.0)
    ground.run(10.0, lambda: ground.velocity(mask=0x0DF8, x=2.0, y=-1.0, z=-5.0))
    position = ground.last("LOCAL_POSITION_NED")
    assert (position.x, position.y, position.z) == pytest.approx((2.0, -1.0, -5.0), abs=0.1)


def test_origin_is_ignored_once_set() -> None:
    ground = Ground(arducopter())
    ground.run(2.5)
    assert ground.ask(512, 49) == 0
    before = ground.last("GPS_GLOBAL_ORIGIN").longitude
    ground.send("SET_GPS_GLOBAL_ORIGIN", target_system=1, latitude=473977420, longitude=before + 664, altitude=488000)
    ground.run(0.1)
    assert ground.ask(512, 49) == 0
    assert ground.last("GPS_GLOBAL_ORIGIN").longitude == before


def test_without_gps_the_origin_comes_from_the_ground_station_and_bad_values_fail_silently() -> None:
    ground = Ground(arducopter(gps=False))
    ground.run(3.0)
    ground.interval("GPS_GLOBAL_ORIGIN", 10)
    ground.send("SET_GPS_GLOBAL_ORIGIN", target_system=1, latitude=999999999, longitude=0, altitude=0)
    ground.run(0.5)
    assert ground.count()["GPS_GLOBAL_ORIGIN"] == 0
    ground.send("SET_GPS_GLOBAL_ORIGIN", target_system=1, latitude=473977420, longitude=85455940, altitude=488000)
    ground.run(0.5)
    assert ground.last("GPS_GLOBAL_ORIGIN").latitude == 473977420


def test_only_the_known_ground_station_counts_for_its_failsafe() -> None:
    ground = guided_at(4.0)
    ground.send(
        "PARAM_SET", target_system=1, target_component=1, param_id=b"FS_GCS_ENABLE", param_value=1.0, param_type=9
    )
    for _ in range(3):
        ground.send("HEARTBEAT", type=6, autopilot=8)
        ground.run(1.0)
    stranger = Ground(arducopter(), sysid=42)
    heartbeat = stranger.encoder.encode("HEARTBEAT", type=6, autopilot=8)
    for _ in range(6):
        ground.world.receive(0, heartbeat, ground.now_ns, "stranger")
        ground.run(1.0)
    assert (4, "GCS Failsafe - RTL") in ground.texts()
    assert ground.last("HEARTBEAT").custom_mode == 6


def test_set_mode_message_is_acknowledged_as_such() -> None:
    ground = Ground(arducopter())
    ground.run(2.5)
    ground.send("SET_MODE", target_system=1, base_mode=1, custom_mode=GUIDED)
    ground.run(1.1)
    assert (11, 0) in ground.acks()
    assert ground.last("HEARTBEAT").custom_mode == GUIDED


def test_unknown_command_is_unsupported() -> None:
    ground = Ground(arducopter())
    ground.run(2.5)
    assert ground.ask(31010) == 3


def test_flight_modes_return_and_land() -> None:
    ground = guided_at(3.0)
    ground.run(10.0, lambda: ground.velocity(mask=0x0DF8, x=3.0, y=0.0, z=-3.0))
    assert ground.ask(176, 1, 17) == 0  # BRAKE
    ground.run(1.0)
    assert ground.last("HEARTBEAT").custom_mode == 17
    assert ground.ask(20) == 0  # RTL
    ground.run_until(lambda: not ground.world.truth.armed[0], 60.0)
    assert ground.world.truth.pos_enu_m[0, :2] == pytest.approx([0.0, 0.0], abs=0.6)
    assert Counter(m.landed_state for _, m in ground.all("EXTENDED_SYS_STATE"))[4] > 50


def test_a_fence_that_was_never_set_up_is_not_enabled_and_not_breached() -> None:
    ground = Ground(arducopter())
    ground.run(2.5)
    ground.interval("SYS_STATUS", 5)
    ground.run(1.0)
    status = ground.last("SYS_STATUS")
    fence = 0x100000
    assert status.onboard_control_sensors_health & status.onboard_control_sensors_present & fence  # as the real one
    assert not status.onboard_control_sensors_enabled & fence
