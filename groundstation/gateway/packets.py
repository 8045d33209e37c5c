"""Orders as CRTP packets: the few that a flight needs, in bytes, for whoever carries them.

Numbers are those of the protocol's pages (generic setpoints, high-level commander, localisation, supervisor), from
version 9 on; the supervisor has a port of its own from version 12 (firmware of 2026) on. They need no table of the
vehicle's, so they can be sent before a connection is complete; parameters do.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

from groundstation.gateway.orders import (
    VALID_MS,
    Arm,
    EmergencyStop,
    ExternalPose,
    GoTo,
    HighLevelStop,
    LandAt,
    LogRate,
    Order,
    Ping,
    Recover,
    SetParam,
    SetpointsStop,
    TakeOff,
    Velocity,
)

PARAM, LOG, LOCALISATION, LINK = 2, 5, 6, 15
_GENERIC, HIGH_LEVEL, _SUPERVISOR, _PLATFORM = 7, 8, 9, 13
_POSE, _POSE_PACKED = 8, 9
_MAGNITUDE = 511
_VELOCITY, _STOP, _TAKE_OFF, _LAND, _GO_TO = 8, 3, 7, 8, 12
SHAPE_OF_KIND = {1: "<B", 2: "<b", 3: "<H", 5: "<I", 9: "<f"}
"""By MAV_PARAM_TYPE."""


ANSWER_BYTES = 4
"""Of the high-level commander: the command, two bytes of it, the error."""
_ECHO = b"\x67gs"
_ECHO_BYTES = 9  # as long as those of cflib, which unpacks all that comes back, and knows its own by the first byte
PACKED = 2
"""Poses in one packet: 11 bytes each, of 29."""
_PLACES_CHANNEL, _PLACES_PACKED = 2, 4  # 7 bytes each, of 30


def packed_poses(poses: Mapping[int, ExternalPose]) -> list[bytes]:
    """External poses of several vehicles, as packets for all of them; of those without an attitude places alone.

    Args:
        poses: by the last byte of the vehicle's radio address, by which it knows its own.
    """
    lying, placed = [], []
    for number, pose in poses.items():
        item = struct.pack("<Bhhh", number, *(max(-32768, min(32767, round(1000.0 * v))) for v in pose.pos_enu_m))
        if pose.quat_enu_from_flu is None:
            placed.append(item)
        else:
            lying.append(item + struct.pack("<I", packed_quaternion(*pose.quat_enu_from_flu)))
    made = [
        packet(LOCALISATION, 1, struct.pack("<B", _POSE_PACKED) + b"".join(lying[first : first + PACKED]))
        for first in range(0, len(lying), PACKED)
    ]
    return made + [
        packet(LOCALISATION, _PLACES_CHANNEL, b"".join(placed[first : first + _PLACES_PACKED]))
        for first in range(0, len(placed), _PLACES_PACKED)
    ]


def packed_quaternion(x: float, y: float, z: float, w: float) -> int:
    """Quaternion in 32 bits: which part is the largest, then sign and 9 bits of each other one (quatcompress.h)."""
    parts = (x, y, z, w)
    largest = max(range(4), key=lambda k: abs(parts[k]))
    packed = largest
    for k in range(4):
        if k != largest:
            turned = (parts[k] < 0.0) != (parts[largest] < 0.0)
            packed = packed << 10 | turned << 9 | min(_MAGNITUDE, round(abs(parts[k]) * math.sqrt(2.0) * _MAGNITUDE))
    return packed


def echo_number(data: bytes) -> int | None:
    """Number of an echo that was asked for by ``Ping``, of what came back on the link's port; None for others."""
    return int.from_bytes(data[3:5], "little") if data[:3] == _ECHO and len(data) == _ECHO_BYTES else None


def packet(port: int, channel: int, data: bytes) -> bytes:
    """One CRTP packet."""
    return bytes((port << 4 | 0xC | channel,)) + data


def packet_of(order: Order, numbers: Mapping[str, tuple[int, int]]) -> bytes | None:
    """An order as a packet; None for a parameter that there is not, or a value that it does not hold.

    Args:
        order: to be sent.
        numbers: of parameters: full name: number and MAV_PARAM_TYPE; none where these go another way.
    """
    match order:
        case Velocity((x, y, z), rate):
            return packet(_GENERIC, 0, struct.pack("<Bffff", _VELOCITY, x, y, z, rate * 57.29577951308232))
        case SetpointsStop():
            return packet(_GENERIC, 1, struct.pack("<BI", 0, VALID_MS))
        case TakeOff(height_m, duration_s):
            return packet(HIGH_LEVEL, 0, struct.pack("<BBff?f", _TAKE_OFF, 0, height_m, 0.0, True, duration_s))
        case LandAt(height_m, duration_s):
            return packet(HIGH_LEVEL, 0, struct.pack("<BBff?f", _LAND, 0, height_m, 0.0, True, duration_s))
        case GoTo((x, y, z), relative, yaw, duration_s):
            turn = 0.0 if relative else yaw
            head = struct.pack("<BB??", _GO_TO, 0, relative, False)
            return packet(HIGH_LEVEL, 0, head + struct.pack("<fffff", x, y, z, turn, duration_s))
        case HighLevelStop():
            return packet(HIGH_LEVEL, 0, struct.pack("<BB", _STOP, 0))
        case Arm(arm, old):
            return packet(*((_PLATFORM, 0) if old else (_SUPERVISOR, 1)), struct.pack("<B?", 1, arm))
        case Recover(old):
            return packet(*((_PLATFORM, 0) if old else (_SUPERVISOR, 1)), b"\x02")
        case EmergencyStop(old):
            return packet(LOCALISATION if old else _SUPERVISOR, 1, b"\x03")
        case ExternalPose(place, quat):
            if quat is None:
                return packet(LOCALISATION, 0, struct.pack("<fff", *place))
            return packet(LOCALISATION, 1, struct.pack("<Bfffffff", _POSE, *place, *quat))
        case Ping(number):
            return packet(LINK, 0, (_ECHO + struct.pack("<H", number)).ljust(_ECHO_BYTES, b"\0"))
        case LogRate():
            return None  # blocks are whoever's carries the link
        case SetParam(name, value):
            if name not in numbers:
                return None
            number, kind = numbers[name]
            try:
                held = value if kind == 9 else round(value)
                return packet(PARAM, 2, struct.pack("<H", number) + struct.pack(SHAPE_OF_KIND[kind], held))
            except (struct.error, ValueError, OverflowError):
                return None
