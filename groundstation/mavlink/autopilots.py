"""What differs from autopilot to autopilot: mode words, commands, streams. One class each, no ``if`` elsewhere.

Facts come from the MAVLink definitions and from what the firmware was seen to do (docs/vehicles.md). Nothing here
keeps state or sends bytes.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from groundstation.mavlink.codec import message_id
from groundstation.mavlink.commands import Command
from groundstation.mavlink.failsafes import ArduCopterFailsafes, Failsafes, Px4Failsafes

CMD_NAV_LAND = 21
CMD_NAV_TAKEOFF = 22
CMD_DO_SET_MODE = 176
CMD_COMPONENT_ARM_DISARM = 400
CMD_RUN_PREARM_CHECKS = 401
CMD_SET_MESSAGE_INTERVAL = 511
CMD_REQUEST_MESSAGE = 512
_CUSTOM_MODE_ENABLED = 1.0
_FORCE = 21196.0  # the number that makes COMPONENT_ARM_DISARM act in the air
_STATE_CRITICAL = 5  # MAV_STATE
# What ESTIMATOR_STATUS_FLAGS and EKF_STATUS_FLAGS have in common
_HAS_ATTITUDE, _HAS_VELOCITY_XY, _HAS_VELOCITY_Z, _HAS_POSITION, _HAS_HEIGHT = 0x1, 0x2, 0x4, 0x8 | 0x10, 0x20
_IS_AIDED = 0x100 | 0x200  # PX4: something measures where it is at this time
_NEEDED = (
    (_HAS_ATTITUDE, "has no attitude"),
    (_HAS_VELOCITY_XY, "has no velocity"),
    (_HAS_VELOCITY_Z, "has no vertical velocity"),
    (_HAS_POSITION, "has no position"),
    (_HAS_HEIGHT, "has no height"),
)

MASK_VELOCITY_AND_YAW = 0x09C7
"""POSITION_TARGET_TYPEMASK that leaves velocity and yaw to us and ignores position, acceleration and yaw rate."""
FRAME_LOCAL_NED = 1  # MAV_FRAME


class Autopilot(ABC):
    """How one kind of autopilot is asked for things."""

    name: str
    mav_autopilot: int
    profile: str
    """What a vehicle of half a metre under it flies like (``mission.plan.profiles``), where nobody has said."""
    takes_origin = False
    """Whether SET_GPS_GLOBAL_ORIGIN moves the estimator's origin once there is one."""
    chatter: tuple[str, ...] = ()
    """Streams that it may send unasked and that nobody here needs; stopped on narrow links."""
    params_bytewise = False
    """Whether integer parameters lie in the bytes of the float that they travel in; else they are cast to it."""
    estimator_message: str
    """Message that tells how its estimator does."""
    oldest: tuple[int, int]
    """Version before which what is relied on here was not there."""
    tried: tuple[int, int]
    """Version from which on failsafes act as described in docs/preflight.md."""
    failsafes: Failsafes
    """What its parameters should say about flying on without us."""

    def arm(self) -> Command:
        """Command that arms, with the autopilot's own checks."""
        return Command("arm", CMD_COMPONENT_ARM_DISARM, (1.0,))

    def disarm(self) -> Command:
        """Command that disarms on the ground; refused in the air."""
        return Command("disarm", CMD_COMPONENT_ARM_DISARM, (0.0,))

    def kill(self) -> Command:
        """Command that stops the motors at once, in the air too."""
        return Command("kill", CMD_COMPONENT_ARM_DISARM, (0.0, _FORCE))

    def message_interval(self, message: str, rate_hz: float) -> Command:
        """Command that sets the rate of a stream; at most that often, as the vehicle's clock divides."""
        interval_us = round(1e6 / rate_hz)
        return Command(
            f"{rate_hz:.3g} Hz of {message}",
            CMD_SET_MESSAGE_INTERVAL,
            (float(message_id(message)), float(interval_us)),
            asks=True,
        )

    def silence(self, message: str) -> Command:
        """Command that stops a stream."""
        return Command(f"no {message}", CMD_SET_MESSAGE_INTERVAL, (float(message_id(message)), -1.0), asks=True)

    def once(self, message: str) -> Command:
        """Command that asks for one message now."""
        return Command(f"one {message}", CMD_REQUEST_MESSAGE, (float(message_id(message)),), asks=True)

    def run_prearm_checks(self) -> Command:
        """Command that makes it say by STATUSTEXT why it would not be armed; refused when armed, arms nothing.

        ArduCopter tells "PreArm: ..." each time; PX4 reports its failing checks anew.
        """
        return Command("its own checks", CMD_RUN_PREARM_CHECKS, asks=True)

    def takeoff(self, height_m: float) -> Command | None:
        """Command that climbs to a height above where it stands, None where velocity setpoints do it.

        With a command, setpoints begin only when the climb is over: they would end it.
        """
        return None

    @abstractmethod
    def streaming_mode(self) -> Command:
        """Command for the mode that follows our velocity setpoints."""

    @abstractmethod
    def idle_mode(self) -> Command:
        """Command for a mode to stand on the ground in; after a flight the mode may be one that cannot be armed in."""

    @abstractmethod
    def is_streaming_mode(self, custom_mode: int) -> bool:
        """Whether a heartbeat's mode word is that mode."""

    @abstractmethod
    def land(self) -> Command:
        """Command that lands where the vehicle is."""

    @abstractmethod
    def is_landing_mode(self, custom_mode: int) -> bool:
        """Whether a heartbeat's mode word says that it lands."""

    @abstractmethod
    def mode_name(self, custom_mode: int) -> str:
        """A mode word for people."""

    tells_home_locally = True
    """Whether HOME_POSITION says where home is in the vehicle's own frame, too."""

    @abstractmethod
    def is_flown_by_pilot(self, custom_mode: int, system_status: int) -> bool:
        """Whether somebody's sticks fly it; a failsafe that shows a mode for sticks is none."""

    def estimator_trouble(self, flags: int) -> str | None:
        """Why its estimator cannot be flown by, in words; None when it can.

        Args:
            flags: of ``estimator_message``.
        """
        return next((words for needed, words in _NEEDED if not flags & needed), None)

    @abstractmethod
    def is_followed_closely(self, custom_mode: int, system_status: int) -> bool:
        """Whether its mode says that setpoints are arriving at this very time."""


class Px4(Autopilot):
    """PX4: OFFBOARD needs a live stream of setpoints first; climbing by offboard velocity works.

    custom_mode is sub mode << 24 | main mode << 16 (px4_custom_mode.h).
    """

    name = "px4"
    mav_autopilot = 12  # MAV_AUTOPILOT_PX4
    profile = "px4_quad"
    takes_origin = True
    params_bytewise = True
    estimator_message = "ESTIMATOR_STATUS"
    oldest, tried = (1, 12), (1, 14)
    failsafes = Px4Failsafes()
    chatter = (
        "ATTITUDE", "HIGHRES_IMU", "ODOMETRY", "ALTITUDE", "VFR_HUD", "POSITION_TARGET_LOCAL_NED", "GPS_RAW_INT",
        "TIMESYNC", "ESTIMATOR_STATUS", "BATTERY_STATUS", "HOME_POSITION", "SYSTEM_TIME", "ATTITUDE_TARGET",
        "DISTANCE_SENSOR", "SERVO_OUTPUT_RAW", "POSITION_TARGET_GLOBAL_INT", "SCALED_PRESSURE", "MISSION_CURRENT",
        "PING", "VIBRATION", "OPEN_DRONE_ID_LOCATION", "OPEN_DRONE_ID_SYSTEM",
    )  # fmt: skip
    _MAIN_OFFBOARD = 6
    _MAIN_AUTO = 4
    _SUB_LAND = 6
    _MAIN_NAMES = {  # noqa: RUF012 - never written to
        1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED",
    }  # fmt: skip
    _AUTO_NAMES = {  # noqa: RUF012 - never written to
        1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND",
    }  # fmt: skip

    def streaming_mode(self) -> Command:
        """DO_SET_MODE to OFFBOARD."""
        return Command("OFFBOARD mode", CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, float(self._MAIN_OFFBOARD)))

    def idle_mode(self) -> Command:
        """DO_SET_MODE to AUTO.LOITER; after a flight OFFBOARD stays what was asked for."""
        return Command("hold mode", CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, float(self._MAIN_AUTO), 3.0))

    def is_streaming_mode(self, custom_mode: int) -> bool:
        """Main mode OFFBOARD."""
        return custom_mode >> 16 & 0xFF == self._MAIN_OFFBOARD

    def land(self) -> Command:
        """NAV_LAND here, keeping the heading; PX4 answers it by switching to AUTO.LAND."""
        return Command("land", CMD_NAV_LAND, (0.0, 0.0, 0.0, math.nan, math.nan, math.nan, 0.0))

    def is_landing_mode(self, custom_mode: int) -> bool:
        """AUTO.LAND."""
        return custom_mode >> 16 & 0xFF == self._MAIN_AUTO and custom_mode >> 24 == self._SUB_LAND

    def mode_name(self, custom_mode: int) -> str:
        """For example OFFBOARD or AUTO.LAND."""
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24
        if main == self._MAIN_AUTO:
            return f"AUTO.{self._AUTO_NAMES.get(sub, sub)}"
        return self._MAIN_NAMES.get(main, f"mode {custom_mode}")

    def is_flown_by_pilot(self, custom_mode: int, system_status: int) -> bool:
        """Any mode but AUTO and OFFBOARD, unless a failsafe acts."""
        flies_itself = custom_mode >> 16 & 0xFF in (self._MAIN_AUTO, self._MAIN_OFFBOARD)
        return not flies_itself and system_status < _STATE_CRITICAL

    def estimator_trouble(self, flags: int) -> str | None:
        """By what measures its position; constant position mode (0x80) says nothing.

        From 1.16 on that flag is set whenever the vehicle stands still, and before it was set with "no velocity" only.
        """
        if flags & 0x400:  # ESTIMATOR_GPS_GLITCH
            return "finds GPS far from where it believes to be"
        if (trouble := super().estimator_trouble(flags)) is not None:
            return trouble
        return None if flags & _IS_AIDED else "has nothing that measures its position"

    def is_followed_closely(self, custom_mode: int, system_status: int) -> bool:
        """OFFBOARD lasts as long as its setpoints."""
        return self.is_streaming_mode(custom_mode) and system_status < _STATE_CRITICAL


class ArduCopter(Autopilot):
    """ArduCopter: GUIDED needs a position estimate and no setpoints; only a takeoff command lifts off.

    custom_mode is the mode number (ArduCopter's mode.h).
    """

    name = "arducopter"
    mav_autopilot = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA
    profile = "arducopter"
    estimator_message = "EKF_STATUS_REPORT"
    oldest, tried = (4, 0), (4, 3)
    failsafes = ArduCopterFailsafes()
    _GUIDED, _LAND = 4, 9
    _NAMES = {  # noqa: RUF012 - never written to
        0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE", 9: "LAND",
        16: "POSHOLD", 17: "BRAKE", 20: "GUIDED_NOGPS", 21: "SMART_RTL",
    }  # fmt: skip
    _FLIES_ITSELF = frozenset({3, 4, 6, 9, 17, 21})

    def takeoff(self, height_m: float) -> Command:
        """NAV_TAKEOFF: the height is above home, which is where it was armed; it must be in GUIDED and armed."""
        return Command("takeoff", CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, math.nan, 0.0, 0.0, height_m))

    def streaming_mode(self) -> Command:
        """DO_SET_MODE to GUIDED."""
        return Command("GUIDED mode", CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, float(self._GUIDED)))

    def idle_mode(self) -> Command:
        """DO_SET_MODE to STABILIZE, which needs no position; after a flight it stays in LAND."""
        return Command("STABILIZE mode", CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, 0.0))

    def is_streaming_mode(self, custom_mode: int) -> bool:
        """GUIDED."""
        return custom_mode == self._GUIDED

    def land(self) -> Command:
        """DO_SET_MODE to LAND: it comes down where it is, and disarms."""
        return Command("LAND mode", CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, float(self._LAND)))

    def is_landing_mode(self, custom_mode: int) -> bool:
        """LAND."""
        return custom_mode == self._LAND

    def mode_name(self, custom_mode: int) -> str:
        """For example GUIDED."""
        return self._NAMES.get(custom_mode, f"mode {custom_mode}")

    tells_home_locally = False

    def is_flown_by_pilot(self, custom_mode: int, system_status: int) -> bool:
        """Any mode but those in which it flies by itself."""
        return custom_mode not in self._FLIES_ITSELF

    def estimator_trouble(self, flags: int) -> str | None:
        """EKF_UNINITIALIZED and EKF_GPS_GLITCHING are flags of its own; constant position mode is one without GPS."""
        if flags & 0x400:
            return "has not begun"
        if flags & 0x80:
            return "has nothing that measures its position"
        if flags & 0x8000:
            return "sees GPS jump"
        return super().estimator_trouble(flags)

    def is_followed_closely(self, custom_mode: int, system_status: int) -> bool:
        """Never known: GUIDED hovers on when setpoints end."""
        return False


AUTOPILOTS: dict[str, Autopilot] = {autopilot.name: autopilot for autopilot in (Px4(), ArduCopter())}
