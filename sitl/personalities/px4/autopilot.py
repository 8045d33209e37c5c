"""PX4's behaviour: modes, arming, OFFBOARD and its loss, takeoff, landing, acknowledgements.

Follows what PX4 main of mid 2025 was seen to do. Modes that need sticks exist in name only: without sticks nothing
can be flown in them.
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
    MSG_ODOMETRY,
    MSG_SET_GPS_GLOBAL_ORIGIN,
    MSG_SET_MODE,
    MSG_SET_POSITION_TARGET_LOCAL_NED,
    MSG_VISION_POSITION_ESTIMATE,
    TEMPORARILY_REJECTED,
)
from sitl.outfit import Outfit
from sitl.personalities.px4.setpoints import read_px4
from sitl.setpoints import NOTHING
from sitl.vision import LOCAL_FRD, LOCAL_NED, Vision
from sitl.wire import Fields, whole

Mode = tuple[int, int]
MANUAL, ALTCTL, POSCTL, ACRO, OFFBOARD, STABILIZED = (1, 0), (2, 0), (3, 0), (5, 0), (6, 0), (7, 0)
TAKEOFF, LOITER, MISSION, RTL, LAND = (4, 2), (4, 3), (4, 4), (4, 5), (4, 6)
_MODES = {
    MANUAL: "MANUAL", ALTCTL: "ALTCTL", POSCTL: "POSCTL", ACRO: "ACRO", OFFBOARD: "OFFBOARD", STABILIZED: "STABILIZED",
    TAKEOFF: "AUTO.TAKEOFF", LOITER: "AUTO.LOITER", MISSION: "AUTO.MISSION", RTL: "AUTO.RTL", LAND: "AUTO.LAND",
}  # fmt: skip
_NAMES = {OFFBOARD: "Offboard", MISSION: "Mission"}
_PREVENT_ARMING = (LAND, RTL)
_OFFBOARD_LOST = {3: RTL, 4: LAND, 5: LOITER}  # COM_OBL_RC_ACT; others fly by sticks that are not there
_MOTORS_OFF = (6, 7)
_NEED_POSITION = {POSCTL, OFFBOARD, TAKEOFF, LOITER, MISSION, RTL, LAND}

CRITICAL, INFO = 2, 6
WARNING = 4
_SINK_M_S = 0.6  # 0.55 to 0.65 were seen
_TOLD_OF_RAMP, _LIFT_OF_RAMP = 0.3, 0.68  # shares of MPC_TKO_RAMP_T after spooling up: 1.9 s and 3.05 s after arming
_HEARTBEAT_MISSED_NS = round(2.5 * SECOND)  # after the last one: only from there on the link counts as lost
_SLOW_CHECKS = 5  # what need not be looked at every 20 ms
_BATTERY_LEVELS = (
    ("BAT_LOW_THR", WARNING, "Low battery level, return advised\t"),
    ("BAT_CRIT_THR", CRITICAL, "Critical battery level, return now\t"),
    ("BAT_EMERGEN_THR", CRITICAL, "Dangerous battery level, land now\t"),
)
_GPS, _POSITION, _RECEIVER, _LOGGING, _PREARM = 0x20, 0x4000, 0x10000, 0x1000000, 0x10000000
_FITTED = 0x200000F | _GPS | _POSITION | _LOGGING  # gyro, accelerometer, compass, barometer, battery
_WELL = 0x320883F | _POSITION  # of everything that it watches, fitted or not, all but the receiver that is not there


class Px4(Autopilot):
    """One vehicle under PX4.

    Attributes:
        intention: the mode that the user asked for; it outlives failsafes.
        failsafe: the mode that acts instead of it, None while there is none.
    """

    mav_autopilot = 12
    param_bytewise = True
    version_fields: ClassVar[Fields] = {
        "capabilities": 0x4 | 0x8 | 0x10 | 0x40 | 0x80 | 0x100 | 0x800 | 0x2000,
        "flight_sw_version": 0x01110000,
        "middleware_sw_version": 0x01110000,
        "os_sw_version": 0x060800FF,
        "board_version": 1 << 16,
        "flight_custom_version": b"\x01\x17gssitl",
    }

    def __init__(self, body: Body, config: VehicleConfig, outfit: Outfit) -> None:
        super().__init__(body, config, outfit)
        self.intention: Mode = LOITER
        self.failsafe: Mode | None = None
        self._after_flight: Mode = LOITER
        self._entered: Mode | None = None
        self._hold: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self._takeoff_to: tuple[float, float, float] | None = None
        self._rtl_stage = 0
        self._ramp_since_ns = 0
        self._above_home_ns = 0
        self._until_setpoints = False
        self._battery_told = 0
        self._ticks = 0
        self.messages.update(
            {
                MSG_SET_MODE: self._on_set_mode,
                MSG_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
                MSG_SET_GPS_GLOBAL_ORIGIN: self._on_set_origin,
            }
        )
        # ATT_POS_MOCAP is not among them
        self.vision = Vision(self, (MSG_VISION_POSITION_ESTIMATE, MSG_ODOMETRY), (LOCAL_NED, LOCAL_FRD))
        self.commands.update(
            {
                20: lambda _p, _f: self._change_mode(RTL),
                21: self._land_command,
                22: self._takeoff_command,
                176: self._mode_command,
                178: self._speed_command,
                192: self._reposition,
                300: lambda _p, _f: self._change_mode(MISSION),
                401: lambda _p, _f: ACCEPTED,
            }
        )

    # -- heartbeat ----------------------------------------------------------------------------------------------

    @property
    def mode(self) -> Mode:
        """The mode that acts, and is shown."""
        return self.failsafe or self.intention

    def mode_name(self) -> str:
        """Its name, for people."""
        return _MODES.get(self.mode, "?")

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the heartbeat."""
        main = self.mode[0]
        flags = 0x1 | (0x80 if self.armed else 0)
        if main in (1, 5):
            return flags | 0x40
        if main in (2, 3, 7):
            return flags | 0x40 | 0x10
        if main == OFFBOARD[0]:
            return flags | 0x10
        return flags | 0x10 | 0x8 | 0x4

    def custom_mode(self) -> int:
        """Sub mode << 24, main mode << 16."""
        main, sub = self.mode
        return sub << 24 | main << 16

    def system_status(self) -> int:
        """UNINIT while arming in this mode would be refused, then STANDBY, ACTIVE, CRITICAL in a failsafe."""
        if self.armed:
            return 5 if self.failsafe else 4
        return 3 if self.arm_refusal() is None else 0

    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        if self.landed:
            return LANDED
        if self.mode == TAKEOFF:
            return TAKING_OFF
        return LANDING if self.mode == LAND or (self.mode == RTL and self._rtl_stage == 2) else IN_AIR

    def sensor_bits(self) -> tuple[int, int, int]:
        """SYS_STATUS sensors: present, enabled, healthy."""
        # What is watched and not well is enabled, whether it is there or not; the prearm bit is in health alone.
        lost = 0 if self.position_good else _POSITION
        present = _FITTED if self.has_position else _FITTED & ~_GPS
        ready = _PREARM if self.ready and not self.deny_arming else 0
        return present, present | _RECEIVER, (_WELL & ~lost) | ready

    # -- arming -------------------------------------------------------------------------------------------------

    def setpoint_alive(self) -> bool:
        """Whether the last setpoint is younger than COM_OF_LOSS_T."""
        point = self.setpoint
        return point is not None and self.body.now_ns - point.t_ns <= self.params["COM_OF_LOSS_T"] * SECOND

    def arm_refusal(self) -> str | None:
        """Why arming would be refused."""
        if self.deny_arming:
            return "Preflight Fail: Sensor 0 missing"
        if self.battery.left < self.params["BAT_CRIT_THR"]:
            return "Preflight Fail: Critical battery level"
        if not self.ready:
            return "Preflight Fail: ekf2 missing data" if not self.has_position else ""
        if self.mode == OFFBOARD and not self.setpoint_alive():
            return ""
        if self.mode in _PREVENT_ARMING:
            return ""
        return None

    def try_arm(self, forced: bool) -> int:
        """Arms on request."""
        if self.armed:
            return ACCEPTED
        why = None if forced else self.arm_refusal()
        if why is not None:
            if why:
                self.voice.text(CRITICAL, why + "\t")
            self.voice.text(CRITICAL, "Arming denied: Resolve system health failures first\t")
            return TEMPORARILY_REJECTED
        self.arm()
        self.failsafe = None
        self._entered = None
        self.voice.text(INFO, "Armed by external command\t")
        return ACCEPTED

    def try_disarm(self, forced: bool) -> int:
        """Disarms on request; in the air only by force."""
        if not self.armed:
            return ACCEPTED
        if not forced and not self.landed:
            self.voice.text(CRITICAL, "Disarming denied: not landed\t")
            return TEMPORARILY_REJECTED
        self.disarm()
        self.voice.text(INFO, "Disarmed by external command\t")
        return ACCEPTED

    def disarm(self) -> None:
        """Stops the motors; a failsafe ends with the flight, and so does a mode in which nobody can arm."""
        if self.armed:
            self.intention = self._after_flight
        super().disarm()
        self.failsafe = None

    # -- modes --------------------------------------------------------------------------------------------------

    def _intend(self, mode: Mode) -> None:
        """Keeps what the user wants; the last of it in which arming is possible is wanted again after the flight."""
        self.intention = mode
        if mode not in _PREVENT_ARMING:
            self._after_flight = mode

    def _change_mode(self, mode: Mode) -> int:
        flying = self.armed and not self.landed
        if flying and ((mode == OFFBOARD and not self.setpoint_alive()) or (mode == MISSION and not self.mission)):
            name = _NAMES[mode]
            self.voice.text(CRITICAL, f"Switching to mode '{name}' is currently not possible\t")
            return TEMPORARILY_REJECTED
        if flying and mode in _NEED_POSITION and not self.has_position:
            return TEMPORARILY_REJECTED
        self._intend(mode)
        self.failsafe = None
        self._entered = None
        if mode == TAKEOFF and self._takeoff_to is None:
            self._takeoff_to = self._takeoff_target(math.nan, math.nan, math.nan)
        return ACCEPTED

    def _mode_command(self, params: tuple[float, ...], _frame: Frame) -> int:
        if not whole(params[0]) & 1:
            return DENIED
        mode = (whole(params[1]), whole(params[2]) if whole(params[1]) == 4 else 0)
        return self._change_mode(mode) if mode in _MODES else DENIED

    def _on_set_mode(self, fields: Fields, _frame: Frame) -> None:
        if fields["base_mode"] & 1:
            mode = (fields["custom_mode"] >> 16 & 0xFF, fields["custom_mode"] >> 24)
            if mode in _MODES:
                self._change_mode(mode)

    def _takeoff_target(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> tuple[float, float, float]:
        """Where a takeoff ends, ENU; heights below MIS_TAKEOFF_ALT are raised to it, as PX4 does."""
        body = self.body
        x, y, z = self.body.senses.pos_enu_m
        home_z = body.senses.home_enu_m[2]
        lowest = (z if self.landed else home_z) + self.params["MIS_TAKEOFF_ALT"]
        if not abs(alt_amsl_m) <= 100_000.0:  # NaN, most of all: "as usual"
            self.voice.text(INFO, f"Using default takeoff altitude: {self.params['MIS_TAKEOFF_ALT']:.2f} m\t")
            top = lowest
        else:
            top = alt_amsl_m - body.home_alt_m
            if top < lowest - 0.1:
                self.voice.text(CRITICAL, f"Using minimum takeoff altitude: {self.params['MIS_TAKEOFF_ALT']:.2f} m\t")
            top = max(top, lowest)
        if is_place(lat_deg, lon_deg, 0.0):
            x, y, _ = body.geodesy.enu_from_geodetic(lat_deg, lon_deg, body.home_alt_m).tolist()
        return x, y, max(top, z)

    def _takeoff_command(self, params: tuple[float, ...], _frame: Frame) -> int:
        if not self.has_position:
            return TEMPORARILY_REJECTED
        self._takeoff_to = self._takeoff_target(params[4], params[5], params[6])
        return self._change_mode(TAKEOFF)

    def _land_command(self, _params: tuple[float, ...], _frame: Frame) -> int:
        result = self._change_mode(LAND)
        if result == ACCEPTED and self.armed and not self.landed:
            self.voice.text(INFO, "Landing at current position\t")
        return result

    def _speed_command(self, params: tuple[float, ...], _frame: Frame) -> int:
        if params[1] > 0:
            self.body.motors.limit_speed(xy_m_s=params[1])
        return ACCEPTED

    def _reposition(self, params: tuple[float, ...], _frame: Frame) -> int:
        if not self.has_position or not self.armed or self.landed:
            return DENIED
        x, y, z = self.body.senses.pos_enu_m
        lat, lon, alt = params[4:7]
        if is_place(lat, lon, 0.0):
            x, y, _ = self.body.geodesy.enu_from_geodetic(lat, lon, self.body.home_alt_m).tolist()
        if abs(alt) <= 100_000.0:
            z = alt - self.body.home_alt_m
        self._change_mode(LOITER)
        self._entered, self._hold = LOITER, (x, y, z)
        self.body.motors.command(self._hold, NOTHING)
        return ACCEPTED

    # -- setpoints ----------------------------------------------------------------------------------------------

    def _on_setpoint(self, fields: Fields, _frame: Frame) -> None:
        origin = self.body.senses.origin_enu_m
        try:
            point = read_px4(fields, self.body.now_ns, origin, self.body.senses.yaw_enu_rad)
        except ValueError as error:
            self.voice.text(CRITICAL, f"SET_POSITION_TARGET_LOCAL_NED {error}\t")
            return
        if point is not None:
            self.setpoint = point
            if self.mode == OFFBOARD and self.armed:
                self._fly_setpoint()

    def _fly_setpoint(self) -> None:
        point = self.setpoint
        if point is None:
            return
        self.body.motors.command(point.pos_enu_m, point.vel_enu_m_s, point.yaw_enu_rad, point.yaw_rate_rad_s)

    def _on_set_origin(self, fields: Fields, _frame: Frame) -> None:
        """Moves the estimator's origin, and LOCAL_POSITION_NED with it."""
        lat, lon, alt = fields["latitude"] * 1e-7, fields["longitude"] * 1e-7, fields["altitude"] * 1e-3
        if not self.has_position or not is_place(lat, lon, alt):
            return
        self.body.senses.set_origin(self.body.geodesy.enu_from_geodetic(lat, lon, alt))
        self.body.link.send_now("GPS_GLOBAL_ORIGIN")

    # -- flight -------------------------------------------------------------------------------------------------

    def wants_up(self) -> bool:
        """Whether the present mode wants to leave the ground."""
        mode = self.mode
        if mode == OFFBOARD:
            point = self.setpoint
            if point is None or not self.setpoint_alive():
                return False
            up, top = point.vel_enu_m_s[2], point.pos_enu_m[2]
            return (up is not None and up > 0.0) or (top is not None and top > self.body.senses.pos_enu_m[2] + 0.05)
        return mode in (TAKEOFF, MISSION)

    def wants_down(self) -> bool:
        """Whether the present mode pushes towards the ground."""
        mode = self.mode
        if mode == OFFBOARD:
            point = self.setpoint
            if point is None:
                return False
            down, bottom = point.vel_enu_m_s[2], point.pos_enu_m[2]
            if bottom is not None:
                return bottom < self.body.senses.pos_enu_m[2] - 0.05
            return down is not None and down < -0.02
        return mode == LAND or self.failsafe == POSCTL or (mode == RTL and self._rtl_stage == 2)

    def update(self, now_ns: int) -> None:
        """Checks what may end a mode, then lets the mode act."""
        if not self.armed:
            return
        self._check_offboard()
        self._check_estimate()
        self._ticks += 1
        if self._ticks % _SLOW_CHECKS == 0:
            self._check_battery()
            self._check_data_link(now_ns)
            self._check_sticks()
        self._disarm_by_itself(now_ns)
        if not self.armed:
            return
        if not self.taken_off and not self.body.motors.flying:
            self._ramp_up(now_ns)
            return
        if self.landed and not self.wants_up():
            self.body.motors.flying = False
            return
        self._act(now_ns)

    def _ramp_up(self, now_ns: int) -> None:
        """Motors spool up, then thrust grows over MPC_TKO_RAMP_T: counted as taken off early, lifted later."""
        spooled = now_ns - self.armed_ns >= self.params["COM_SPOOLUP_TIME"] * SECOND
        if not spooled or not self.wants_up():
            self._ramp_since_ns = now_ns
            self.landed = True
            return
        ramped = (now_ns - self._ramp_since_ns) / SECOND / max(self.params["MPC_TKO_RAMP_T"], 0.1)
        if ramped >= _TOLD_OF_RAMP and self.landed:
            self.landed = False
            self.voice.text(INFO, "Takeoff detected\t")
        if ramped >= _LIFT_OF_RAMP:
            self.body.motors.flying = True
            self.taken_off = True
            self._entered = None

    def touched_down(self) -> None:
        """Tells it."""
        if self.armed and self.taken_off:
            self.voice.text(INFO, "Landing detected\t")

    def _check_offboard(self) -> None:
        if self.intention != OFFBOARD:
            return
        alive = self.setpoint_alive()
        if self.failsafe is None and not alive:
            action = whole(self.params["COM_OBL_RC_ACT"])
            self._fail_to(_OFFBOARD_LOST.get(action, POSCTL), until_setpoints=True)
            if action in _MOTORS_OFF:
                self.disarm()
        elif self.failsafe is not None and self._until_setpoints and alive:
            self.failsafe = None
            self._entered = None

    def _fail_to(self, mode: Mode, *, until_setpoints: bool = False) -> None:
        """Lets a failsafe take over; the one for lost setpoints ends when they come back."""
        self.failsafe = mode
        self._until_setpoints = until_setpoints
        self._entered = None
        self.voice.text(CRITICAL, "Failsafe activated\t")

    def _check_estimate(self) -> None:
        """Without a position it descends where it is."""
        if not self.position_good and not self.landed and self.mode in _NEED_POSITION and self.mode != LAND:
            self._fail_to(LAND)

    def _check_battery(self) -> None:
        """Tells about each threshold once, and acts on it as COM_LOW_BAT_ACT says (0: it does not)."""
        left, action = self.battery.left, whole(self.params["COM_LOW_BAT_ACT"])
        for level, (name, severity, words) in enumerate(_BATTERY_LEVELS):
            if left >= self.params[name] or level < self._battery_told:
                continue
            self._battery_told = level + 1
            self.voice.text(severity, words)
            wanted = {2: LAND, 3: LAND if level == 2 else RTL}.get(action) if level else None
            if wanted is not None and not self.landed and self.mode not in (LAND, wanted):
                self._fail_to(wanted)

    def _check_data_link(self, now_ns: int) -> None:
        """Any ground station's heartbeat counts; NAV_DLL_ACT is off by default."""
        action, heard = whole(self.params["NAV_DLL_ACT"]), self.gcs_heard_ns
        mode = {1: LOITER, 2: RTL, 3: LAND}.get(action)
        if mode is None or heard is None or self.landed or self.mode in (mode, *_PREVENT_ARMING):
            return
        late_ns = now_ns - heard - _HEARTBEAT_MISSED_NS - self.params["COM_DL_LOSS_T"] * SECOND
        if late_ns <= 0:
            return
        if late_ns > self.params["COM_FAIL_ACT_T"] * SECOND or mode == LOITER:
            self._fail_to(mode)
        elif self.failsafe is None:
            self._fail_to(LOITER)  # so that a pilot may still take over

    def _check_sticks(self) -> None:
        """There are none: OFFBOARD goes on only while COM_RCL_EXCEPT excepts it."""
        mode = {1: LOITER, 2: RTL, 3: LAND}.get(whole(self.params["NAV_RCL_ACT"]))
        excepted = whole(self.params["COM_RCL_EXCEPT"]) & 4
        if mode is not None and not excepted and self.mode == OFFBOARD and not self.landed:
            self._fail_to(mode)

    def _disarm_by_itself(self, now_ns: int) -> None:
        if not self.landed:
            return
        if self.taken_off:
            wait, words = self.params["COM_DISARM_LAND"], "Disarmed by landing\t"
            since = self.landed_ns
        else:
            # 10 s by parameter, counted once the motors have spun up: 10.8 s were seen
            wait, words = self.params["COM_DISARM_PRFLT"] + 0.8, "Disarmed by auto preflight disarming\t"
            since = self.armed_ns
        if wait > 0 and now_ns - since >= wait * SECOND:
            self.disarm()
            self.voice.text(INFO, words)

    def _act(self, now_ns: int) -> None:
        mode = self.mode
        entering = self._entered != mode
        self._entered = mode
        if mode == OFFBOARD:
            if entering:
                self._fly_setpoint()
        elif mode == TAKEOFF:
            self._act_takeoff(entering)
        elif mode == LAND:
            self._act_land(entering)
        elif mode == RTL:
            self._act_rtl(entering)
        elif mode == MISSION:
            self.flight.act(entering)
        elif entering:
            x, y, z = self._hold = self.body.senses.pos_enu_m
            self.body.motors.limit_speed()
            if self.failsafe == POSCTL:  # the throttle stick that is not there counts as pulled down
                self.body.motors.command((x, y, None), (None, None, -_SINK_M_S))
            else:
                self.body.motors.command((x, y, z), NOTHING)

    def _act_takeoff(self, entering: bool) -> None:
        target = self._takeoff_to or self.body.senses.pos_enu_m
        if entering:
            self.body.motors.limit_speed(up=self.params["MPC_TKO_SPEED"])
            self.body.motors.command(target, NOTHING)
        x, y, z = self.body.senses.pos_enu_m
        start = self.body.senses.ground_m
        if not self.landed and z > target[2] - min(0.8, 0.2 * (target[2] - start)):
            # the altitude counts as reached within NAV_MC_ALT_RAD; Hold keeps the takeoff's altitude
            self._takeoff_to = None
            self._intend(LOITER)
            self._entered = LOITER
            self._hold = (x, y, target[2])
            self.body.motors.command(self._hold, NOTHING)

    def _act_land(self, entering: bool) -> None:
        x, y, z = self.body.senses.pos_enu_m
        if entering:
            self._hold = (x, y, z)
            self.body.motors.limit_speed()
        height = z - self.body.senses.home_enu_m[2]
        slow, fast = self.params["MPC_LAND_SPEED"], self.params["MPC_Z_V_AUTO_DN"]
        share = min(max((height - 5.0) / 5.0, 0.0), 1.0)  # MPC_LAND_ALT2 and MPC_LAND_ALT1
        profile = self.body.profile
        speed = min(slow + share * (fast - slow), profile.speed_down_max_m_s)
        if height < profile.crawl_below_m:
            speed = min(speed, profile.crawl_m_s)
        self.body.motors.command((self._hold[0], self._hold[1], None), (None, None, -speed))

    def _rtl_top(self, z: float, home_z: float, far: float) -> float:
        """Height of the way back: a cone around home where RTL_CONE_ANG says so, never below the present height."""
        params = self.params
        highest = home_z + params["RTL_RETURN_ALT"]
        cone_deg = params["RTL_CONE_ANG"]
        if cone_deg <= 0:
            return max(z, highest)
        near = params["NAV_ACC_RAD"]
        if far <= near:
            wanted = home_z + 2.0 * far
        else:
            wanted = highest
            if far <= params["RTL_MIN_DIST"]:
                wanted = min(home_z + far / math.tan(math.radians(min(max(cone_deg, 1.0), 89.0))), highest)
            wanted = max(wanted, home_z + 2.0 * near)
        return z if wanted < z else min(wanted, highest)

    def _act_rtl(self, entering: bool) -> None:
        x, y, z = self.body.senses.pos_enu_m
        home = self.body.senses.home_enu_m
        far = math.hypot(x - home[0], y - home[1])
        if entering:
            self._rtl_stage = 0
            self._hold = (x, y, self._rtl_top(z, home[2], far))
            self.body.motors.limit_speed()
        if self._rtl_stage == 0 and abs(z - self._hold[2]) < 0.5:
            self._rtl_stage = 1
            self._hold = (home[0], home[1], self._hold[2])
        if self._rtl_stage == 1 and far < 0.5:
            waits = self.params["RTL_LAND_DELAY"] != 0.0
            self._rtl_stage = 3 if waits else 2
            self._above_home_ns = self.body.now_ns
            self._hold = (home[0], home[1], min(z, home[2] + self.params["RTL_DESCEND_ALT"]) if waits else z)
        if self._rtl_stage == 3:
            delay_s = self.params["RTL_LAND_DELAY"]
            if abs(z - self._hold[2]) > 0.8:  # NAV_MC_ALT_RAD; the wait begins at RTL_DESCEND_ALT
                self._above_home_ns = self.body.now_ns
            elif 0.0 <= delay_s <= (self.body.now_ns - self._above_home_ns) / SECOND:
                self._rtl_stage, self._hold = 2, (home[0], home[1], z)
        if self._rtl_stage == 2:
            self._act_land(False)
        else:
            self.body.motors.command(self._hold, NOTHING)

    def vision_enabled(self) -> bool:
        """EKF2_EV_CTRL has the bits of horizontal and vertical position."""
        return whole(self.params["EKF2_EV_CTRL"]) & 3 == 3

    def mission_over(self) -> None:
        """PX4 holds when its mission is over."""
        self._change_mode(LOITER)

    def mission_lands(self) -> None:
        """Lands where the mission has led; shown as AUTO.LAND."""
        self._change_mode(LAND)

    def mission_returns(self) -> None:
        """Returns and lands."""
        self._change_mode(RTL)

    def unknown_param(self, name: str) -> None:
        """PX4 tells so and sends no value."""
        self.voice.text(3, f"[pm] unknown param: {name}\t")
