"""ArduCopter, as it is asked for things."""

from __future__ import annotations

import math

from groundstation.mavlink.autopilot import CMD_DO_SET_MODE, CMD_NAV_TAKEOFF, CUSTOM_MODE_ENABLED, Autopilot
from groundstation.mavlink.autopilots.arducopter.failsafes import ArduCopterFailsafes
from groundstation.mavlink.commands import Command


class ArduCopter(Autopilot):
    """ArduCopter: GUIDED needs a position estimate and no setpoints; only a takeoff command lifts off.

    custom_mode is the mode number (ArduCopter's mode.h).
    """

    name = "arducopter"
    by_hand = {"sticks": (2, 0), "hold": (5, 0), "land": (9, 0)}  # noqa: RUF012 - never written to
    needs_origin = True
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
        return Command("GUIDED mode", CMD_DO_SET_MODE, (CUSTOM_MODE_ENABLED, float(self._GUIDED)))

    def idle_mode(self) -> Command:
        """DO_SET_MODE to STABILIZE, which needs no position; after a flight it stays in LAND."""
        return Command("STABILIZE mode", CMD_DO_SET_MODE, (CUSTOM_MODE_ENABLED, 0.0))

    def is_streaming_mode(self, custom_mode: int) -> bool:
        """GUIDED."""
        return custom_mode == self._GUIDED

    def land(self) -> Command:
        """DO_SET_MODE to LAND: it comes down where it is, and disarms."""
        return Command("LAND mode", CMD_DO_SET_MODE, (CUSTOM_MODE_ENABLED, float(self._LAND)))

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
