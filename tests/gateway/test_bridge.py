"""A Crazyflie behind the gateway: which way it flies, what it does when it is left alone, what it tells and hides."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from groundstation.core import frames
from groundstation.gateway.bridge import Bridge
from groundstation.gateway.measured import POSE_VARIABLES, Supervisor, charge, quat_ned_from_frd, unpacked_quaternion
from groundstation.gateway.names import short_names
from groundstation.gateway.orders import EmergencyStop, Recover
from groundstation.gateway.packets import packet_of
from groundstation.gateway.stamps import Stamps
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, decode
from sitl.personalities.crazyflie.crtp import packed_quaternion
from tests.gateway.room import HOLD, LAND, VELOCITY, Room


@pytest.mark.parametrize(
    ("setpoint_ned", "axis_enu", "sign"),
    [
        ((0.4, 0.0, 0.0), 1, 1.0),
        ((-0.4, 0.0, 0.0), 1, -1.0),
        ((0.0, 0.4, 0.0), 0, 1.0),
        ((0.0, -0.4, 0.0), 0, -1.0),
        ((0.0, 0.0, -0.3), 2, 1.0),
        ((0.0, 0.0, 0.3), 2, -1.0),
    ],
)
def test_each_velocity_leads_where_it_says_and_is_reported_so(
    setpoint_ned: tuple[float, float, float], axis_enu: int, sign: float
) -> None:
    room = Room()
    room.fly()
    before = room.place_enu_m.copy()
    room.setpoint = (*setpoint_ned, None)
    room.run(1.5)
    moved = room.place_enu_m - before
    assert sign * moved[axis_enu] > 0.2
    assert np.abs(np.delete(moved, axis_enu)).max() < 0.1
    told = room.last("LOCAL_POSITION_NED")
    assert [told["y"], told["x"], -told["z"]] == pytest.approx(room.place_enu_m, abs=0.08)
    assert [told["vx"], told["vy"], told["vz"]] == pytest.approx(setpoint_ned, abs=0.15)


@pytest.mark.parametrize("yaw_ned_deg", [-150.0, -60.0, 0.0, 75.0, 170.0])
def test_it_turns_to_the_heading_that_is_asked_for_and_reports_it(yaw_ned_deg: float) -> None:
    room = Room()
    room.fly()
    room.setpoint = (0.0, 0.0, 0.0, math.radians(yaw_ned_deg))
    room.run(7.0)
    told = room.last("ATTITUDE_QUATERNION")
    quat = np.array([float(told[name]) for name in ("q1", "q2", "q3", "q4")])
    off = math.remainder(float(frames.yaw_ned_from_quat(quat)) - math.radians(yaw_ned_deg), math.tau)
    assert abs(off) < 0.05
    true_ned = math.pi / 2 - room.world.dynamics.motion.yaw_enu_rad[0]
    assert abs(math.remainder(true_ned - math.radians(yaw_ned_deg), math.tau)) < 0.05


def test_an_attitude_is_the_same_rotation_in_the_other_frames() -> None:
    ned_from_enu = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    for rotation in Rotation.random(50, random_state=1):
        x, y, z, w = rotation.as_quat()
        turned = frames.rot_ned_from_frd(np.array(quat_ned_from_frd(x, y, z, w)))
        assert turned == pytest.approx(ned_from_enu @ rotation.as_matrix() @ np.diag([1.0, -1.0, -1.0]), abs=1e-12)
        back = Rotation.from_quat(unpacked_quaternion(packed_quaternion(x, y, z, w)))
        assert (back * rotation.inv()).magnitude() < 0.006  # 9 bits


def test_setpoints_that_stop_leave_it_hovering_and_it_follows_again_when_they_return() -> None:
    room = Room()
    room.fly()
    room.setpoint = (0.4, 0.0, 0.0, None)
    room.run(1.0)
    room.setpoint, room.heard = None, []
    room.run(1.0)
    beat = room.last("HEARTBEAT")
    assert (int(beat["custom_mode"]), int(beat["system_status"])) == (HOLD, 5)
    assert "it stays where it is" in room.texts()
    room.run(4.0)
    still = room.place_enu_m.copy()
    room.run(2.0)
    assert room.stage == "FLYING"  # neither levelled out nor fallen
    assert room.place_enu_m == pytest.approx(still, abs=0.05)
    room.setpoint = (0.4, 0.0, 0.0, None)
    room.run(1.0)
    assert room.last("HEARTBEAT")["custom_mode"] == VELOCITY
    assert room.place_enu_m[1] > still[1] + 0.15


def test_the_station_goes_and_it_lands_or_returns_as_it_was_told() -> None:
    for action, mode, home in ((2.0, LAND, False), (1.0, 4, True)):
        room = Room()
        start = room.place_enu_m.copy()
        for name, value in ((b"GW_LOSS_ACT", action), (b"GW_LOSS_S", 4.0), (b"GW_RTL_ALT_M", 1.5)):
            room.send("PARAM_SET", target_system=1, param_id=name, param_value=value, param_type=9)
        room.fly()
        room.setpoint = (0.5, 0.0, 0.0, None)
        room.run(3.0)
        room.setpoint, room.station_lives, room.heard = None, False, []
        highest, modes = 0.0, set()
        for _ in range(40):
            room.run(0.5)
            highest = max(highest, room.place_enu_m[2])
            modes |= {int(beat["custom_mode"]) for beat in room.all("HEARTBEAT")}
        assert mode in modes
        assert not room.world.truth.airborne[0]
        assert room.bridge.pilot.armed is False
        assert (np.linalg.norm(room.place_enu_m - start) < 0.15) == home
        assert (highest > 1.35) == home


def test_lands_by_command_and_ignores_setpoints_meanwhile() -> None:
    room = Room()
    room.fly()
    room.setpoint = (0.0, 0.0, 0.0, None)
    room.run(1.0)
    assert room.command(21) == 0
    room.setpoint = (0.0, 0.0, -0.5, None)  # up; it must not be heard
    room.run(6.0)
    assert not room.world.truth.airborne[0]
    assert room.last("EXTENDED_SYS_STATE")["landed_state"] == 1
    assert not room.last("HEARTBEAT")["base_mode"] & 0x80


def test_a_landing_that_is_taken_back_stays_where_it_is_until_a_velocity_comes() -> None:
    room = Room()
    room.fly()
    assert room.command(21) == 0
    room.run(1.0)
    assert room.command(176, 1.0, VELOCITY) == 0
    room.run(3.0)
    height_m = room.place_enu_m[2]
    assert height_m > 0.3
    room.run(3.0)
    assert room.place_enu_m[2] == pytest.approx(height_m, abs=0.03)


def test_a_gateway_that_ends_lands_it_and_obeys_nothing_but_a_kill() -> None:
    room = Room()
    room.fly()
    room.bridge.end(room.now_ns)
    assert room.command(176, 1.0, VELOCITY) == 2
    room.setpoint = (0.0, 0.0, -0.5, None)
    room.run(5.0)
    assert not room.world.truth.airborne[0]
    assert room.command(400, 1.0) == 2
    assert room.command(400, 0.0, 21196.0) == 0
    room.run(0.5)
    assert room.stage == "LOCKED"


def test_what_is_asked_for_on_the_ground_starts_no_motors() -> None:
    room = Room()
    room.setpoint = (0.0, 0.0, -0.5, None)
    assert room.command(22, 0, 0, 0, math.nan, 0, 0, 1.0) == 2  # neither in VELOCITY nor armed
    assert room.command(176, 1.0, VELOCITY) == 0
    room.run(1.0)
    assert room.command(400, 1.0) == 0
    assert room.command(21) == 0
    room.run(2.0)
    assert room.place_enu_m[2] == pytest.approx(0.0, abs=0.01)
    room.setpoint = None
    assert room.command(176, 1.0, VELOCITY) == 0
    assert room.command(400, 1.0) == 0
    assert room.command(22, 0, 0, 0, math.nan, 0, 0, 1.0) == 0
    assert room.command(400, 0.0) == 0  # before it has left the ground: the takeoff does not go on
    room.run(3.0)
    assert room.place_enu_m[2] == pytest.approx(0.0, abs=0.01)
    assert not room.last("HEARTBEAT")["base_mode"] & 0x80


def test_it_is_disarmed_in_the_air_by_force_only_and_then_says_that_it_is_locked() -> None:
    room = Room()
    room.fly()
    assert room.command(400, 0.0) == 2
    room.run(1.0)
    assert room.stage == "FLYING"
    assert room.command(400, 0.0, 21196.0) == 0
    room.run(2.0)
    assert room.stage == "LOCKED"
    assert "locked by its supervisor" in room.texts()
    assert room.command(400, 1.0) == 2
    room.run(1.0)
    assert not int(room.last("SYS_STATUS")["onboard_control_sensors_health"]) & 0x10000000


def test_a_kill_goes_out_also_when_nothing_is_heard() -> None:
    bridge = Bridge(1, 0)
    bridge.pilot.kill()
    assert EmergencyStop() in bridge.take_orders()


def test_numbers_that_are_none_and_frames_that_are_not_flown_steer_nothing() -> None:
    room = Room()
    room.fly()
    room.setpoint = (0.0, 0.0, 0.0, None)
    room.run(0.5)
    before, ignored = room.place_enu_m.copy(), room.bridge.ignored
    for vector, frame in (((math.nan, 0.0, 0.0), 1), ((math.inf, 0.0, 0.0), 1), ((1.0, 0.0, 0.0), 8)):
        room.steer(*vector, frame=frame)
    assert room.bridge.ignored == ignored + 3
    room.setpoint = (30.0, 0.0, 0.0, None)
    room.run(0.4)
    assert room.place_enu_m[1] - before[1] < 0.6  # cut to 2 m/s


def _values(x_mm: float, variance: float | None = None) -> dict[str, float]:
    values = dict.fromkeys(POSE_VARIABLES, 0.0) | {"stateEstimateZ.x": x_mm, "stateEstimateZ.quat": float(3 << 30)}
    if variance is not None:
        values |= {f"kalman.varP{axis}": variance for axis in "XYZ"} | {"pm.vbat": 4.1, "pm.state": 0.0}
    return values


def _told(bridge: Bridge) -> int:
    return len([frame for frame in bridge.take_frames() if frame[7] == 32])  # LOCAL_POSITION_NED


def test_a_position_that_its_estimator_does_not_vouch_for_is_not_told() -> None:
    bridge = Bridge(1, 0)
    bridge.logged(_values(0.0), 0, 0)
    assert _told(bridge) == 0  # nothing is known of it yet
    bridge.logged(_values(0.0, 1e-4), 20, 20_000_000)
    assert _told(bridge) == 1
    bridge.logged(_values(0.0, 1.0), 40, 40_000_000)
    assert _told(bridge) == 0
    bridge.logged(_values(0.0, math.nan), 60, 60_000_000)
    assert _told(bridge) == 0


def test_a_pose_that_lay_in_a_queue_is_dated_when_it_was_measured() -> None:
    stamps = Stamps()
    assert stamps.measured_ns(16_777_200, 1_000_000_000) == 1_000_000_000
    late = stamps.measured_ns(4, 1_320_000_000)  # 20 ms later by its own clock, which has begun anew in between
    assert late == pytest.approx(1_020_000_000, abs=100_000)
    assert stamps.lateness_ns == pytest.approx(300_000_000, abs=100_000)
    assert stamps.measured_ns(16_777_210, 1_330_000_000) is None  # overtaken
    assert stamps.restarts == 0
    assert stamps.measured_ns(16_700_000, 1_400_000_000) == 1_400_000_000
    assert stamps.restarts == 1


def test_who_is_not_heard_sends_no_heartbeat() -> None:
    bridge = Bridge(1, 0)
    bridge.tick(0)
    assert bridge.take_frames() == []
    bridge.logged(_values(0.0, 1e-4), 0, 0)
    bridge.take_frames()
    bridge.tick(400_000_000)
    assert bridge.take_frames() == []  # its connection is not complete: nobody knows its version yet
    bridge.connected(12, {})
    bridge.tick(500_000_000)
    assert bridge.take_frames()
    bridge.tick(3_000_000_000)
    assert bridge.take_frames() == []


def test_names_fit_mavlink_and_are_never_the_same() -> None:
    found = short_names(["pm.vbat", "supervisor.landedTimeout", "superxisor.landedTimeout", "a.b" * 9, "a.b" * 9 + "c"])
    assert len(found) == 5
    assert max(map(len, found)) <= 16
    assert found["su.landedTimeout"] == "supervisor.landedTimeout"


def test_parameters_are_listed_read_and_set() -> None:
    room = Room()
    room.heard.clear()
    room.send("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    room.run(3.0)
    names = [bytes(values["param_id"]).decode() for values in room.all("PARAM_VALUE")]
    assert len(set(names)) == int(room.last("PARAM_VALUE")["param_count"]) == 35
    room.send("PARAM_SET", target_system=1, param_id=b"posCtlPi.xVelMax", param_value=1.5, param_type=9)
    room.run(0.2)
    assert room.last("PARAM_VALUE")["param_value"] == 1.5
    assert room.world.autopilots[0].params["posCtlPid.xVelMax"] == 1.5
    room.send("PARAM_SET", target_system=1, param_id=b"GW_SETP_LOSS_S", param_value=3.0, param_type=9)
    room.run(0.1)
    assert room.last("PARAM_VALUE")["param_value"] == pytest.approx(0.3)  # the firmware would level out before


def test_charge_is_lower_at_the_same_voltage_standing_than_flying() -> None:
    assert charge(4.2, flies=False) == 1.0
    assert charge(3.7, flies=True) > charge(3.7, flies=False)
    assert charge(2.9, flies=True) == 0.0
    assert math.isnan(charge(0.0, flies=False))


@pytest.mark.parametrize(
    ("bits", "words"),
    [
        (0x20E, None),  # as firmware of 2026.08 tells it at rest
        (0x206, "cannot fly"),
        (0xA04, "one of its decks has failed"),
        (0x224, "stand it upright"),
        (0x284, "crashed"),
        (0x244, "switch it off and on"),
    ],
)
def test_what_its_supervisor_says_is_told_in_words(bits: int, words: str | None) -> None:
    trouble = Supervisor(bits).trouble()
    assert trouble is None if words is None else words in str(trouble)


def test_nobody_holds_or_returns_by_an_estimate_that_nobody_corrects() -> None:
    room = Room()
    room.fly()
    room.setpoint = (0.0, 0.0, 0.0, None)

    def told(seconds: float) -> None:
        for _ in range(round(seconds / 0.04)):
            east, north, up = room.place_enu_m.tolist()
            pose = struct.pack("<Bfffffff", 1, north, east, -up, 1.0, 0.0, 0.0, 0.0)
            room.send("TUNNEL", payload_type=0xA000, payload_length=len(pose), payload=pose)
            room.run(0.04)

    told(1.0)
    room.run(2.0)  # its body is covered, and the ground station steers it as before
    assert room.bridge.pilot.mode == VELOCITY
    told(0.2)
    room.setpoint, room.station_lives = None, False
    told(2.0)
    assert room.bridge.pilot.mode == HOLD  # left alone, but somebody tells it where it is
    room.heard.clear()
    room.run(1.2)
    assert room.bridge.pilot.mode == LAND
    assert "it lands where it is" in room.texts()


@pytest.mark.parametrize(
    ("bits", "words"),
    [(0x80, None), (0x80 | 0x20, "stand it upright"), (0x40, "only its switch ends"), (0x1A, "is in the air")],
)
def test_one_that_has_crashed_begins_anew_where_it_stands_upright(bits: int, words: str | None) -> None:
    bridge, encoder = Bridge(1, 0), Encoder(255, 190)
    bridge.connected(12, {})
    pose = dict.fromkeys((f"stateEstimateZ.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "quat")), 0.0)
    bridge.logged(pose | {"supervisor.info": float(bits)}, 10, 1)
    bridge.take_orders()
    bridge.receive(encoder.encode("COMMAND_LONG", target_system=1, command=246, param1=1.0), 2)
    frames = [piece for raw in bridge.take_frames() for piece in FrameSplitter().feed(raw) if isinstance(piece, Frame)]
    told = {batch.name: batch.values for batch in decode(frames)}
    assert int(told["COMMAND_ACK"]["result"][0]) == (0 if words is None else 2)
    assert (Recover() in bridge.take_orders()) == (words is None)
    if words is not None:
        assert words in b"".join(bytes(text) for text in told["STATUSTEXT"]["text"]).decode()
    assert packet_of(Recover(), {}) == b"\x9d\x02"  # supervisor port, channel 1, CMD_RECOVER_SYSTEM
