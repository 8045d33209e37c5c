"""MAVLink frames: bytes to columns of values and back, many frames of one message type at once.

Layouts, sizes and CRC extras are those that ``dialect`` read (``ardupilotmega``, which contains ``common``); no wire
table is typed here. Values stay in wire units (mm, degE7, ...): whoever knows the
meaning of a field converts it. A bad packet is returned as bytes that were no frame, never raised.

Refuses to check or make signatures (only their presence is told; see ``signing``), and to know any vehicle, socket or
clock.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray

from groundstation.mavlink.checksums import rows_checksum
from groundstation.mavlink.dialect import dialect
from groundstation.mavlink.layouts import (
    Layout,
    StructuredArray,
    crc_extra_bytes,
    field_offsets,
    layout,
    layouts_by_id,
    message_id,
    message_name,
)
from groundstation.mavlink.splitting import (
    CRC_BYTES,
    HEADER_V2,
    INCOMPAT_SIGNED,
    MAGIC_V1,
    MAGIC_V2,
    Frame,
    FrameSplitter,
    Piece,
    Splitters,
    plain_frame,
    whole_frame,
)

MAVLINK_2 = 2
_HEAD, _CHECKSUM = struct.Struct("<6B3s").pack, struct.Struct("<H").pack
_FEW = 40  # messages; fewer are encoded one by one, which is quicker then

__all__ = [
    "INCOMPAT_SIGNED",
    "MAGIC_V1",
    "MAGIC_V2",
    "Batch",
    "Encoder",
    "Frame",
    "FrameSplitter",
    "Layout",
    "Piece",
    "Splitters",
    "StructuredArray",
    "blank",
    "columns",
    "decode",
    "encode_batch",
    "encode_rows",
    "flagged",
    "layout",
    "message_id",
    "message_name",
    "plain_frame",
    "whole_frame",
]


@dataclass(frozen=True)
class Batch:
    """Frames of one message type as columns.

    Attributes:
        name: message name.
        sysid: sender per row, shape (k,), uint8.
        compid: sender's component per row, shape (k,), uint8.
        index: position of each row among the frames that were given to ``decode``, shape (k,).
        values: structured array, shape (k,), wire units; arrays as sub-arrays, texts as bytes without trailing zeros.
    """

    name: str
    sysid: NDArray[np.uint8]
    compid: NDArray[np.uint8]
    index: NDArray[np.int64]
    values: StructuredArray

    def __len__(self) -> int:
        """Number of rows, k."""
        return len(self.values)


def flagged(raw: bytes, *, signed: bool) -> bytes:
    """A MAVLink 2 frame with its signature flag set or cleared, the checksum that belongs to that, no signature.

    Args:
        raw: a whole frame, signed or not. MAVLink 1 and ids that the dialect does not know come back as they are.
        signed: what the flag shall say; the signature itself is the caller's to append.
    """
    if raw[0] != MAGIC_V2:
        return raw
    extra = crc_extra_bytes().get(int.from_bytes(raw[7:10], "little"))
    if extra is None:
        return raw
    body_end = HEADER_V2 + raw[1]
    flags = raw[2] | INCOMPAT_SIGNED if signed else raw[2] & ~INCOMPAT_SIGNED
    if flags == raw[2]:
        return raw[: body_end + CRC_BYTES]
    body = raw[1:2] + bytes((flags,)) + raw[3:body_end]
    checksum: int = crc16.mcrf4xx(body + extra)
    return raw[:1] + body + checksum.to_bytes(2, "little")


def columns(values: StructuredArray, first: str, count: int) -> NDArray[np.generic]:
    """Fields of a number type that lie one behind the other, as columns of one array, shape (k, count); a view.

    Args:
        values: of a message type, shape (k,), one row behind the other.
        first: name of the first field.
        count: of fields, all of them of the type of the first.
    """
    kind, offset = values.dtype[first], field_offsets(values.dtype)[first]
    octets = values.view(np.uint8).reshape(len(values), values.dtype.itemsize)
    return octets[:, offset : offset + count * kind.itemsize].view(kind)


def decode(frames: Sequence[Frame]) -> list[Batch]:
    """Turns frames into columns, one batch for each message type.

    Args:
        frames: as they came from a ``FrameSplitter``; ids that the dialect does not know are left out.

    Returns:
        Batches in the order in which their types first appear; rows in the order of the frames. Fields that were
        cut off or, as extensions, never sent read as zeros, as the MAVLink guide defines.
    """
    if len(frames) == 1:
        return _decode_lone(frames[0])
    rows: dict[int, list[int]] = {}
    for index, frame in enumerate(frames):
        rows.setdefault(frame.msgid, []).append(index)
    batches = []
    for msgid, indices in rows.items():
        known = layouts_by_id().get(msgid)
        if known is None:
            continue
        size = known.size
        joined = b"".join(frames[i].payload[:size].ljust(size, b"\0") for i in indices)
        batches.append(
            Batch(
                name=known.name,
                sysid=np.frombuffer(bytes([frames[i].sysid for i in indices]), dtype=np.uint8),
                compid=np.frombuffer(bytes([frames[i].compid for i in indices]), dtype=np.uint8),
                index=np.array(indices, dtype=np.int64),
                values=np.frombuffer(joined, dtype=known.dtype),
            )
        )
    return batches


_FIRST = np.zeros(1, dtype=np.int64)
_FIRST.flags.writeable = False


def _decode_lone(frame: Frame) -> list[Batch]:
    """The same for one frame, which is what most calls are about on slow links."""
    known = layouts_by_id().get(frame.msgid)
    if known is None:
        return []
    payload = frame.payload[: known.size].ljust(known.size, b"\0")
    names = np.frombuffer(frame.raw, dtype=np.uint8, count=2, offset=5 if frame.version == MAVLINK_2 else 3)
    return [Batch(known.name, names[:1], names[1:], _FIRST, np.frombuffer(payload, dtype=known.dtype))]


@dataclass(eq=False)
class Encoder:
    """Makes frames of one sender and counts its sequence number.

    Attributes:
        sysid: sender's system id.
        compid: sender's component id.
        version: MAVLink version on the wire, 1 or 2.
        seq: sequence number of the next frame.
    """

    sysid: int
    compid: int = 1
    version: int = 2
    seq: int = field(default=0)

    def encode(self, name: str, /, **fields: Any) -> bytes:
        """Encodes one message; fields that are not given are 0.

        Args:
            name: message name.
            **fields: wire units; arrays as sequences of at most the field's length, texts as str or bytes.

        Raises:
            KeyError: no such message, or no such field in it.
            ValueError: a value does not fit its field.
        """
        shape = layout(name)
        if not fields.keys() <= shape.names:
            raise KeyError(f"{name} has no field {', '.join(sorted(fields.keys() - shape.names))}")
        try:
            if shape.flat:
                given = map(fields.get, shape.field_names)
                payload = shape.packer.pack(*[0 if value is None else value for value in given])
            else:
                payload = shape.byte_packer.pack(*_flatten(shape, fields))
        except (struct.error, OverflowError, TypeError) as error:
            raise ValueError(f"{name}: a value does not fit its field: {error}") from error
        return self.frame(shape, payload)

    def frame(self, shape: Layout, payload: bytes) -> bytes:
        """Wraps a full-length payload into a frame and counts it."""
        seq = self.seq
        self.seq = (seq + 1) & 0xFF
        if self.version == 1:
            if shape.msgid > 0xFF:
                raise ValueError(
                    f"{shape.name}: id {shape.msgid} does not exist in MAVLink 1, limit 255; use version 2"
                )
            payload = payload[: _base_size(shape.msgid)]  # MAVLink 1 has neither extensions nor truncation
            body = bytes((len(payload), seq, self.sysid, self.compid, shape.msgid)) + payload
            magic = b"\xfe"
        else:
            payload = payload.rstrip(b"\0") or b"\0"
            body = _HEAD(len(payload), 0, 0, seq, self.sysid, self.compid, shape.id_bytes) + payload
            magic = b"\xfd"
        checksum: int = crc16.mcrf4xx(body + bytes((shape.crc_extra,)))
        return magic + body + checksum.to_bytes(2, "little")


@cache
def _base_size(msgid: int) -> int:
    """Payload size without MAVLink 2 extension fields, which stand last on the wire.

    pymavlink's classes do not mark extensions, but their checksum covers the base fields alone: the base is the
    shortest prefix of the fields whose CRC extra comes out right.
    """
    message = dialect().messages[msgid]
    names = {"b": "int8_t", "B": "uint8_t", "h": "int16_t", "H": "uint16_t", "i": "int32_t", "I": "uint32_t",
             "q": "int64_t", "Q": "uint64_t", "f": "float", "d": "double", "c": "char"}  # fmt: skip
    text = message.name.encode() + b" "
    size: int = 0
    for name, code, length in zip(message.fields, message.codes, message.lengths, strict=True):
        text += names[code].encode() + b" " + name.encode() + b" " + (bytes([length]) if length else b"")
        size += struct.calcsize("<" + ("B" if code == "c" else code)) * max(length, 1)
        crc: int = crc16.mcrf4xx(text)
        if (crc & 0xFF) ^ (crc >> 8) == message.crc_extra:
            return size
    return struct.calcsize(message.packing)


def _flatten(shape: Layout, fields: dict[str, Any]) -> list[Any]:
    flat: list[Any] = []
    for name, length, kind in shape.kinds:
        value = fields.get(name)
        if kind == "text":
            text = value.encode() if isinstance(value, str) else bytes(value or b"")
            if len(text) > length:
                raise ValueError(f"{shape.name}.{name}: {len(text)} bytes, limit {length}")
            flat.append(text)
        elif length:
            items = value if isinstance(value, bytes) else list(value if value is not None else ())
            if len(items) > length:
                raise ValueError(f"{shape.name}.{name}: {len(items)} values, limit {length}")
            if kind == "octets":  # zeros fill it up
                flat.append(value if isinstance(value, bytes) else struct.pack(f"{len(items)}B", *items))
            else:
                flat += items
                flat += (0,) * (length - len(items))
        else:
            flat.append(0 if value is None else value)
    return flat


def blank(name: str, count: int) -> StructuredArray:
    """Returns ``count`` zeroed rows of a message type, to be filled column by column and given to ``encode_batch``."""
    return np.zeros(count, dtype=layout(name).dtype)


def encode_batch(name: str, values: StructuredArray, encoders: Sequence[Encoder]) -> list[bytes]:
    """Encodes many messages of one type.

    Args:
        name: message name.
        values: shape (k,), of ``layout(name).dtype``.
        encoders: k senders, row by row; the same one may stand in it many times.

    Returns:
        k frames, each numbered by its own encoder.

    Raises:
        ValueError: the type of the array is not the message's, or the lengths differ.
    """
    shape = layout(name)
    if values.dtype != shape.dtype or len(values) != len(encoders):
        raise ValueError(f"{name}: {len(values)} rows of {values.dtype} for {len(encoders)} encoders")
    if len(values) >= _FEW and encoders.count(encoders[0]) == len(encoders) and encoders[0].version == MAVLINK_2:
        return encode_rows(name, values, encoders[0])
    joined, size, position = values.tobytes(), shape.size, 0
    msgid, extra = shape.msgid.to_bytes(3, "little"), bytes((shape.crc_extra,))
    head, checksum, two_bytes = _HEAD, crc16.mcrf4xx, _CHECKSUM
    frames: list[bytes] = []
    put = frames.append
    for encoder in encoders:
        payload = joined[position : position + size]
        position += size
        if encoder.version != MAVLINK_2:
            put(encoder.frame(shape, payload))
            continue
        # As ``Encoder.frame`` does it, without a call for each.
        if not payload[-1]:
            payload = payload.rstrip(b"\0") or b"\0"
        seq = encoder.seq
        encoder.seq = (seq + 1) & 0xFF
        body = head(len(payload), 0, 0, seq, encoder.sysid, encoder.compid, msgid) + payload
        put(b"\xfd" + body + two_bytes(checksum(body + extra)))
    return frames


def encode_rows(name: str, values: StructuredArray, encoder: Encoder) -> list[bytes]:
    """Encodes many messages of one type and one sender in MAVLink 2, all of them in the same few steps."""
    shape = layout(name)
    count, size = len(values), shape.size
    rows = np.zeros((count, HEADER_V2 + size + CRC_BYTES), dtype=np.uint8)
    rows[:, HEADER_V2 : HEADER_V2 + size] = np.ascontiguousarray(values).view(np.uint8).reshape(count, size)
    kept = rows[:, HEADER_V2 : HEADER_V2 + size] != 0
    kept[:, 0] = True  # one byte stays, whatever it is
    length = size - kept[:, ::-1].argmax(axis=1)
    rows[:, 0] = MAGIC_V2
    rows[:, 1] = length
    rows[:, 4] = np.arange(encoder.seq, encoder.seq + count)
    rows[:, 5], rows[:, 6] = encoder.sysid, encoder.compid
    rows[:, 7], rows[:, 8], rows[:, 9] = shape.msgid & 0xFF, shape.msgid >> 8 & 0xFF, shape.msgid >> 16
    encoder.seq = (encoder.seq + count) & 0xFF
    checksum = rows_checksum(rows[:, 1 : HEADER_V2 + size], length + (HEADER_V2 - 1), shape.crc_extra)
    numbers, behind = np.arange(count), length + HEADER_V2
    rows[numbers, behind] = checksum & 0xFF
    rows[numbers, behind + 1] = checksum >> 8
    raw, width = rows.tobytes(), rows.shape[1]
    starts = range(0, count * width, width)
    return [raw[start : start + stop] for start, stop in zip(starts, (behind + CRC_BYTES).tolist(), strict=True)]
