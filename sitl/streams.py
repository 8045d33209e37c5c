"""Streams: which message each vehicle sends at which interval.

``Streams`` keeps the intervals of all vehicles and says who is due. Refuses to make messages, to encode and to send.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
_NEVER = np.iinfo(np.int64).max

ONBOARD_RATES_HZ: dict[str, float] = {
    "ATTITUDE": 99.0,
    "ATTITUDE_QUATERNION": 50.0,
    "HIGHRES_IMU": 50.0,
    "GLOBAL_POSITION_INT": 50.0,
    "LOCAL_POSITION_NED": 30.0,
    "ODOMETRY": 30.0,
    "TIMESYNC": 10.0,
    "ALTITUDE": 10.0,
    "VFR_HUD": 10.0,
    "POSITION_TARGET_LOCAL_NED": 10.0,
    "GPS_RAW_INT": 8.0,
    "ATTITUDE_TARGET": 10.0,
    "DISTANCE_SENSOR": 10.0,
    "SERVO_OUTPUT_RAW": 10.0,
    "SYS_STATUS": 5.0,
    "EXTENDED_SYS_STATE": 5.0,
    "HEARTBEAT": 1.0,
    "ESTIMATOR_STATUS": 1.0,
    "SYSTEM_TIME": 1.0,
    "MISSION_CURRENT": 1.0,
    "PING": 1.0,
    "SCALED_PRESSURE": 1.0,
    "BATTERY_STATUS": 0.5,
    "HOME_POSITION": 0.5,
    "VIBRATION": 0.5,
}
"""PX4's onboard link, as seen unasked."""
GCS_RATES_HZ: dict[str, float] = {
    **ONBOARD_RATES_HZ,
    "ATTITUDE": 50.0,
    "LOCAL_POSITION_NED": 50.0,
    "HIGHRES_IMU": 0.0,
    "DISTANCE_SENSOR": 0.0,
    "PING": 0.0,
}
"""PX4's link to a ground station: as seen for positions and attitude, the others as on the onboard link."""
RADIO_RATES_HZ: dict[str, float] = {
    "HEARTBEAT": 1.0,
    "ATTITUDE": 5.0,
    "LOCAL_POSITION_NED": 1.0,
    "GLOBAL_POSITION_INT": 1.0,
    "SYS_STATUS": 1.0,
    "EXTENDED_SYS_STATE": 1.0,
    "GPS_RAW_INT": 1.0,
    "BATTERY_STATUS": 0.5,
    "SYSTEM_TIME": 1.0,
    "TIMESYNC": 10.0,
}
"""PX4 behind a telemetry radio: LOCAL_POSITION_NED at 1 Hz as seen, the others believable."""
ARDUPILOT_RATES_HZ: dict[str, float] = {"HEARTBEAT": 1.0, "TIMESYNC": 0.1}
"""ArduCopter sends nothing else unasked (STATUSTEXT aside)."""
QUIET_RATES_HZ: dict[str, float] = {"HEARTBEAT": 1.0}
"""Nothing that nobody has asked for: for many runs at once."""
RATES_HZ = {
    "onboard": ONBOARD_RATES_HZ,
    "gcs": GCS_RATES_HZ,
    "radio": RADIO_RATES_HZ,
    "ardupilot": ARDUPILOT_RATES_HZ,
    "quiet": QUIET_RATES_HZ,
}


class Streams:
    """Intervals of all message types for all vehicles, and when each is next due.

    Due times are multiples of the interval, the same for all vehicles, so that a type can be made for all at once.

    Args:
        names: message types that can be streamed.
        n: number of vehicles.
        epoch_ns: time from which the multiples are counted.
    """

    def __init__(self, names: tuple[str, ...], n: int, epoch_ns: int = 0) -> None:
        self.names = names
        self._epoch_ns = epoch_ns
        self._row = {name: row for row, name in enumerate(names)}
        self.interval_ns: IntArray = np.zeros((len(names), n), dtype=np.int64)
        self._due_ns: IntArray = np.full((len(names), n), _NEVER, dtype=np.int64)
        self._soonest_ns = _NEVER

    def set_rates(self, vehicle: int, rates_hz: Mapping[str, float], now_ns: int) -> None:
        """Sets all streams of a vehicle: those that are not named are off."""
        for name in self.names:
            rate = rates_hz.get(name, 0.0)
            self.set_interval(vehicle, name, round(1e9 / rate) if rate else 0, now_ns)

    def set_interval(self, vehicle: int, name: str, interval_ns: int, now_ns: int) -> bool:
        """Sets one stream, 0 for off. Returns False for a type that is never streamed."""
        row = self._row.get(name)
        if row is None:
            return False
        self.interval_ns[row, vehicle] = interval_ns
        now_ns -= self._epoch_ns
        due = (now_ns // interval_ns + 1) * interval_ns if interval_ns else _NEVER
        self._due_ns[row, vehicle] = due
        self._soonest_ns = min(self._soonest_ns, due)
        return True

    def interval(self, vehicle: int, name: str) -> int | None:
        """Interval in ns, 0 for off, None for a type that is never streamed."""
        row = self._row.get(name)
        return None if row is None else int(self.interval_ns[row, vehicle])

    def take_due(self, now_ns: int) -> list[tuple[str, IntArray]]:
        """Lists the types that are due with the vehicles that are to send them, and moves them on."""
        now_ns -= self._epoch_ns
        if now_ns < self._soonest_ns:
            return []
        due = self._due_ns <= now_ns
        rows = np.flatnonzero(due.any(axis=1))
        out = [(self.names[row], np.flatnonzero(due[row])) for row in rows]
        interval = self.interval_ns[due]
        self._due_ns[due] = (now_ns // interval + 1) * interval
        self._soonest_ns = int(self._due_ns.min())
        return out
