"""What the gateway is to do by itself, as parameters that a ground station reads and sets: the vehicle has none of it.

Names stand beside the firmware's own (``names``); ground stations know them by
``groundstation.mavlink.autopilots.crazyflie``.
"""

from __future__ import annotations

import math

HOLD, RETURN, LAND = range(3)
LIMITS: dict[str, tuple[float, float, float]] = {
    "GW_LOSS_ACT": (float(LAND), 0.0, 2.0),
    "GW_LOSS_S": (10.0, 2.0, 600.0),
    "GW_RTL_ALT_M": (1.0, 0.2, 10.0),
    "GW_RTL_WAIT_S": (0.0, 0.0, 600.0),
    "GW_SETP_LOSS_S": (0.3, 0.1, 0.4),
    "GW_SETP_HZ": (50.0, 5.0, 100.0),
    "GW_SPEED_M_S": (2.0, 0.1, 5.0),
}
"""Name: what it is at first, the least and the most.

GW_LOSS_ACT: without the ground station, 0 hold, 1 return, 2 land; GW_LOSS_S after its last heartbeat. GW_RTL_ALT_M:
height of the return above where it took off, GW_RTL_WAIT_S: before it lands. GW_SETP_LOSS_S: without setpoints it is
held after this time, before the firmware levels out at 0.5 s. GW_SETP_HZ: most setpoints a second over the radio.
GW_SPEED_M_S: longer velocities are cut to this.
"""


class Settings:
    """One vehicle's."""

    def __init__(self) -> None:
        self._values = {name: first for name, (first, _, _) in LIMITS.items()}

    def __getitem__(self, name: str) -> float:
        """The value of one that there is."""
        return self._values[name]

    def set_value(self, name: str, value: float) -> bool:
        """Sets one; returns whether it did: what is outside its limits is refused, not cut."""
        _, least, most = LIMITS[name]
        if not math.isfinite(value) or not least <= value <= most:
            return False
        self._values[name] = value
        return True
