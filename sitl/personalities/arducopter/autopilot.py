"""ArduCopter's behaviour: modes, arming, GUIDED and its time-out, takeoff, landing, acknowledgements and words.

Follows what ArduCopter 4.7.0-dev of mid 2025 was seen to do. Modes that need sticks hold the position in the air:
nobody is there to move them.
"""

from __future__ import annotations

import math
from typing import ClassVar

from groundstation.mavlink.codec import Frame
from sitl.autopilot import IN_AIR, LANDED, LANDING, TAKING_OFF, Autopilot
from sitl.body import Body
from sitl.config import SECOND, VehicleConfig
from sitl.frames import is_place
from sitl.mavlink_ids import (
    ACCEPTED,
    DENIED,
    FAILED,
    MSG_ATT_POS_MOCAP,
    MSG_ODOMETRY,
    MSG_REQUEST_DATA_STREAM,
    MSG_SET_GPS_GLOBAL_ORIGIN,
    MSG_SET_MODE,
    MSG_SET_POSITION_TARGET_LOCAL_NED,
    MSG_VICON_POSITION_ESTIMATE,
    MSG_VISION_POSITION_ESTIMATE,
)
from sitl.outfit import Outfit
from sitl.personalities.arducopter.setpoints import read_ardupilot
from sitl.personalities.arducopter.streams import DATA_STREAMS
from sitl.setpoints import NOTHING, Setpoint
from sitl.vision import LOCAL_FRD, Vision
from sitl.wire import Fields, whole

STABILIZE, ACRO, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, CIRCLE = range(8)
LAND, POSHOLD, BRAKE, GUIDED_NOGPS, SMART_RTL = 9, 16, 17, 20, 21
NAMES = {
    STABILIZE: "STABILIZE", ACRO: "ACRO", ALT_HOLD: "ALT_HOLD", AUTO: "AUTO", GUIDED: "GUIDED", LOITER: "LOITER",
    RTL: "RTL", CIRCLE: "CIRCLE", LAND: "LAND", POSHOLD: "POSHOLD", BRAKE: "BRAKE", GUIDED_NOGPS: "GUIDED_NOGPS",
    SMART_RTL: "SMART_RTL",
}  # fmt: skip
_NEED_POSITION = {AUTO, GUIDED, LOITER, RTL, CIRCLE, POSHOLD, BRAKE, SMART_RTL}
_NOT_ARMABLE = {RTL, LAND, BRAKE, SMART_RTL, CIRCLE, AUTO}
_GUIDED_FLAG = _NEED_POSITION | {LAND}
_STATION_LOST = {5: LAND, 7: BRAKE}  # FS_GCS_ENABLE; the others return, some by the way they came

CRITICAL, WARNING, INFO = 2, 4, 6
_PRESENT = 0x5371FC2F  # a fence (0x100000) is there, and not enabled, before one is set up
_ENABLED, _WELL = 0x52419C2F, 0x47519C2F  # while it holds no position
_HOLDS, _AHRS, _LOGGING, _PREARM = 0x6000, 0x200000, 0x1000000, 0x10000000
_EXTERNAL_NAV = 6
_ARMING_NS, _SPOOL_NS = 2 * SECOND, round(1.4 * SECOND)  # after arming; after that, or after the takeoff command
_AFTER_LANDING_S = 0.5

_BOOT_TEXTS = (
    (1.86, "Barometer 1 calibration complete"), (1.86, "Barometer 2 calibration complete"), (2.39, "ArduPilot Ready"),
    (2.39, "AHRS: DCM active"), (4.39, "EKF3 IMU0 initialised"), (4.39, "EKF3 IMU1 initialised"),
    (4.39, "AHRS: EKF3 active"), (5.74, "EKF3 IMU0 tilt alignment complete"),
    (5.74, "EKF3 IMU1 tilt alignment complete"), (5.83, "EKF3 IMU0 MAG0 initial yaw alignment complete"),
    (5.83, "EKF3 IMU1 MAG0 initial yaw alignment complete"), (9.75, "GPS 1: probing for u-blox at 230400 baud"),
    (9.76, "GPS 1: detected u-blox"),
)  # fmt: skip
"""What it says while it starts, and after how many seconds; sooner where start-up takes less than the real one's."""
_REAL_ORIGIN_S = 20.0


class ArduCopter(Autopilot):
    """One vehicle under ArduCopter.

    Attributes:
        mode: flight mode number.
        taking_off_to: height above home of a takeoff under way, None while there is none.
    """

    mav_autopilot = 3
    param_bytewise = False
    commands_to_system_0 = True
    accepts_unready = True
    version_fields: ClassVar[Fields] = {
        "capabilities": 0x2 | 0x4 | 0x8 | 0x80 | 0x100 | 0x800 | 0x1000 | 0x2000 | 0x20000,
        "flight_sw_version": 0x04070000,
        "board_version": 0,
        "flight_custom_version": b"gs-sitl",
    }

    def __init__(self, body: Body, config: VehicleConfig, outfit: Outfit) -> None:
        super().__init__(body, config, outfit)
        self.mode = STABILIZE
        self.taking_off_to: float | None = None
        self._hold: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self._rtl_stage = 0
        self._above_home_ns = 0
        self._braked = False
        self._entered: int | None = None
        self._origin_told = False
        self._asked_up_ns = 0
        self._boot_texts = list(_BOOT_TEXTS)
        self.messages.update(
            {
                MSG_SET_MODE: self._on_set_mode,
                MSG_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
                MSG_SET_GPS_GLOBAL_ORIGIN: self._on_set_origin,
                MSG_REQUEST_DATA_STREAM: self._on_data_stream,
            }
        )
        self.vision = Vision(
            self,
            (MSG_VISION_POSITION_ESTIMATE, MSG_VICON_POSITION_ESTIMATE, MSG_ATT_POS_MOCAP, MSG_ODOMETRY),
            (LOCAL_FRD,),
        )
        self.commands.update(
            {
                20: lambda _p, _f: self._change_mode(RTL),
                21: lambda _p, _f: self._change_mode(LAND),
                22: self._takeoff_command,
                176: self._mode_command,
                178: self._speed_command,
                192: self._reposition,
                300: lambda _p, _f: self._change_mode(AUTO),
                401: self._prearm_command,
            }
        )

    # -- heartbeat ----------------------------------------------------------------------------------------------

    def mode_name(self) -> str:
        """Its name, for people."""
        return NAMES[self.mode]

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the heartbeat."""
        flags = 0x1 | 0x10 | 0x40 | (0x80 if self.armed else 0)
        return flags | 0x8 if self.mode in _GUIDED_FLAG else flags

    def custom_mode(self) -> int:
        """The mode number."""
        return self.mode

    def system_status(self) -> int:
        """STANDBY on the ground, ACTIVE in the air."""
        return 3 if self.landed else 4

    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        if self.landed:
            return LANDED
        if self.taking_off_to is not None:
            return TAKING_OFF
        return LANDING if self._landing() else IN_AIR

    def sensor_bits(self) -> tuple[int, int, int]:
        """SYS_STATUS sensors: present, enabled, healthy."""
        known = self.body.senses.has_origin
        common = (_HOLDS if self.mode in _GUIDED_FLAG else 0) | (_AHRS if known else 0)
        health = _WELL | common | (_PREARM if self.armed or self.arm_refusal() is None else 0)
        if known and not self.position_good:
            health &= ~_AHRS
        return _PRESENT, _ENABLED | common | (_LOGGING if self.armed else 0), health

    @property
    def _boot_pace(self) -> float:
        """Nanoseconds of this start for a second of the real one's."""
        return self.boot.origin_ns / _REAL_ORIGIN_S

    def started(self) -> None:
        """Sends what comes out of a freshly booted board: bytes that are no MAVLink, then its banner."""
        self.body.link.emit(b"\r\n\r\nInit ArduCopter V4.7.0-dev\r\n\r\nFree RAM: 131072\r\n")
        self.banner()

    def banner(self) -> None:
        """Says who it is."""
        self.voice.text(INFO, "ArduCopter V4.7.0-dev (gs sitl)")
        self.voice.text(INFO, "Frame: QUAD/X")

    def position_found(self) -> None:
        """Tells about the sensors in use, and where home is."""
        super().position_found()
        self.voice.text(INFO, "EKF3 IMU0 is using GPS")
        self.voice.text(INFO, "EKF3 IMU1 is using GPS")

    # -- arming -------------------------------------------------------------------------------------------------

    def arm_refusal(self) -> str | None:
        """Why arming would be refused."""
        if self.deny_arming:
            return "PreArm: Compass not healthy"
        if self.age_ns < self.boot.ready_ns:
            return (
                "PreArm: EKF attitude is bad"
                if self.age_ns < self.boot.ready_ns // 2
                else "PreArm: AHRS: waiting for home"
            )
        if self.mode in _NOT_ARMABLE:
            return f"Arm: {NAMES[self.mode]} mode not armable"
        if self.mode in _NEED_POSITION and not self.position_good:
            return "PreArm: Need Position Estimate"
        if self.params["ARMING_CHECK"] and self.battery.percent() < self.params["ARMING_MIN_BATT"]:
            return "PreArm: Battery 1 below minimum arming capacity"
        return None

    def try_arm(self, forced: bool) -> int:
        """Arms on request."""
        if self.armed:
            return ACCEPTED
        why = None if forced else self.arm_refusal()
        if why is not None:
            self.voice.text(CRITICAL, why)
            return FAILED
        self.arm()
        self.body.link.send_now("HOME_POSITION")
        self.taking_off_to = None
        self._entered = None
        self.voice.text(INFO, "Arming motors")
        return ACCEPTED

    def try_disarm(self, forced: bool) -> int:
        """Disarms on request; in the air only by force."""
        if not self.armed:
            return ACCEPTED
        if not forced and not self.landed:
            return FAILED
        self.disarm()
        return ACCEPTED

    def disarm(self) -> None:
        """Stops the motors and says so."""
        if self.armed:
            self.voice.text(INFO, "Disarming motors")
        super().disarm()
        self.taking_off_to = None

    def _prearm_command(self, _params: tuple[float, ...], _frame: Frame) -> int:
        why = self.arm_refusal()
        if why is not None:
            self.voice.text(CRITICAL, why)
        return ACCEPTED

    # -- modes --------------------------------------------------------------------------------------------------

    def _change_mode(self, mode: int) -> int:
        if mode not in NAMES:
            self.voice.text(WARNING, f"No such mode {mode}")
            return FAILED
        if self.age_ns < self.boot.deaf_ns:
            return ACCEPTED  # seen: acknowledged in the first seconds, and never in effect
        if mode in _NEED_POSITION and not self.position_good:
            self.voice.text(WARNING, f"Mode change to {NAMES[mode]} failed: requires position")
            return FAILED
        if mode == AUTO and not self.mission:
            self.voice.text(WARNING, "Mode change to AUTO failed: init failed")
            return FAILED
        if mode != self.mode:
            self._entered = None
            self.taking_off_to = None
            self.setpoint = None
        self.mode = mode
        return ACCEPTED

    def _mode_command(self, params: tuple[float, ...], _frame: Frame) -> int:
        if not whole(params[0]) & 1:
            return DENIED
        return self._change_mode(whole(params[1]))

    def _on_set_mode(self, fields: Fields, frame: Frame) -> None:
        result = self._change_mode(fields["custom_mode"]) if fields["base_mode"] & 1 else DENIED
        self.voice.ack(MSG_SET_MODE, result, frame)

    def _takeoff_command(self, params: tuple[float, ...], _frame: Frame) -> int:
        height = params[6]
        if self.mode != GUIDED or not self.armed or not self.landed or not 0.0 < height <= 100_000.0:
            return FAILED
        self.taking_off_to = height
        self._asked_up_ns = self.body.now_ns
        self._entered = None
        return ACCEPTED

    def _speed_command(self, params: tuple[float, ...], _frame: Frame) -> int:
        if not params[1] > 0:
            return FAILED
        self.body.motors.limit_speed(xy_m_s=params[1])
        return ACCEPTED

    def _reposition(self, params: tuple[float, ...], _frame: Frame) -> int:
        lat, lon, alt = params[4:7]
        if not is_place(lat, lon, alt) or self.landed:
            return DENIED
        if self._change_mode(GUIDED) != ACCEPTED:
            return FAILED
        x, y, z = self.body.geodesy.enu_from_geodetic(lat, lon, alt).tolist()
        self._entered, self.taking_off_to = GUIDED, None
        self.body.motors.limit_speed()
        self.setpoint = Setpoint(self.body.now_ns, (x, y, z), NOTHING, None, None)
        self._fly_setpoint()
        return ACCEPTED

    # -- setpoints ----------------------------------------------------------------------------------------------

    def _on_setpoint(self, fields: Fields, _frame: Frame) -> None:
        if self.mode != GUIDED or self.taking_off_to is not None:
            return
        origin = self.body.senses.origin_enu_m
        self.setpoint = read_ardupilot(
            fields, self.body.now_ns, origin, self.body.senses.pos_enu_m, self.body.senses.yaw_enu_rad
        )
        if self.setpoint is None:
            self._stop()
        elif self.armed and not self.landed:
            self._entered = GUIDED
            self._fly_setpoint()

    def _fly_setpoint(self) -> None:
        point = self.setpoint
        if point is not None:
            self._braked = False
            self.body.motors.command(point.pos_enu_m, point.vel_enu_m_s, point.yaw_enu_rad, point.yaw_rate_rad_s)

    def _stop(self) -> None:
        """Brakes and holds, staying in GUIDED."""
        self.setpoint = None
        if self.armed and not self.landed:
            self.body.motors.command(NOTHING, NOTHING)

    def _on_set_origin(self, fields: Fields, _frame: Frame) -> None:
        """Takes an origin only while there is none; bad values fail without a word."""
        body = self.body
        lat, lon, alt = fields["latitude"] * 1e-7, fields["longitude"] * 1e-7, fields["altitude"] * 1e-3
        if body.senses.has_origin or not is_place(lat, lon, alt):
            return
        body.senses.set_origin(body.geodesy.enu_from_geodetic(lat, lon, alt))
        body.link.send_now("GPS_GLOBAL_ORIGIN")

    def _on_data_stream(self, fields: Fields, _frame: Frame) -> None:
        """Sets a group of streams; there is no acknowledgement."""
        wanted, rate = fields["req_stream_id"], fields["req_message_rate"]
        interval_ns = round(SECOND / rate) if fields["start_stop"] and rate else 0
        for group, names in DATA_STREAMS.items():
            if wanted in (0, group):
                for name in names:
                    self.body.link.set_interval(name, interval_ns)

    # -- flight -------------------------------------------------------------------------------------------------

    def _landing(self) -> bool:
        return self.mode == LAND or (self.mode in (RTL, SMART_RTL) and self._rtl_stage == 2)

    def wants_up(self) -> bool:
        """Only a takeoff lifts off: an upward velocity alone does not."""
        return self.taking_off_to is not None or (self.mode == AUTO and bool(self.mission))

    def wants_down(self) -> bool:
        """Whether the present mode pushes towards the ground."""
        point = self.setpoint
        if self.mode == GUIDED and point is not None:
            down, bottom = point.vel_enu_m_s[2], point.pos_enu_m[2]
            here = self.body.senses.pos_enu_m[2]
            return (down is not None and down < -0.05) or (bottom is not None and bottom < here - 0.05)
        return self._landing()

    def touched_down(self) -> None:
        """Motors stop a moment later."""
        self.setpoint = None

    def update(self, now_ns: int) -> None:
        """Checks the failsafes, then lets the mode act."""
        if not self._origin_told and self.body.senses.has_origin:
            self._origin_told = True
            self.voice.text(INFO, "EKF3 IMU0 origin set")
            self.voice.text(INFO, "EKF3 IMU1 origin set")
        while self._boot_texts and self.age_ns >= self._boot_texts[0][0] * self._boot_pace:
            self.voice.text(INFO, self._boot_texts.pop(0)[1])
        if not self.armed:
            return
        self._check_failsafes(now_ns)
        if self.landed:
            delay_s = self.params["DISARM_DELAY"]
            since = self.landed_ns if self.taken_off else self.armed_ns
            if self.taken_off and self._landing():
                delay_s = _AFTER_LANDING_S
            if delay_s > 0 and now_ns - since >= delay_s * SECOND and not self.wants_up():
                self.disarm()
                return
        if self.landed and not self.body.motors.flying:
            if not (self.wants_up() and now_ns - max(self.armed_ns + _ARMING_NS, self._asked_up_ns) >= _SPOOL_NS):
                return
            self.body.motors.flying = True
            self._entered = None
        self._act(now_ns)

    def _check_failsafes(self, now_ns: int) -> None:
        heard = self.gcs_heard_ns
        if self.params["FS_GCS_ENABLE"] and heard is not None and not self.landed:
            lost = now_ns - heard > self.params["FS_GCS_TIMEOUT"] * SECOND
            if lost and self.mode not in (RTL, LAND, BRAKE):
                mode = _STATION_LOST.get(whole(self.params["FS_GCS_ENABLE"]), RTL)
                self.voice.text(WARNING, f"GCS Failsafe - {NAMES[mode]}")
                self._change_mode(mode)
        if not self.position_good and self.mode in _NEED_POSITION and not self.landed:
            self.voice.text(CRITICAL, "EKF Failsafe: changed to LAND Mode")
            self._change_mode(LAND)
        if self.battery_low() and self.mode not in (RTL, LAND) and not self.landed:
            self._change_mode(LAND if whole(self.params["BATT_FS_LOW_ACT"]) == 1 else RTL)

    def battery_low(self) -> bool:
        """Tells once about a low battery; True when something is to be done about it."""
        low = self.battery.left * self.battery.capacity_mah < self.params["BATT_LOW_MAH"]
        if low and not self._battery_told:
            self._battery_told = True
            self.voice.text(WARNING, "Battery 1 is low")
        return low and whole(self.params["BATT_FS_LOW_ACT"]) > 0

    def _act(self, now_ns: int) -> None:
        entering = self._entered != self.mode
        self._entered = self.mode
        if self.mode == GUIDED:
            self._act_guided(entering, now_ns)
        elif self.mode == LAND:
            self._act_land(entering)
        elif self.mode in (RTL, SMART_RTL):
            self._act_rtl(entering)
        elif self.mode == AUTO:
            self.flight.act(entering)
        elif entering:
            self._hold = self.body.senses.pos_enu_m
            self.body.motors.limit_speed()
            self.body.motors.command(self._hold, NOTHING)

    def _act_guided(self, entering: bool, now_ns: int) -> None:
        x, y, z = self.body.senses.pos_enu_m
        if self.taking_off_to is not None:
            top = self.body.senses.home_enu_m[2] + self.taking_off_to
            if entering:
                self._hold = (x, y, top)
                self.body.motors.limit_speed(up=self.params["WPNAV_SPEED_UP"] / 100.0)
                self.body.motors.command(self._hold, NOTHING)
            if not self.landed and z > top - 0.1:
                self.taking_off_to = None
            return
        if entering:
            self._hold = (x, y, z)
            self.body.motors.limit_speed()
            if self.setpoint is None:
                self.body.motors.command(self._hold, NOTHING)
        point = self.setpoint
        if point is None or point.pos_enu_m[0] is not None or self._braked:
            return
        if now_ns - point.t_ns > self.params["GUID_TIMEOUT"] * SECOND:
            self._braked = True  # the last velocity has been kept until now; brakes and hovers, no word of it
            self.body.motors.command(NOTHING, NOTHING)

    def _act_land(self, entering: bool) -> None:
        x, y, z = self.body.senses.pos_enu_m
        if entering:
            self._hold = (x, y, z)
            self.body.motors.limit_speed()
        height = z - self.body.senses.home_enu_m[2]
        fast = self.params["LAND_SPEED_HIGH"] or self.params["WPNAV_SPEED_DN"]
        speed = (fast if height > self.params["LAND_ALT_LOW"] / 100.0 else self.params["LAND_SPEED"]) / 100.0
        speed = min(speed, self.body.profile.speed_down_max_m_s)
        self.body.motors.command((self._hold[0], self._hold[1], None), (None, None, -speed))

    def _act_rtl(self, entering: bool) -> None:
        x, y, z = self.body.senses.pos_enu_m
        home = self.body.senses.home_enu_m
        far = math.hypot(x - home[0], y - home[1])
        if entering:
            self._rtl_stage = 0
            climbs = far > 1.0 or self.params["RTL_CONE_SLOPE"] == 0.0
            top = max(z, home[2] + self.params["RTL_ALT"] / 100.0) if climbs else z
            self._hold = (x, y, top)
            self.body.motors.limit_speed()
        if self._rtl_stage == 0 and abs(z - self._hold[2]) < 0.5:
            self._rtl_stage, self._hold = 1, (home[0], home[1], self._hold[2])
        if self._rtl_stage == 1 and far < 0.5:
            self._rtl_stage, self._above_home_ns = 3, self.body.now_ns
        if self._rtl_stage == 3 and self.body.now_ns - self._above_home_ns >= self.params["RTL_LOIT_TIME"] * 1e6:
            self._rtl_stage, self._hold = 2, (home[0], home[1], z)
        if self._rtl_stage == 2:
            self._act_land(False)
        else:
            self.body.motors.command(self._hold, NOTHING)

    def vision_enabled(self) -> bool:
        """VISO_TYPE is set and the estimator's first source is the external one."""
        return self.params["VISO_TYPE"] > 0 and self.params["EK3_SRC1_POSXY"] == _EXTERNAL_NAV

    def vision_has_origin(self) -> bool:
        """The origin has to be set from outside first."""
        return self.body.senses.has_origin

    first_item_is_home = True

    def mission_lands(self) -> None:
        """Lands where the mission has led; shown as LAND."""
        self._change_mode(LAND)

    def mission_returns(self) -> None:
        """Returns and lands."""
        self._change_mode(RTL)

    def _on_heartbeat(self, fields: Fields, frame: Frame) -> None:
        """Only the ground station of MAV_GCS_SYSID counts."""
        if frame.sysid == whole(self.params["MAV_GCS_SYSID"]):
            super()._on_heartbeat(fields, frame)

    _battery_told = False
