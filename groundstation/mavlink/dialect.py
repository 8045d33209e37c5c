"""What of the MAVLink dialect is needed: how messages lie on the wire, and names of a few enumerations.

Read off pymavlink's generated message classes (dialect ``ardupilotmega``, which contains ``common``); nothing is typed
by hand. Whoever builds a wheel has pymavlink and puts ``tables.json`` into it, made here, so that whoever installs the
wheel does without the 100 MB of pymavlink; in a checkout there is no such file, and pymavlink is asked itself.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

TABLES = Path(__file__).parent / "tables.json"
_ENUMS = "MAV_TYPE", "MAV_AUTOPILOT"
_END = "_ENUM_END"


@dataclass(frozen=True)
class Message:
    """A message type, as pymavlink's generated class has it.

    Attributes:
        name: for example ``LOCAL_POSITION_NED``.
        msgid: its number.
        crc_extra: enters the checksum after the payload.
        fields: names, in wire order.
        codes: of ``struct``, one a field; ``c`` for text.
        lengths: 0 for scalars; number of items, or of bytes of a text.
        packing: the format of ``struct``, arrays flattened.
    """

    name: str
    msgid: int
    crc_extra: int
    fields: tuple[str, ...]
    codes: str
    lengths: tuple[int, ...]
    packing: str


@dataclass(frozen=True)
class Dialect:
    """All message types by number, and enumerations by name: number, name of the entry."""

    messages: Mapping[int, Message]
    enums: Mapping[str, Mapping[int, str]]

    def number(self, entry: str) -> int:
        """Number of an entry, for example of ``MAV_TYPE_GCS``.

        Raises:
            KeyError: no enumeration that is kept has such an entry.
        """
        for entries in self.enums.values():
            for number, name in entries.items():
                if name == entry:
                    return number
        raise KeyError(entry)


@cache
def dialect() -> Dialect:
    """The dialect: out of the tables where there are some, off pymavlink otherwise."""
    return from_json(TABLES.read_text(encoding="utf-8")) if TABLES.exists() else from_pymavlink()


def from_pymavlink() -> Dialect:
    """Reads pymavlink's classes."""
    from pymavlink.dialects.v20 import ardupilotmega  # noqa: PLC0415 - a wheel does without

    messages = {
        int(msgid): Message(
            str(kind.msgname),
            int(kind.id),
            int(kind.crc_extra),
            tuple(map(str, kind.ordered_fieldnames)),
            bytes(kind.native_format).decode().lstrip("<"),
            tuple(map(int, kind.array_lengths)),
            str(kind.unpacker.format),
        )
        for msgid, kind in ardupilotmega.mavlink_map.items()
    }
    enums = {
        group: {int(number): str(entry.name) for number, entry in ardupilotmega.enums[group].items()}
        for group in _ENUMS
    }
    return Dialect(
        messages,
        {group: {at: name for at, name in of.items() if not name.endswith(_END)} for group, of in enums.items()},
    )


def to_json(tables: Dialect) -> str:
    """The tables as text, the same for the same dialect."""
    values = {"messages": [asdict(item) for item in tables.messages.values()], "enums": tables.enums}
    return json.dumps(values, separators=(",", ":")) + "\n"


def from_json(text: str) -> Dialect:
    """Reads what ``to_json`` wrote."""
    values = json.loads(text)
    messages = {
        item["msgid"]: Message(**item | {"fields": tuple(item["fields"]), "lengths": tuple(item["lengths"])})
        for item in values["messages"]
    }
    return Dialect(
        messages, {group: {int(at): name for at, name in of.items()} for group, of in values["enums"].items()}
    )
