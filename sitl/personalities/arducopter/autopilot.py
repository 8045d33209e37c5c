"""ArduCopter's behaviour: what it shows, how it arms, lifts off and touches down.

Follows what ArduCopter 4.7.0-dev of mid 2025 was seen to do.
"""

from __future__ import annotations

from typing import ClassVar

from sitl.autopilot import IN_AIR, LANDED, LANDING, TAKING_OFF, Autopilot
from sitl.body import Body
from sitl.config import SECOND, VehicleConfig
from sitl.mavlink_ids import (
    ACCEPTED,
    FAILED,
    MSG_ATT_POS_MOCAP,
    MSG_ODOMETRY,
    MSG_VICON_POSITION_ESTIMATE,
    MSG_VISION_POSITION_ESTIMATE,
)
from sitl.mission import MissionEnd
from sitl.outfit import Outfit
from sitl.personalities.arducopter.failsafes import Failsafes
from sitl.personalities.arducopter.flight import Flight
from sitl.personalities.arducopter.modes import (
    CRITICAL,
    GUIDED,
    GUIDED_FLAG,
    INFO,
    LAND,
    NAMES,
    NEED_POSITION,
    NOT_ARMABLE,
    RTL,
    SMART_RTL,
)
from sitl.personalities.arducopter.orders import Orders
from sitl.personalities.arducopter.words import Words
from sitl.vision import LOCAL_FRD, Vision
from sitl.wire import Fields

_PRESENT = 0x5371FC2F  # a fence (0x100000) is there, and not enabled, before one is set up
_ENABLED, _WELL = 0x52419C2F, 0x47519C2F  # while it holds no position
_HOLDS, _AHRS, _LOGGING, _PREARM = 0x6000, 0x200000, 0x1000000, 0x10000000
_EXTERNAL_NAV = 6
_AFTER_LANDING_S = 0.5
_MISSION_ENDS = {MissionEnd.LANDS: LAND, MissionEnd.RETURNS: RTL}


class ArduCopter(Autopilot):
    """One vehicle under ArduCopter."""

    mav_autopilot = 3
    param_bytewise = False
    commands_to_system_0 = True
    accepts_unready = True
    first_item_is_home = True
    vision_needs_origin = True
    version_fields: ClassVar[Fields] = {
        "capabilities": 0x2 | 0x4 | 0x8 | 0x80 | 0x100 | 0x800 | 0x1000 | 0x2000 | 0x20000,
        "flight_sw_version": 0x04070000,
        "board_version": 0,
        "flight_custom_version": b"gs-sitl",
    }

    def __init__(self, body: Body, config: VehicleConfig, outfit: Outfit) -> None:
        super().__init__(body, config, outfit)
        self._flight = Flight(self)
        self._failsafes = Failsafes(self, self._flight)
        self._words = Words(self)
        Orders(self, self._flight)
        self.vision = Vision(
            self,
            (MSG_VISION_POSITION_ESTIMATE, MSG_VICON_POSITION_ESTIMATE, MSG_ATT_POS_MOCAP, MSG_ODOMETRY),
            (LOCAL_FRD,),
        )

    # -- heartbeat ----------------------------------------------------------------------------------------------

    def mode_name(self) -> str:
        """Its name, for people."""
        return NAMES[self._flight.mode]

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the heartbeat."""
        flags = 0x1 | 0x10 | 0x40 | (0x80 if self.armed else 0)
        return flags | 0x8 if self._flight.mode in GUIDED_FLAG else flags

    def custom_mode(self) -> int:
        """The mode number."""
        return self._flight.mode

    def system_status(self) -> int:
        """STANDBY on the ground, ACTIVE in the air."""
        return 3 if self.landed else 4

    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        if self.landed:
            return LANDED
        if self._flight.taking_off_to is not None:
            return TAKING_OFF
        return LANDING if self._flight.landing else IN_AIR

    def acts_alone(self) -> bool:
        """Whether it lands or returns."""
        return self._flight.mode in (LAND, RTL, SMART_RTL)

    def sensor_bits(self) -> tuple[int, int, int]:
        """SYS_STATUS sensors: present, enabled, healthy."""
        known = self.body.senses.has_origin
        common = (_HOLDS if self._flight.mode in GUIDED_FLAG else 0) | (_AHRS if known else 0)
        health = _WELL | common | (_PREARM if self.armed or self.arm_refusal() is None else 0)
        if known and not self.position_good:
            health &= ~_AHRS
        return _PRESENT, _ENABLED | common | (_LOGGING if self.armed else 0), health

    def started(self) -> None:
        """Says who it is."""
        self._words.begin()

    def position_found(self) -> None:
        """Tells about it."""
        super().position_found()
        self._words.position_found()

    # -- arming -------------------------------------------------------------------------------------------------

    def arm_refusal(self) -> str | None:
        """Why arming would be refused."""
        mode = self._flight.mode
        if self.deny_arming:
            return "PreArm: Compass not healthy"
        if self.age_ns < self.boot.ready_ns:
            half = self.age_ns < self.boot.ready_ns // 2
            return "PreArm: EKF attitude is bad" if half else "PreArm: AHRS: waiting for home"
        if mode in NOT_ARMABLE:
            return f"Arm: {NAMES[mode]} mode not armable"
        if mode in NEED_POSITION and not self.position_good:
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
        self._flight.begin()
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
        self._flight.taking_off_to = None

    # -- flight -------------------------------------------------------------------------------------------------

    def wants_up(self) -> bool:
        """Whether the present mode wants to leave the ground."""
        return self._flight.wants_up

    def wants_down(self) -> bool:
        """Whether the present mode pushes towards the ground."""
        point = self.setpoint
        if self._flight.mode == GUIDED and point is not None:
            down, bottom = point.vel_enu_m_s[2], point.pos_enu_m[2]
            here = self.body.senses.pos_enu_m[2]
            return (down is not None and down < -0.05) or (bottom is not None and bottom < here - 0.05)
        return self._flight.landing

    def touched_down(self) -> None:
        """Motors stop a moment later."""
        self.setpoint = None

    def update(self, now_ns: int) -> None:
        """Checks the failsafes, then lets the mode act."""
        self._words.step()
        if not self.armed:
            return
        self._failsafes.check(now_ns)
        flight, motors = self._flight, self.body.motors
        if self.landed:
            delay_s = self.params["DISARM_DELAY"]
            since = self.landed_ns if self.taken_off else self.armed_ns
            if self.taken_off and flight.landing:
                delay_s = _AFTER_LANDING_S
            if delay_s > 0 and now_ns - since >= delay_s * SECOND and not flight.wants_up:
                self.disarm()
                return
            if not motors.flying:
                if not flight.may_lift(now_ns):
                    return
                motors.flying = True
                flight.enter()
        flight.act(now_ns)

    def vision_enabled(self) -> bool:
        """VISO_TYPE is set and the estimator's first source is the external one."""
        return self.params["VISO_TYPE"] > 0 and self.params["EK3_SRC1_POSXY"] == _EXTERNAL_NAV

    def mission_ends(self, end: MissionEnd) -> None:
        """Lands or returns where that was asked for, shown as LAND or RTL; it stays in AUTO when it is over."""
        if end in _MISSION_ENDS:
            self._flight.change(_MISSION_ENDS[end])
