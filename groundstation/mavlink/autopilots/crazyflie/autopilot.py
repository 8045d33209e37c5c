"""A Crazyflie as its gateway shows it (``groundstation.gateway``): modes, takeoff and landing by command."""

from __future__ import annotations

import math

from groundstation.mavlink.autopilot import (
    CMD_DO_SET_MODE,
    CMD_NAV_LAND,
    CMD_NAV_TAKEOFF,
    CUSTOM_MODE_ENABLED,
    STATE_CRITICAL,
    Autopilot,
)
from groundstation.mavlink.autopilots.crazyflie.failsafes import CrazyflieFailsafes
from groundstation.mavlink.commands import Command


class Crazyflie(Autopilot):
    """Numbers of modes are the gateway's, versions are those of CRTP: 9 turns yaw rates the way they are meant."""

    name = "crazyflie"
    behind_a_gateway = True
    mav_autopilot = 0  # MAV_AUTOPILOT_GENERIC
    profile = "crazyflie"
    follows = (0.13, 0.2)  # of firmware 2026.08 in simulation (docs/crazyflie.md): it answers in an S, nearly all delay
    estimator_message = "ESTIMATOR_STATUS"
    oldest = tried = (9, 0)
    failsafes = CrazyflieFailsafes()
    _STAND, _VELOCITY, _HOLD, _LAND = range(4)
    _NAMES = ("STAND", "VELOCITY", "HOLD", "LAND", "RETURN", "OUT")

    def takeoff(self, height_m: float) -> Command:
        """NAV_TAKEOFF: the height is above where it stands; it must be in VELOCITY and armed."""
        return Command("takeoff", CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, math.nan, 0.0, 0.0, height_m))

    def streaming_mode(self) -> Command:
        """DO_SET_MODE to VELOCITY."""
        return Command("VELOCITY mode", CMD_DO_SET_MODE, (CUSTOM_MODE_ENABLED, float(self._VELOCITY)))

    def idle_mode(self) -> Command:
        """DO_SET_MODE to STAND."""
        return Command("STAND mode", CMD_DO_SET_MODE, (CUSTOM_MODE_ENABLED, float(self._STAND)))

    def is_streaming_mode(self, custom_mode: int) -> bool:
        """VELOCITY."""
        return custom_mode == self._VELOCITY

    def land(self) -> Command:
        """NAV_LAND: sinks where it is, by the high-level commander."""
        return Command("land", CMD_NAV_LAND)

    def is_landing_mode(self, custom_mode: int) -> bool:
        """LAND."""
        return custom_mode == self._LAND

    def mode_name(self, custom_mode: int) -> str:
        """For example VELOCITY; OUT is one whose supervisor lets it fly no more."""
        return self._NAMES[custom_mode] if 0 <= custom_mode < len(self._NAMES) else f"mode {custom_mode}"

    def is_flown_by_pilot(self, custom_mode: int, system_status: int) -> bool:
        """Never: it has no sticks."""
        return False

    def is_followed_closely(self, custom_mode: int, system_status: int) -> bool:
        """Never known: VELOCITY lasts through a takeoff by command."""
        return False

    def waits_for_setpoints(self, custom_mode: int, system_status: int) -> bool:
        """HOLD by the gateway's failsafe, which its status tells."""
        return custom_mode == self._HOLD and system_status >= STATE_CRITICAL
