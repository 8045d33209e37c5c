"""What ArduCopter does on its own: ground station lost, estimator lost, battery low."""

from __future__ import annotations

from sitl.autopilot import Autopilot
from sitl.config import SECOND
from sitl.personalities.arducopter.flight import Flight
from sitl.personalities.arducopter.modes import BRAKE, CRITICAL, LAND, NAMES, NEED_POSITION, RTL, WARNING
from sitl.wire import whole

_STATION_LOST = {5: LAND, 7: BRAKE}  # FS_GCS_ENABLE; the others return, some by the way they came


class Failsafes:
    """One vehicle's."""

    def __init__(self, pilot: Autopilot, flight: Flight) -> None:
        self._pilot, self._flight = pilot, flight
        self._battery_told = False

    def check(self, now_ns: int) -> None:
        """Looks at everything that may end a mode."""
        pilot, flight, params = self._pilot, self._flight, self._pilot.params
        heard = pilot.gcs_heard_ns
        if params["FS_GCS_ENABLE"] and heard is not None and not pilot.landed:
            lost = now_ns - heard > params["FS_GCS_TIMEOUT"] * SECOND
            if lost and flight.mode not in (RTL, LAND, BRAKE):
                mode = _STATION_LOST.get(whole(params["FS_GCS_ENABLE"]), RTL)
                pilot.voice.text(WARNING, f"GCS Failsafe - {NAMES[mode]}")
                flight.change(mode)
        if not pilot.position_good and flight.mode in NEED_POSITION and not pilot.landed:
            pilot.voice.text(CRITICAL, "EKF Failsafe: changed to LAND Mode")
            flight.change(LAND)
        if self._battery_low() and flight.mode not in (RTL, LAND) and not pilot.landed:
            flight.change(LAND if whole(params["BATT_FS_LOW_ACT"]) == 1 else RTL)

    def _battery_low(self) -> bool:
        """Tells once about a low battery; True when something is to be done about it."""
        pilot = self._pilot
        low = pilot.battery.left * pilot.battery.capacity_mah < pilot.params["BATT_LOW_MAH"]
        if low and not self._battery_told:
            self._battery_told = True
            pilot.voice.text(WARNING, "Battery 1 is low")
        return low and whole(pilot.params["BATT_FS_LOW_ACT"]) > 0
