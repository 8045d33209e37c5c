"""CRTP as it stands on the wire: a header byte (port, channel), up to 30 bytes; and the packed numbers in it.

Sources: the protocol pages of the Crazyflie's documentation (CRTP, log, parameters, generic setpoints, localisation).
Refuses to know what a packet does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

CONSOLE, PARAM, COMMANDER, MEMORY, LOG, LOCALISATION, GENERIC, HIGH_LEVEL, SUPERVISOR, PLATFORM, LINK = (
    0, 2, 3, 4, 5, 6, 7, 8, 9, 13, 15,
)  # fmt: skip
DATA_MAX = 30
NULL = b"\xff"
"""What a client sends to learn whether anybody is there, and what it is answered with."""
_MAGNITUDE = 511


class Packet(NamedTuple):
    """One packet: ports are 0 to 15, channels 0 to 3."""

    port: int
    channel: int
    data: bytes


def read(datagram: bytes) -> Packet | None:
    """One packet out of a datagram; None when it is none (empty, or longer than the radio carries)."""
    if not 1 <= len(datagram) <= DATA_MAX + 1:
        return None
    return Packet(datagram[0] >> 4, datagram[0] & 3, bytes(datagram[1:]))


def write(port: int, channel: int, data: bytes) -> bytes:
    """A packet as a datagram; what is longer than 30 bytes is cut off."""
    return bytes((port << 4 | 0xC | channel,)) + data[:DATA_MAX]


def packed_quaternion(x: float, y: float, z: float, w: float) -> int:
    """32 bits: the place of the largest of four, and the three others with sign and 9 bits each."""
    numbers = (x, y, z, w)
    largest = max(range(4), key=lambda k: abs(numbers[k]))
    packed = largest
    for k in range(4):
        if k != largest:
            negative = (numbers[k] < 0.0) != (numbers[largest] < 0.0)
            packed = packed << 10 | negative << 9 | min(_MAGNITUDE, round(abs(numbers[k]) * math.sqrt(2) * _MAGNITUDE))
    return packed


def unpacked_quaternion(packed: int) -> tuple[float, float, float, float]:
    """The inverse of ``packed_quaternion``: x, y, z, w."""
    largest = packed >> 30
    numbers = [0.0] * 4
    for k in (3, 2, 1, 0):
        if k != largest:
            size = (packed & _MAGNITUDE) / _MAGNITUDE / math.sqrt(2)
            numbers[k] = -size if packed & 0x200 else size
            packed >>= 10
    numbers[largest] = math.sqrt(max(0.0, 1.0 - math.fsum(v * v for v in numbers)))
    return numbers[0], numbers[1], numbers[2], numbers[3]
