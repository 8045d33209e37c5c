"""Generic setpoints as they stand in a packet, read into the world's frame.

The firmware's world frame is taken for the emulator's: x east, y north, z up. Angles are degrees on the wire. Up to
version 8 of the protocol the yaw rate has the other sign; those types have numbers of their own. Refuses what asks for
attitudes (roll, pitch, thrust, height above ground by roll and pitch): the emulated vehicle flies by velocity and
position.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

from sitl.personalities.crazyflie.crtp import unpacked_quaternion
from sitl.setpoints import NOTHING, Setpoint

STOP = 0
_VELOCITY_OLD, _HOVER_OLD, _FULL_STATE, _POSITION, _VELOCITY, _HOVER = 1, 5, 6, 7, 8, 10


def _velocity(data: bytes, now_ns: int, yaw_sign: float) -> Setpoint:
    x, y, z, rate = struct.unpack("<ffff", data)
    return Setpoint(now_ns, NOTHING, (x, y, z), None, yaw_sign * math.radians(rate))


def _hover(data: bytes, now_ns: int, yaw_enu_rad: float, yaw_sign: float) -> Setpoint:
    forward, left, rate, height = struct.unpack("<ffff", data)
    c, s = math.cos(yaw_enu_rad), math.sin(yaw_enu_rad)
    level = (c * forward - s * left, s * forward + c * left, None)
    return Setpoint(now_ns, (None, None, height), level, None, yaw_sign * math.radians(rate))


def _position(data: bytes, now_ns: int) -> Setpoint:
    x, y, z, yaw = struct.unpack("<ffff", data)
    return Setpoint(now_ns, (x, y, z), NOTHING, math.radians(yaw), None)


def _full_state(data: bytes, now_ns: int) -> Setpoint:
    numbers = struct.unpack("<hhhhhhhhhIhhh", data)
    pos, vel = (tuple(v / 1000.0 for v in numbers[k : k + 3]) for k in (0, 3))
    x, y, z, w = unpacked_quaternion(numbers[9])
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return Setpoint(now_ns, (pos[0], pos[1], pos[2]), (vel[0], vel[1], vel[2]), yaw, None)


def read_setpoint(data: bytes, now_ns: int, yaw_enu_rad: float) -> Setpoint | None:
    """One setpoint; None for a type that is not flown, a wrong length, or numbers that are none.

    Args:
        data: type byte and what follows it.
        now_ns: when it came.
        yaw_enu_rad: the vehicle's heading, for what is said in its own frame.
    """
    readers: dict[int, Callable[[bytes], Setpoint]] = {
        _VELOCITY: lambda rest: _velocity(rest, now_ns, 1.0),
        _VELOCITY_OLD: lambda rest: _velocity(rest, now_ns, -1.0),
        _HOVER: lambda rest: _hover(rest, now_ns, yaw_enu_rad, 1.0),
        _HOVER_OLD: lambda rest: _hover(rest, now_ns, yaw_enu_rad, -1.0),
        _POSITION: lambda rest: _position(rest, now_ns),
        _FULL_STATE: lambda rest: _full_state(rest, now_ns),
    }
    read = readers.get(data[0]) if data else None
    if read is None:
        return None
    try:
        point = read(data[1:])
    except struct.error:
        return None
    numbers = (*point.pos_enu_m, *point.vel_enu_m_s, point.yaw_enu_rad, point.yaw_rate_rad_s)
    return point if all(v is None or math.isfinite(v) for v in numbers) else None
