"""What a Crazyflie logs, in the units and frames of the ground station.

Log variables and their units: documentation of the firmware (stateEstimateZ in mm and mm/s, quaternion packed into
32 bits as in quatcompress.h; supervisor.info as in supervisor.c). Refuses to guess what was not logged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

from groundstation.gateway.orders import ExternalPose, Place

POSE_VARIABLES = (
    *(f"stateEstimateZ.{axis}" for axis in "xyz"),
    *(f"stateEstimateZ.v{axis}" for axis in "xyz"),
    "stateEstimateZ.quat",
    "supervisor.info",
)
"""What is logged together, 18 bytes: a pose is never put together from two packets."""
STATUS_VARIABLES = ("pm.vbat", "pm.state", "kalman.varPX", "kalman.varPY", "kalman.varPZ")
STATUS_MS = 500
"""Between two packets of those."""
_MAGNITUDE = 511.0
_DECK_FAILED = 11  # bit; 8 to 10 are the high-level commander's
_HALF = math.sqrt(0.5)
# Volts of one cell and what is left. Standing: a LiPo cell at rest. In the air: of a Crazyflie 2.1 hovering, by its
# makers' warning at 3.2 V and shutdown at 3.0 V; a guess between those, on the low side.
_AT_REST = ((3.3, 0.0), (3.6, 0.15), (3.75, 0.4), (3.85, 0.6), (4.0, 0.85), (4.15, 1.0))
_IN_THE_AIR = ((3.0, 0.0), (3.2, 0.05), (3.4, 0.25), (3.55, 0.5), (3.7, 0.75), (3.9, 1.0))


@dataclass(frozen=True)
class Pose:
    """A pose as the vehicle's estimator has it.

    Attributes:
        pos_enu_m, vel_enu_m_s: in the room's frame.
        quat_ned_from_frd: w x y z, w >= 0.
        yaw_enu_rad: heading from x (east), counter-clockwise.
        bits: of the supervisor.
    """

    pos_enu_m: Place
    vel_enu_m_s: Place
    quat_ned_from_frd: tuple[float, float, float, float]
    yaw_enu_rad: float
    bits: int


def unpacked_quaternion(packed: int) -> tuple[float, float, float, float]:
    """Quaternion x, y, z, w of 32 bits: which part is the largest, then sign and 9 bits of each other one."""
    largest = packed >> 30 & 3
    parts = [0.0] * 4
    for k in (3, 2, 1, 0):
        if k != largest:
            size = (packed & 0x1FF) / _MAGNITUDE * _HALF
            parts[k] = -size if packed & 0x200 else size
            packed >>= 10
    parts[largest] = math.sqrt(max(0.0, 1.0 - math.fsum(part * part for part in parts)))
    return parts[0], parts[1], parts[2], parts[3]


def quat_ned_from_frd(x: float, y: float, z: float, w: float) -> tuple[float, float, float, float]:
    """Attitude w x y z, body FRD to NED, of one that takes body FLU to ENU.

    NED from ENU is a half turn about (1, 1, 0) / sqrt 2, FLU from FRD a half turn about x: the product of the three.
    """
    turned = (_HALF * (w + z), _HALF * (x + y), _HALF * (x - y), _HALF * (w - z))
    sign = -1.0 if turned[0] < 0.0 else 1.0
    return sign * turned[0], sign * turned[1], sign * turned[2], sign * turned[3]


def read_pose(values: Mapping[str, float]) -> Pose | None:
    """The pose of a packet; None where a number is missing or none."""
    try:
        numbers = [float(values[name]) for name in POSE_VARIABLES]
    except KeyError:
        return None
    if not all(map(math.isfinite, numbers)):
        return None
    px, py, pz, vx, vy, vz = (number / 1000.0 for number in numbers[:6])
    x, y, z, w = unpacked_quaternion(int(numbers[6]))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return Pose((px, py, pz), (vx, vy, vz), quat_ned_from_frd(x, y, z, w), yaw, int(numbers[7]))


def charge(volts: float, *, flies: bool) -> float:
    """What is left in the battery, 0 to 1, by its voltage, which sags while it flies; NaN for a voltage of 0."""
    if not volts > 0.0:
        return math.nan
    curve = _IN_THE_AIR if flies else _AT_REST
    if volts <= curve[0][0]:
        return 0.0
    for (low_v, low), (high_v, high) in pairwise(curve):
        if volts <= high_v:
            return low + (high - low) * (volts - low_v) / (high_v - low_v)
    return 1.0


class Supervisor:
    """The supervisor's bits in words.

    Args:
        bits: as logged in ``supervisor.info``.
    """

    def __init__(self, bits: int) -> None:
        names = ("can_be_armed", "armed", "auto_armed", "can_fly", "flies", "tumbled", "locked", "crashed")
        self.deck_failed = bool(bits >> _DECK_FAILED & 1)
        flags = {name: bool(bits >> k & 1) for k, name in enumerate(names)}
        self.can_be_armed, self.armed, self.auto_armed = flags["can_be_armed"], flags["armed"], flags["auto_armed"]
        self.can_fly, self.flies = flags["can_fly"], flags["flies"]
        self.tumbled, self.locked, self.crashed = flags["tumbled"], flags["locked"], flags["crashed"]

    def trouble(self) -> str | None:
        """Why it will not fly, with what to do; None when it will."""
        if self.locked:
            return "locked by its supervisor, its motors stay off; look at it, then switch it off and on"
        if self.crashed:
            return "crashed, by its own report; look at it, stand it upright, then restart it by a ground station"
        if self.tumbled:
            return "tumbled: lies on its side or back; stand it upright"
        if self.deck_failed:
            return "one of its decks has failed, by its own report; switch it off, see how its decks sit, and on again"
        if not (self.can_fly or self.can_be_armed):
            return "cannot fly, by its own report; let it stand still, see to its battery and self-test"
        return None


def enu_from_flu(w: float, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Attitude x y z w that takes FLU to ENU, as the firmware has it, of one that takes FRD to NED."""
    return _HALF * (x + y), _HALF * (x - y), _HALF * (w - z), _HALF * (w + z)


def external_pose(north: float, east: float, down: float, *quat: float) -> ExternalPose:
    """What a vehicle is told of a place in NED, m, and of a quaternion w x y z that takes FRD to NED, where known."""
    known = len(quat) == 4 and all(map(math.isfinite, quat))
    return ExternalPose((east, north, -down), enu_from_flu(*quat) if known else None)
