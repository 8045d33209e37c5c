"""PX4's behaviour: what it shows, how it arms, lifts off and touches down.

Follows what PX4 main of mid 2025 was seen to do. Modes that need sticks exist in name only: without sticks nothing
can be flown in them.
"""

from __future__ import annotations

from typing import ClassVar

from sitl.autopilot import IN_AIR, LANDED, LANDING, TAKING_OFF, Autopilot
from sitl.body import Body
from sitl.config import SECOND, VehicleConfig
from sitl.mavlink_ids import ACCEPTED, MSG_ODOMETRY, MSG_VISION_POSITION_ESTIMATE, TEMPORARILY_REJECTED
from sitl.mission import MissionEnd
from sitl.outfit import Outfit
from sitl.personalities.px4.commander import Commander
from sitl.personalities.px4.modes import (
    CRITICAL,
    ERROR,
    INFO,
    LAND,
    LOITER,
    MISSION,
    NAMES,
    OFFBOARD,
    POSCTL,
    RTL,
    TAKEOFF,
    mode_flags,
    mode_word,
)
from sitl.personalities.px4.navigator import Navigator
from sitl.personalities.px4.orders import Orders
from sitl.vision import LOCAL_FRD, LOCAL_NED, Vision
from sitl.wire import Fields, whole

_TOLD_OF_RAMP, _LIFT_OF_RAMP = 0.3, 0.68  # shares of MPC_TKO_RAMP_T after spooling up: 1.9 s and 3.05 s after arming
_GPS, _POSITION, _RECEIVER, _LOGGING, _PREARM = 0x20, 0x4000, 0x10000, 0x1000000, 0x10000000
_FITTED = 0x200000F | _GPS | _POSITION | _LOGGING  # gyro, accelerometer, compass, barometer, battery
_WELL = 0x320883F | _POSITION  # of everything that it watches, fitted or not, all but the receiver that is not there
_MISSION_ENDS = {MissionEnd.OVER: LOITER, MissionEnd.LANDS: LAND, MissionEnd.RETURNS: RTL}


class Px4(Autopilot):
    """One vehicle under PX4.

    Attributes:
        commander: which mode acts, and why.
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
        self.commander = Commander(self)
        self._navigator = Navigator(self, self.commander)
        self._orders = Orders(self, self.commander, self._navigator)
        self._ramp_since_ns = 0
        # ATT_POS_MOCAP is not among them
        self.vision = Vision(self, (MSG_VISION_POSITION_ESTIMATE, MSG_ODOMETRY), (LOCAL_NED, LOCAL_FRD))

    # -- heartbeat ----------------------------------------------------------------------------------------------

    def mode_name(self) -> str:
        """Its name, for people."""
        return NAMES.get(self.commander.mode, "?")

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the heartbeat."""
        return mode_flags(self.commander.mode, armed=self.armed)

    def custom_mode(self) -> int:
        """Sub mode << 24, main mode << 16."""
        return mode_word(self.commander.mode)

    def system_status(self) -> int:
        """UNINIT while arming in this mode would be refused, then STANDBY, ACTIVE, CRITICAL in a failsafe."""
        if self.armed:
            return 5 if self.commander.failsafe else 4
        return 3 if self.arm_refusal() is None else 0

    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        if self.landed:
            return LANDED
        if self.commander.mode == TAKEOFF:
            return TAKING_OFF
        return LANDING if self._navigator.comes_down else IN_AIR

    def acts_alone(self) -> bool:
        """Whether a failsafe acts."""
        return self.commander.failsafe is not None

    def sensor_bits(self) -> tuple[int, int, int]:
        """SYS_STATUS sensors: present, enabled, healthy."""
        # What is watched and not well is enabled, whether it is there or not; the prearm bit is in health alone.
        lost = 0 if self.position_good else _POSITION
        present = _FITTED if self.has_position else _FITTED & ~_GPS
        ready = _PREARM if self.ready and not self.deny_arming else 0
        return present, present | _RECEIVER, (_WELL & ~lost) | ready

    # -- arming -------------------------------------------------------------------------------------------------

    def arm_refusal(self) -> str | None:
        """Why arming would be refused."""
        return self.commander.arm_refusal()

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
        self.commander.begin()
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
        """Stops the motors; the flight is over."""
        armed = self.armed
        super().disarm()
        self.commander.end(armed=armed)

    # -- flight -------------------------------------------------------------------------------------------------

    def wants_up(self) -> bool:
        """Whether the present mode wants to leave the ground."""
        mode = self.commander.mode
        if mode == OFFBOARD:
            point = self.setpoint
            if point is None or not self.commander.setpoint_alive():
                return False
            up, top = point.vel_enu_m_s[2], point.pos_enu_m[2]
            return (up is not None and up > 0.0) or (top is not None and top > self.body.senses.pos_enu_m[2] + 0.05)
        return mode in (TAKEOFF, MISSION)

    def wants_down(self) -> bool:
        """Whether the present mode pushes towards the ground."""
        if self.commander.mode == OFFBOARD:
            point = self.setpoint
            if point is None:
                return False
            down, bottom = point.vel_enu_m_s[2], point.pos_enu_m[2]
            if bottom is not None:
                return bottom < self.body.senses.pos_enu_m[2] - 0.05
            return down is not None and down < -0.02
        return self.commander.failsafe == POSCTL or self._navigator.comes_down

    def update(self, now_ns: int) -> None:
        """Checks what may end a mode, then lets the mode act."""
        if not self.armed:
            return
        self.commander.check(now_ns)
        if not self.armed:
            return
        if not self.taken_off and not self.body.motors.flying:
            self._ramp_up(now_ns)
            return
        if self.landed and not self.wants_up():
            self.body.motors.flying = False
            return
        self._navigator.act()

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
            self.commander.entered = None

    def touched_down(self) -> None:
        """Tells it."""
        if self.armed and self.taken_off:
            self.voice.text(INFO, "Landing detected\t")

    def vision_enabled(self) -> bool:
        """EKF2_EV_CTRL has the bits of horizontal and vertical position."""
        return whole(self.params["EKF2_EV_CTRL"]) & 3 == 3

    def mission_ends(self, end: MissionEnd) -> None:
        """PX4 holds when its mission is over; it shows AUTO.LAND or AUTO.RTL where that was asked for."""
        self._orders.change_mode(_MISSION_ENDS[end])

    def unknown_param(self, name: str) -> None:
        """PX4 tells so and sends no value."""
        self.voice.text(ERROR, f"[pm] unknown param: {name}\t")
