"""How every message type lies on the wire: columns for many of one type, packers for one.

Made of what ``dialect`` read; no wire table is typed here.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from groundstation.mavlink.dialect import Message, dialect

StructuredArray = NDArray[np.void]

_NUMPY_CODES = {
    "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4",
    "q": "<i8", "Q": "<u8", "f": "<f4", "d": "<f8",
}  # fmt: skip


@dataclass(frozen=True)
class Layout:
    """How one message type lies on the wire.

    Attributes:
        name: as in the MAVLink definitions, for example ``"LOCAL_POSITION_NED"``.
        msgid: message id.
        crc_extra: byte that enters the checksum after the payload.
        dtype: packed structured type, fields in wire order, little endian, extensions included.
        packer: the same as ``struct.Struct``, arrays flattened.
        byte_packer: the same with arrays of uint8 taken as bytes, however few of them.
        field_names: in wire order.
        array_lengths: 0 for scalars; for char arrays the number of bytes.
    """

    name: str
    msgid: int
    crc_extra: int
    dtype: np.dtype[np.void]
    packer: struct.Struct
    byte_packer: struct.Struct
    field_names: tuple[str, ...]
    array_lengths: tuple[int, ...]

    @cached_property
    def size(self) -> int:
        """Payload size in bytes with nothing cut off."""
        return self.packer.size

    @cached_property
    def names(self) -> frozenset[str]:
        """The same as ``field_names``, to be asked who is among them."""
        return frozenset(self.field_names)

    @cached_property
    def flat(self) -> bool:
        """Whether every field is one number."""
        return not any(self.array_lengths) and all(self.dtype[name].kind != "S" for name in self.field_names)

    @cached_property
    def kinds(self) -> tuple[tuple[str, int, str], ...]:
        """Name, array length and kind of each field: ``text``, ``octets`` or ``numbers``, in wire order."""
        octet = np.dtype(np.uint8)
        kinds = {name: "octets" if self.dtype[name].base == octet else "numbers" for name in self.field_names}
        kinds |= {name: "text" for name in self.field_names if self.dtype[name].kind == "S"}
        return tuple((name, n, kinds[name]) for name, n in zip(self.field_names, self.array_lengths, strict=True))

    @cached_property
    def id_bytes(self) -> bytes:
        """The message id as MAVLink 2 has it on the wire."""
        return self.msgid.to_bytes(3, "little")

    def place_of(self, field: str) -> int:
        """Bytes of the payload in front of a field.

        Raises:
            KeyError: there is no field of that name.
        """
        if self.dtype.fields is None:
            raise KeyError(field)
        return self.dtype.fields[field][1]


@cache
def field_offsets(dtype: np.dtype[np.void]) -> dict[str, int]:
    """At which byte of a row each field lies."""
    return {name: int(place[1]) for name, place in (dtype.fields or {}).items()}


@cache
def layout(name: str) -> Layout:
    """Looks a message type up by name.

    Raises:
        KeyError: the dialect has no message of that name.
    """
    return _layouts()[name]


@cache
def _layouts() -> dict[str, Layout]:
    return {item.name: item for item in map(_read_layout, dialect().messages.values())}


@cache
def layouts_by_id() -> dict[int, Layout]:
    """All layouts by message id."""
    return {item.msgid: item for item in _layouts().values()}


def message_id(name: str) -> int:
    """Message id of a name. Raises KeyError when the dialect has no such message."""
    return layout(name).msgid


def message_name(msgid: int) -> str | None:
    """Name of a message id, None when the dialect does not know it."""
    known = layouts_by_id().get(msgid)
    return known.name if known else None


def _read_layout(message: Message) -> Layout:
    names, codes, lengths = message.fields, message.codes, message.lengths
    columns: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    for name, code, length in zip(names, codes, lengths, strict=True):
        if code == "c":
            columns.append((name, f"S{max(length, 1)}"))
        elif length:
            columns.append((name, _NUMPY_CODES[code], (length,)))
        else:
            columns.append((name, _NUMPY_CODES[code]))
    dtype = np.dtype(columns)
    packer = struct.Struct(message.packing)
    if dtype.itemsize != packer.size:
        raise AssertionError(f"{message.name}: {dtype.itemsize} bytes as columns, {packer.size} on the wire")
    bytewise = "".join(
        f"{length}s" if code == "B" and length else f"{length or ''}{'s' if code == 'c' else code}"
        for code, length in zip(codes, lengths, strict=True)
    )
    return Layout(
        message.name,
        message.msgid,
        message.crc_extra,
        dtype,
        packer,
        struct.Struct(f"<{bytewise}"),
        names,
        lengths,
    )


@cache
def crc_extra_bytes() -> dict[int, bytes]:
    """The byte that enters the checksum after the payload, by message id."""
    return {item.msgid: bytes([item.crc_extra]) for item in _layouts().values()}
