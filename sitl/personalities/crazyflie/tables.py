"""Tables of contents: how a client learns the names, types and numbers of log variables and parameters.

The second version of the protocol, with identifiers of 16 bits. Refuses to know values.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

_ITEM, _INFO = 2, 3


class Table:
    """What can be asked for by number.

    Args:
        entries: type byte and full name, "group.name", in the order of their numbers.
    """

    def __init__(self, entries: Sequence[tuple[int, str]]) -> None:
        self._rows = [bytes((kind,)) + name.replace(".", "\0", 1).encode() + b"\0" for kind, name in entries]
        self._number = {name: k for k, (_, name) in enumerate(entries)}
        self._sum = zlib.crc32(b"".join(self._rows))

    def number(self, name: str) -> int | None:
        """Its number, None when there is none of that name."""
        return self._number.get(name)

    def answer(self, asked: bytes) -> bytes | None:
        """The answer to a question about the table; None to what is none."""
        if asked[:1] == bytes((_INFO,)):
            return struct.pack("<BHI", _INFO, len(self._rows), self._sum)
        if asked[:1] == bytes((_ITEM,)) and len(asked) >= 3:
            (number,) = struct.unpack_from("<H", asked, 1)
            row = self._rows[number] if number < len(self._rows) else None
            return bytes((_ITEM,)) if row is None else asked[:3] + row
        return None
