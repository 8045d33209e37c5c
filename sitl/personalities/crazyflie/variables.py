"""Log variables: the names and types of those that people use, and where each value comes from.

Units as the firmware has them (m, degrees, volts), so that a client made for it needs no other. Refuses to send.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from sitl.battery import Battery
from sitl.body import Body
from sitl.personalities.crazyflie.crtp import packed_quaternion
from sitl.personalities.crazyflie.poses import Poses
from sitl.personalities.crazyflie.supervisor import Supervisor

U8, U16, U32, I8, I16, I32, F32, F16 = range(1, 9)
SHAPES = {U8: "B", U16: "H", U32: "I", I8: "b", I16: "h", I32: "i", F32: "f", F16: "e"}
_GRAVITY_M_S2 = 9.80665


class Logged(Protocol):
    """A vehicle whose variables can be logged.

    Attributes:
        body, battery, supervisor, poses: its parts.
        packets_in: how many packets it has been sent.
    """

    body: Body
    battery: Battery
    supervisor: Supervisor
    poses: Poses
    packets_in: int


Reading = Callable[[Logged], float]


def tilt_deg(vehicle: Logged) -> tuple[float, float]:
    """Roll (right side down) and pitch (nose up), as the firmware logs them."""
    senses = vehicle.body.senses
    x, y, z = senses.up_enu
    c, s = math.cos(senses.yaw_enu_rad), math.sin(senses.yaw_enu_rad)
    forward, left = c * x + s * y, c * y - s * x
    return math.degrees(math.atan2(-left, z)), -math.degrees(math.atan2(forward, math.hypot(left, z)))


def _quaternion(vehicle: Logged) -> float:
    roll, pitch = (math.radians(angle) / 2.0 for angle in tilt_deg(vehicle))
    yaw, pitch = vehicle.body.senses.yaw_enu_rad / 2.0, -pitch
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    return packed_quaternion(
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _pos(axis: int, scale: float = 1.0) -> Reading:
    return lambda vehicle: vehicle.body.senses.pos_enu_m[axis] * scale


def _vel(axis: int, scale: float = 1.0) -> Reading:
    return lambda vehicle: vehicle.body.senses.vel_enu_m_s[axis] * scale


def _bit(number: int) -> Reading:
    return lambda vehicle: float(vehicle.supervisor.bits() >> number & 1)


def _yaw(vehicle: Logged) -> float:
    return math.degrees(vehicle.body.senses.yaw_enu_rad)


def _thrust(vehicle: Logged) -> float:
    return min(65535.0, 36000.0 * vehicle.body.motors.thrust_m_s2 / _GRAVITY_M_S2)


def _power_state(vehicle: Logged) -> float:
    return 3.0 if vehicle.battery.voltage_v < 3.2 else 0.0


VARIABLES: dict[str, tuple[int, Reading]] = {
    **{f"kalman.varP{'XYZ'[k]}": (F32, lambda vehicle: vehicle.poses.variance_m2) for k in range(3)},
    "pm.batteryLevel": (U8, lambda vehicle: vehicle.battery.percent()),
    "pm.state": (I8, _power_state),
    "pm.vbat": (F32, lambda vehicle: vehicle.battery.voltage_v),
    "pm.vbatMV": (U16, lambda vehicle: vehicle.battery.voltage_v * 1000.0),
    "radio.isConnected": (U8, lambda _: 1.0),
    "radio.numRxUc": (U16, lambda vehicle: vehicle.packets_in & 0xFFFF),
    "radio.rssi": (U8, lambda _: 40.0),
    "stabilizer.pitch": (F32, lambda vehicle: tilt_deg(vehicle)[1]),
    "stabilizer.roll": (F32, lambda vehicle: tilt_deg(vehicle)[0]),
    "stabilizer.thrust": (F32, _thrust),
    "stabilizer.yaw": (F32, _yaw),
    "stateEstimate.pitch": (F32, lambda vehicle: tilt_deg(vehicle)[1]),
    "stateEstimate.roll": (F32, lambda vehicle: tilt_deg(vehicle)[0]),
    **{f"stateEstimate.v{'xyz'[k]}": (F32, _vel(k)) for k in range(3)},
    **{f"stateEstimate.{'xyz'[k]}": (F32, _pos(k)) for k in range(3)},
    "stateEstimate.yaw": (F32, _yaw),
    "stateEstimateZ.quat": (U32, _quaternion),
    **{f"stateEstimateZ.v{'xyz'[k]}": (I16, _vel(k, 1000.0)) for k in range(3)},
    **{f"stateEstimateZ.{'xyz'[k]}": (I16, _pos(k, 1000.0)) for k in range(3)},
    "supervisor.info": (U16, lambda vehicle: vehicle.supervisor.bits()),
    "sys.armed": (U8, _bit(1)),
    "sys.canfly": (U8, _bit(3)),
    "sys.isFlying": (U8, _bit(4)),
    "sys.isTumbled": (U8, _bit(5)),
}
"""By full name: type and value; their order is that of their numbers."""
