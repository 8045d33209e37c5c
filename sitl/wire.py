"""Messages in and out of one emulated vehicle: fields by name on this side, frames on the other.

A thin layer over the codec for single messages, as a small autopilot needs them. Refuses to interpret anything.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from groundstation.mavlink.codec import Frame, Layout, layout, message_name

Fields = dict[str, Any]
V1_LAST_ID = 255
"""Messages with larger ids do not exist in MAVLink 1."""


@cache
def _layout_of(msgid: int) -> Layout | None:
    name = message_name(msgid)
    return layout(name) if name else None


@cache
def _flat(msgid: int) -> Layout | None:
    """The layout of a type with neither arrays nor texts, so that values and names pair up as they are."""
    known = _layout_of(msgid)
    return known if known is not None and not any(known.array_lengths) else None


def unpack(frame: Frame) -> Fields | None:
    """Reads a frame's fields: numbers, tuples for arrays, bytes up to the first NUL for texts.

    Returns:
        The fields in wire units, extensions included (0 when absent); None for an id that the dialect does not know.
    """
    flat = _flat(frame.msgid)
    if flat is not None:
        payload = frame.payload[: flat.size].ljust(flat.size, b"\0")
        return dict(zip(flat.field_names, flat.packer.unpack(payload), strict=True))
    known = _layout_of(frame.msgid)
    if known is None:
        return None
    size = known.size
    values = known.packer.unpack(frame.payload[:size].ljust(size, b"\0"))
    fields: Fields = {}
    position = 0
    for name, length in zip(known.field_names, known.array_lengths, strict=True):
        value = values[position]
        if isinstance(value, bytes):
            fields[name] = value.split(b"\0", 1)[0]
            position += 1
        elif length:
            fields[name] = values[position : position + length]
            position += length
        else:
            fields[name] = value
            position += 1
    return fields


def whole(value: float) -> int:
    """Nearest integer of a command parameter, within 32 bits; what is not a number ("not given") is 0."""
    return round(min(max(value, -2147483648.0), 2147483647.0)) if math.isfinite(value) else 0
