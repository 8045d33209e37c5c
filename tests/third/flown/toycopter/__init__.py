"""How the toycopter is asked for things."""

from __future__ import annotations

from groundstation.mavlink.autopilot import CMD_DO_SET_MODE, CUSTOM_MODE_ENABLED, Autopilot
from groundstation.mavlink.commands import Command
from groundstation.mavlink.failsafes import Failsafes, Rule, Wish

_STAND, _FOLLOW, _LAND = range(3)


def _mode(words: str, mode: int) -> Command:
    return Command(words, CMD_DO_SET_MODE, (CUSTOM_MODE_ENABLED, float(mode)))


class _NoFailsafes(Failsafes):
    def rules(self, wish: Wish) -> tuple[Rule, ...]:
        return ()


class Toycopter(Autopilot):
    """It stands, follows velocities, or lands."""

    name = "toycopter"
    mav_autopilot = 18
    profile = "crazyflie"
    estimator_message = "ESTIMATOR_STATUS"
    oldest = tried = (0, 0)
    failsafes = _NoFailsafes()

    def streaming_mode(self) -> Command:
        return _mode("FOLLOW mode", _FOLLOW)

    def idle_mode(self) -> Command:
        return _mode("STAND mode", _STAND)

    def is_streaming_mode(self, custom_mode: int) -> bool:
        return custom_mode == _FOLLOW

    def land(self) -> Command:
        return _mode("LAND mode", _LAND)

    def is_landing_mode(self, custom_mode: int) -> bool:
        return custom_mode == _LAND

    def mode_name(self, custom_mode: int) -> str:
        return {_STAND: "STAND", _FOLLOW: "FOLLOW", _LAND: "LAND"}.get(custom_mode, f"mode {custom_mode}")

    def is_flown_by_pilot(self, custom_mode: int, system_status: int) -> bool:
        return False

    def is_followed_closely(self, custom_mode: int, system_status: int) -> bool:
        return False


AUTOPILOT = Toycopter()
