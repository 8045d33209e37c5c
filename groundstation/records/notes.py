"""What a log holds, as values: MAVLink frames with their direction, and the notes that MAVLink does not say.

Notes (ticks, where a frame came from, operator commands, roles, phases, bytes that were no frame) are TUNNEL frames
of the ground station with a payload type of the private range. They stand in the log file only and were never sent.
Packs and unpacks their payloads; refuses to know files, time stamps or frames.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

from groundstation.mavlink.codec import Frame

FORMAT_VERSION = 1
PAYLOAD_BYTES = 128
"""Room in one TUNNEL frame."""

NOISE_BYTES = 110
"""Received bytes in one NOISE note."""

NOISE_SUBJECT = 256
"""Subject of an ORIGIN note that tells where NOISE came from; 0 to 255 are system ids."""

OWN_SUBJECT = 257
"""Subject of an ORIGIN note before a frame that bears the ground station's own ids and yet was received."""

REFUSED_SUBJECT = 258
"""Subject of an ORIGIN note that tells where a REFUSED frame came from."""

PHASE_PREFIX = "phase: "
"""An EVENT of this form begins a phase of the team; it lasts until the next one."""

_HEADER = struct.Struct("<Hq")
_TICK = struct.Struct("<qI")
_ORIGIN = struct.Struct("<HH")
_ROLES = struct.Struct("<HH")
_LINK = struct.Struct("<H")
_ROLES_PER_NOTE = (PAYLOAD_BYTES - _ROLES.size) // 2


class Kind(IntEnum):
    """Payload types of the log-only TUNNEL frames; integers in them are little endian, as in MAVLink."""

    HEADER = 0x9000
    """uint16 format version, int64 unix microseconds at t = 0."""
    TICK = 0x9001
    """int64 t_ns, uint32 number of the tick."""
    ORIGIN = 0x9002
    """uint8 1 if more follows, then: uint16 subject, uint16 link, peer as UTF-8."""
    NOISE = 0x9003
    """uint8 1 if more follows, then bytes as they came."""
    OPERATOR = 0x9004
    """uint8 1 if more follows, then UTF-8 text."""
    EVENT = 0x9005
    """uint8 1 if more follows, then UTF-8 text."""
    ROLES = 0x9006
    """uint16 first vehicle (from 0), uint16 number of vehicles, uint16 role of each from there on; 0 is none."""
    REFUSED = 0x9007
    """uint8 1 if more follows, then: uint8 why (1 unsigned, 2 wrong signature, 3 old time stamp), the whole frame."""
    LINK = 0x9008
    """uint16 link of the frames that follow, in both directions, up to the next one."""


class Received(NamedTuple):
    """A frame that arrived.

    Attributes:
        t_ns: arrival, monotonic, ns.
        link: index of the link that it came over; 0 in logs of other programs.
        peer: sender's address as the link tells it; empty in logs of other programs.
        frame: the frame.
    """

    t_ns: int
    link: int
    peer: str
    frame: Frame


class Sent(NamedTuple):
    """A frame that the ground station sent at ``t_ns``; over which link, where the log tells it."""

    t_ns: int
    frame: Frame
    link: int | None = None


class Tick(NamedTuple):
    """One step of the mission object: its time and its number."""

    t_ns: int
    number: int


class Operator(NamedTuple):
    """A command that the operator gave."""

    t_ns: int
    text: str


class Event(NamedTuple):
    """Something that people and the report want to know: a phase, an alarm."""

    t_ns: int
    text: str


class Roles(NamedTuple):
    """Role of each vehicle from ``t_ns`` on, counted from 0; None for a vehicle that has none."""

    t_ns: int
    roles: tuple[int | None, ...]


class Noise(NamedTuple):
    """A run of received bytes that were no good frame."""

    t_ns: int
    link: int
    peer: str
    data: bytes


class Refused(NamedTuple):
    """A frame that arrived and was not let in; ``why`` is 1 unsigned, 2 wrong signature, 3 old time stamp."""

    t_ns: int
    link: int
    peer: str
    why: int
    frame: bytes


Record = Received | Sent | Tick | Operator | Event | Roles | Noise | Refused


class Origin(NamedTuple):
    """Where the next frames of ``subject`` come from: a note of the file, not a record of its own."""

    subject: int
    link: int
    peer: str


def pack_header(epoch_unix_us: int) -> bytes:
    """Packs the first note of a log: the format and the unix time of t = 0 in microseconds."""
    return _HEADER.pack(FORMAT_VERSION, epoch_unix_us)


def unpack_header(payload: bytes) -> tuple[int, int]:
    """Returns format version and unix microseconds at t = 0. Raises ValueError when the note is too short."""
    return _unpack(_HEADER, payload)


def pack_tick(t_ns: int, number: int) -> bytes:
    """Packs a TICK note."""
    return _TICK.pack(t_ns, number)


def unpack_tick(payload: bytes) -> Tick:
    """Unpacks a TICK note. Raises ValueError when it is too short."""
    return Tick(*_unpack(_TICK, payload))


def pack_text(text: bytes, room: int = PAYLOAD_BYTES - 1) -> Iterator[bytes]:
    """Cuts a text of any length into note payloads, each led by a byte that tells whether more follows."""
    for start in range(0, max(len(text), 1), room):
        yield bytes((start + room < len(text),)) + text[start : start + room]


def pack_origin(origin: Origin) -> Iterator[bytes]:
    """Packs an ORIGIN note, several payloads where the peer's name is long."""
    return pack_text(_ORIGIN.pack(origin.subject, origin.link) + origin.peer.encode())


def unpack_origin(joined: bytes) -> Origin:
    """Unpacks an ORIGIN note whose pieces have been joined. Raises ValueError when it is too short."""
    subject, link = _unpack(_ORIGIN, joined)
    return Origin(subject, link, joined[_ORIGIN.size :].decode(errors="replace"))


def pack_link(link: int) -> bytes:
    """Packs a LINK note."""
    return _LINK.pack(link)


def unpack_link(payload: bytes) -> int:
    """Unpacks a LINK note. Raises ValueError when it is too short."""
    if len(payload) < _LINK.size:
        raise ValueError(f"a note has {len(payload)} bytes, expected at least {_LINK.size}")
    return int(_LINK.unpack_from(payload)[0])


def pack_roles(roles: Sequence[int | None]) -> Iterator[bytes]:
    """Packs the role of each vehicle (counted from 0, None for none), several payloads for large teams."""
    for first in range(0, max(len(roles), 1), _ROLES_PER_NOTE):
        part = [0 if role is None else role + 1 for role in roles[first : first + _ROLES_PER_NOTE]]
        yield _ROLES.pack(first, len(roles)) + struct.pack(f"<{len(part)}H", *part)


def unpack_roles(payload: bytes) -> tuple[int, int, tuple[int | None, ...]]:
    """Returns first vehicle, number of vehicles and the roles of this piece. Raises ValueError when too short."""
    first, count = _unpack(_ROLES, payload)
    body = payload[_ROLES.size :]
    numbers = struct.unpack(f"<{len(body) // 2}H", body[: len(body) // 2 * 2])
    return first, count, tuple(None if number == 0 else number - 1 for number in numbers)


def _unpack(shape: struct.Struct, payload: bytes) -> tuple[int, int]:
    if len(payload) < shape.size:
        raise ValueError(f"a note has {len(payload)} bytes, expected at least {shape.size}")
    first, second = shape.unpack_from(payload)
    return int(first), int(second)
