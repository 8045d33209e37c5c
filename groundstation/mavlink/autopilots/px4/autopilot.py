"""PX4, as it is asked for things."""

from __future__ import annotations

import math

from groundstation.mavlink.autopilot import (
    CMD_DO_SET_MODE,
    CMD_NAV_LAND,
    CUSTOM_MODE_ENABLED,
    STATE_CRITICAL,
    Autopilot,
)
from groundstation.mavlink.autopilots.px4.failsafes import Px4Failsafes
from groundstation.mavlink.commands import Command

_IS_AIDED = 0x100 | 0x200  # something measures where it is at this time


class Px4(Autopilot):
    """PX4: OFFBOARD needs a live stream of setpoints first; climbing by offboard velocity works.

    custom_mode is sub mode << 24 | main mode << 16 (px4_custom_mode.h).
    """

    name = "px4"
    by_hand = {"sticks": (3, 0), "hold": (4, 3), "land": (4, 6)}  # noqa: RUF012 - never written to
    usual = True
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
    _SUB_LOITER = 3
    _SUB_LAND = 6
    _MAIN_NAMES = {  # noqa: RUF012 - never written to
        1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED",
    }  # fmt: skip
    _AUTO_NAMES = {  # noqa: RUF012 - never written to
        1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND",
    }  # fmt: skip

    def streaming_mode(self) -> Command:
        """DO_SET_MODE to OFFBOARD."""
        return Command("OFFBOARD mode", CMD_DO_SET_MODE, (CUSTOM_MODE_ENABLED, float(self._MAIN_OFFBOARD)))

    def idle_mode(self) -> Command:
        """DO_SET_MODE to AUTO.LOITER; after a flight OFFBOARD stays what was asked for."""
        return Command(
            "hold mode", CMD_DO_SET_MODE, (CUSTOM_MODE_ENABLED, float(self._MAIN_AUTO), float(self._SUB_LOITER))
        )

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
        return not flies_itself and system_status < STATE_CRITICAL

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
        return self.is_streaming_mode(custom_mode) and system_status < STATE_CRITICAL

    def waits_for_setpoints(self, custom_mode: int, system_status: int) -> bool:
        """AUTO.LOITER by a failsafe, which its status tells: OFFBOARD is still what was asked for."""
        holds = custom_mode >> 16 & 0xFF == self._MAIN_AUTO and custom_mode >> 24 == self._SUB_LOITER
        return holds and system_status >= STATE_CRITICAL
