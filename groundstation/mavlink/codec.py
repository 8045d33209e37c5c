"""MAVLink frames: bytes to columns of values and back, many frames of one message type at once.

Layouts, sizes and CRC extras are read off pymavlink's generated message classes (dialect ``ardupilotmega``, which
contains ``common``); no wire table is typed here. Values stay in wire units (mm, degE7, ...): whoever knows the
meaning of a field converts it. A bad packet is returned as bytes that were no frame, never raised.

Refuses to check or make signatures (only their presence is told; see ``signing``), and to know any vehicle, socket or
clock.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
_HEADER_V1 = 6
_HEADER_V2 = 10
_CRC_BYTES = 2
_SIGNATURE_BYTES = 13
_MAGIC = re.compile(b"[\xfd\xfe]")
INCOMPAT_SIGNED = 0x01

StructuredArray = NDArray[np.void]

_NUMPY_CODES = {
    "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4",
    "q": "<i8", "Q": "<u8", "f": "<f4", "d": "<f8",
}  # fmt: skip


class Frame(NamedTuple):
    """One MAVLink frame whose length and (for ids of the dialect) checksum are right.

    Attributes:
        msgid: message id; not necessarily one that the dialect knows.
        sysid: sender's system id, 0 to 255.
        compid: sender's component id, 0 to 255.
        seq: sender's sequence number, 0 to 255.
        payload: as sent; in MAVLink 2 trailing zeros are cut off.
        raw: the whole frame, from the magic byte to the checksum or signature.
        version: 1 or 2.
        signed: whether it carries a signature (which nobody has checked yet).
    """

    msgid: int
    sysid: int
    compid: int
    seq: int
    payload: bytes
    raw: bytes
    version: int
    signed: bool


@dataclass(frozen=True)
class Layout:
    """How one message type lies on the wire.

    Attributes:
        name: as in the MAVLink definitions, for example ``"LOCAL_POSITION_NED"``.
        msgid: message id.
        crc_extra: byte that enters the checksum after the payload.
        dtype: packed structured type, fields in wire order, little endian, extensions included.
        packer: the same as ``struct.Struct``, arrays flattened.
        field_names: in wire order.
        array_lengths: 0 for scalars; for char arrays the number of bytes.
    """

    name: str
    msgid: int
    crc_extra: int
    dtype: np.dtype[np.void]
    packer: struct.Struct
    field_names: tuple[str, ...]
    array_lengths: tuple[int, ...]

    @property
    def size(self) -> int:
        """Payload size in bytes with nothing cut off."""
        return self.packer.size


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


@cache
def layout(name: str) -> Layout:
    """Looks a message type up by name.

    Raises:
        KeyError: the dialect has no message of that name.
    """
    return _layouts()[name]


@cache
def _layouts() -> dict[str, Layout]:
    return {item.name: item for item in map(_read_layout, dialect.mavlink_map.values())}


@cache
def _layouts_by_id() -> dict[int, Layout]:
    return {item.msgid: item for item in _layouts().values()}


def message_id(name: str) -> int:
    """Message id of a name. Raises KeyError when the dialect has no such message."""
    return layout(name).msgid


def message_name(msgid: int) -> str | None:
    """Name of a message id, None when the dialect does not know it."""
    known = _layouts_by_id().get(msgid)
    return known.name if known else None


def _read_layout(message: Any) -> Layout:
    names = tuple(str(name) for name in message.ordered_fieldnames)
    codes = bytes(message.native_format).decode().lstrip("<")
    lengths = tuple(int(length) for length in message.array_lengths)
    columns: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    for name, code, length in zip(names, codes, lengths, strict=True):
        if code == "c":
            columns.append((name, f"S{max(length, 1)}"))
        elif length:
            columns.append((name, _NUMPY_CODES[code], (length,)))
        else:
            columns.append((name, _NUMPY_CODES[code]))
    dtype = np.dtype(columns)
    packer = struct.Struct(message.unpacker.format)
    if dtype.itemsize != packer.size:
        raise AssertionError(f"{message.msgname}: {dtype.itemsize} bytes as columns, {packer.size} on the wire")
    return Layout(str(message.msgname), int(message.id), int(message.crc_extra), dtype, packer, names, lengths)


@cache
def _crc_extra_bytes() -> dict[int, bytes]:
    return {item.msgid: bytes([item.crc_extra]) for item in _layouts().values()}


class FrameSplitter:
    """Cuts what one peer sends into frames; bytes in, frames and left-over bytes out, nothing lost.

    The pieces that ``feed`` returns, joined in order (``raw`` of the frames), are the bytes that went in, but for
    what a stream still holds back because its frame is not complete. Where a checksum fails, the search goes on at
    the very next byte, so that noise never takes a good frame with it. A frame with an id that the dialect does not
    know has no checksum we could test: it is taken by its length when a frame starts behind it or nothing follows, and
    no frame whose checksum is right begins inside it.

    Args:
        datagrams: True when frames never span two calls (UDP); what is incomplete at the end of a call is noise then.
    """

    def __init__(self, *, datagrams: bool = True) -> None:
        self._datagrams = datagrams
        self._held = b""

    def feed(self, data: bytes) -> list[Frame | bytes]:
        """Takes what arrived.

        Args:
            data: one datagram, or the next bytes of a stream.

        Returns:
            Good frames, and runs of bytes that were none, in the order of arrival.
        """
        buffer = self._held + data if self._held else data
        self._held = b""
        pieces: list[Frame | bytes] = []
        position = noise_start = 0
        end = len(buffer)
        while position < end:
            magic = _MAGIC.search(buffer, position)
            if magic is None:
                position = end
                break
            position = magic.start()
            frame = _frame_at(buffer, position, more=not self._datagrams)
            if frame is _INCOMPLETE and not self._datagrams:
                break
            if isinstance(frame, Frame):
                if noise_start < position:
                    pieces.append(buffer[noise_start:position])
                pieces.append(frame)
                position += len(frame.raw)
                noise_start = position
            else:
                position += 1
        if noise_start < position:
            pieces.append(buffer[noise_start:position])
        self._held = buffer[position:]
        return pieces


def whole_frame(raw: bytes) -> Frame | None:
    """Reads bytes that are one frame and nothing else; None when they are not."""
    frame = _frame_at(raw, 0) if raw and raw[0] in (MAGIC_V1, MAGIC_V2) else None
    return frame if isinstance(frame, Frame) and len(frame.raw) == len(raw) else None


class Splitters:
    """One splitter for every source whose frames may come in pieces, and a bound on what they take.

    Datagrams are whole, so that nothing has to be kept of who sends them, however many there are. Of streams the one
    that was silent for longest is forgotten for a new one; it loses at most the frame that it was in the middle of.

    Args:
        most: streams that are kept apart.
    """

    def __init__(self, most: int = 256) -> None:
        self._most = most
        self._whole = FrameSplitter()
        self._streams: dict[Hashable, FrameSplitter] = {}

    def feed(self, source: Hashable, data: bytes, *, stream: bool) -> list[Frame | bytes]:
        """Takes what arrived from a source; see ``FrameSplitter.feed``."""
        if not stream:
            return self._whole.feed(data)
        splitter = self._streams.pop(source, None)
        if splitter is None:
            splitter = FrameSplitter(datagrams=False)
            if len(self._streams) >= self._most:
                del self._streams[next(iter(self._streams))]
        self._streams[source] = splitter  # last in the order, as the one heard most recently
        return splitter.feed(data)


_INCOMPLETE = object()


def _frame_at(buffer: bytes, start: int, *, more: bool = False) -> Frame | object | None:
    """Reads the frame that starts with the magic byte at ``start``; None when there is none, or _INCOMPLETE.

    ``more`` says that further bytes may follow those of the buffer.
    """
    available = len(buffer) - start
    if buffer[start] == MAGIC_V2:
        if available < _HEADER_V2:
            return _INCOMPLETE
        _, length, incompat, _, seq, sysid, compid, low, mid, high = buffer[start : start + _HEADER_V2]
        if incompat & ~INCOMPAT_SIGNED:
            return None  # a flag that we do not know changes the format: such a frame has to be discarded
        signed = bool(incompat & INCOMPAT_SIGNED)
        msgid, header, version = low | mid << 8 | high << 16, _HEADER_V2, 2
    else:
        if available < _HEADER_V1:
            return _INCOMPLETE
        _, length, seq, sysid, compid, msgid = buffer[start : start + _HEADER_V1]
        signed, header, version = False, _HEADER_V1, 1
    body_end = start + header + length
    frame_end = body_end + _CRC_BYTES + (_SIGNATURE_BYTES if signed else 0)
    if frame_end > len(buffer):
        return _INCOMPLETE
    extra = _crc_extra_bytes().get(msgid)
    if extra is None:
        if frame_end < len(buffer) and buffer[frame_end] not in (MAGIC_V1, MAGIC_V2):
            return None
        for magic in _MAGIC.finditer(buffer, start + 1, frame_end):
            inner = _checked_at(buffer, magic.start())
            if isinstance(inner, Frame):
                return None  # noise before a good frame
            if inner is _INCOMPLETE and more:
                return _INCOMPLETE  # it may become one
    elif crc16.mcrf4xx(buffer[start + 1 : body_end] + extra) != buffer[body_end] | buffer[body_end + 1] << 8:
        return None
    payload = buffer[start + header : body_end]
    return Frame(msgid, sysid, compid, seq, payload, buffer[start:frame_end], version, signed)


def flagged(raw: bytes, *, signed: bool) -> bytes:
    """A MAVLink 2 frame with its signature flag set or cleared, the checksum that belongs to that, no signature.

    Args:
        raw: a whole frame, signed or not. MAVLink 1 and ids that the dialect does not know come back as they are.
        signed: what the flag shall say; the signature itself is the caller's to append.
    """
    if raw[0] != MAGIC_V2:
        return raw
    extra = _crc_extra_bytes().get(int.from_bytes(raw[7:10], "little"))
    if extra is None:
        return raw
    body_end = _HEADER_V2 + raw[1]
    flags = raw[2] | INCOMPAT_SIGNED if signed else raw[2] & ~INCOMPAT_SIGNED
    if flags == raw[2]:
        return raw[: body_end + _CRC_BYTES]
    body = raw[1:2] + bytes((flags,)) + raw[3:body_end]
    checksum: int = crc16.mcrf4xx(body + extra)
    return raw[:1] + body + checksum.to_bytes(2, "little")


def _checked_at(buffer: bytes, start: int) -> Frame | object | None:
    """The same for frames alone whose checksum can be tested; _INCOMPLETE for what may become one of them."""
    id_bytes = buffer[start + 7 : start + 10] if buffer[start] == MAGIC_V2 else buffer[start + 5 : start + 6]
    whole_header = len(id_bytes) == (3 if buffer[start] == MAGIC_V2 else 1)
    if whole_header and int.from_bytes(id_bytes, "little") not in _crc_extra_bytes():
        return None
    return _frame_at(buffer, start)


def decode(frames: Sequence[Frame]) -> list[Batch]:
    """Turns frames into columns, one batch for each message type.

    Args:
        frames: as they came from a ``FrameSplitter``; ids that the dialect does not know are left out.

    Returns:
        Batches in the order in which their types first appear; rows in the order of the frames. Fields that were
        cut off or, as extensions, never sent read as zeros, as the MAVLink guide defines.
    """
    rows: dict[int, list[int]] = {}
    for index, frame in enumerate(frames):
        rows.setdefault(frame.msgid, []).append(index)
    batches = []
    for msgid, indices in rows.items():
        known = _layouts_by_id().get(msgid)
        if known is None:
            continue
        size = known.size
        joined = b"".join(frames[i].payload[:size].ljust(size, b"\0") for i in indices)
        batches.append(
            Batch(
                name=known.name,
                sysid=np.array([frames[i].sysid for i in indices], dtype=np.uint8),
                compid=np.array([frames[i].compid for i in indices], dtype=np.uint8),
                index=np.array(indices, dtype=np.int64),
                values=np.frombuffer(joined, dtype=known.dtype),
            )
        )
    return batches


@dataclass
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

    def encode(self, name: str, **fields: Any) -> bytes:
        """Encodes one message; fields that are not given are 0.

        Args:
            name: message name.
            **fields: wire units; arrays as sequences of at most the field's length, texts as str or bytes.

        Raises:
            KeyError: no such message, or no such field in it.
            ValueError: a value does not fit its field.
        """
        shape = layout(name)
        unknown = fields.keys() - set(shape.field_names)
        if unknown:
            raise KeyError(f"{name} has no field {', '.join(sorted(unknown))}")
        try:
            payload = shape.packer.pack(*_flatten(shape, fields))
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
            msgid = shape.msgid.to_bytes(3, "little")
            body = bytes((len(payload), 0, 0, seq, self.sysid, self.compid)) + msgid + payload
            magic = b"\xfd"
        checksum: int = crc16.mcrf4xx(body + bytes((shape.crc_extra,)))
        return magic + body + checksum.to_bytes(2, "little")


@cache
def _base_size(msgid: int) -> int:
    """Payload size without MAVLink 2 extension fields, which stand last on the wire.

    pymavlink's classes do not mark extensions, but their checksum covers the base fields alone: the base is the
    shortest prefix of the fields whose CRC extra comes out right.
    """
    message = dialect.mavlink_map[msgid]
    codes = bytes(message.native_format).decode().lstrip("<")
    names = {"b": "int8_t", "B": "uint8_t", "h": "int16_t", "H": "uint16_t", "i": "int32_t", "I": "uint32_t",
             "q": "int64_t", "Q": "uint64_t", "f": "float", "d": "double", "c": "char"}  # fmt: skip
    text = message.msgname.encode() + b" "
    size: int = 0
    for name, code, length in zip(message.ordered_fieldnames, codes, message.array_lengths, strict=True):
        text += names[code].encode() + b" " + name.encode() + b" " + (bytes([length]) if length else b"")
        size += struct.calcsize("<" + ("B" if code == "c" else code)) * max(length, 1)
        crc: int = crc16.mcrf4xx(text)
        if (crc & 0xFF) ^ (crc >> 8) == int(message.crc_extra):
            return size
    return int(message.unpacker.size)


def _flatten(shape: Layout, fields: dict[str, Any]) -> Iterable[Any]:
    for name, length in zip(shape.field_names, shape.array_lengths, strict=True):
        value = fields.get(name)
        if shape.dtype[name].kind == "S":
            text = value.encode() if isinstance(value, str) else bytes(value or b"")
            if len(text) > length:
                raise ValueError(f"{shape.name}.{name}: {len(text)} bytes, limit {length}")
            yield text
        elif length:
            items = list(value) if value is not None else []
            if len(items) > length:
                raise ValueError(f"{shape.name}.{name}: {len(items)} values, limit {length}")
            yield from items + [0] * (length - len(items))
        else:
            yield 0 if value is None else value


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
    joined = values.tobytes()
    size = shape.size
    return [encoder.frame(shape, joined[k * size : (k + 1) * size]) for k, encoder in enumerate(encoders)]
