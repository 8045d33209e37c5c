"""Parameter tables of the emulated autopilots: a believable set, in the firmware's order (sorted by name).

Refuses to give them a meaning: whoever uses a parameter reads it by name.
"""

from __future__ import annotations

import math
import struct

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9
_INTEGERS = {1, 2, 3, 4, 5, 6}
Value = tuple[float, int]


class ParamSet:
    """Named numbers with their MAVLink types, sorted by name."""

    def __init__(self, values: dict[str, Value]) -> None:
        self._names = sorted(values)
        self._position = {name: k for k, name in enumerate(self._names)}
        self._values = dict(values)

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, name: str) -> float:
        return self._values[name][0]

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def at(self, position: int) -> tuple[str, float, int]:
        """Name, value and MAVLink type at a position."""
        name = self._names[position]
        return (name, *self._values[name])

    def position(self, name: str) -> int | None:
        """Where a parameter stands, None when there is none of that name."""
        return self._position.get(name)

    @staticmethod
    def is_integer(kind: int) -> bool:
        """Whether a MAVLink type is an integer."""
        return kind in _INTEGERS

    def set_value(self, name: str, value: float) -> bool:
        """Stores a value as its type holds it; NaN and infinity change nothing. Returns whether it changed."""
        old, kind = self._values[name]
        if not math.isfinite(value):
            return False
        if kind in _INTEGERS:
            limit = float(2 ** {INT8: 7, INT16: 15}.get(kind, 31))
            new = float(round(min(max(value, -limit), limit - 1.0)))
        else:
            new = struct.unpack("<f", struct.pack("<f", value))[0]
        self._values[name] = (new, kind)
        return bool(new != old)


def read_table(text: str) -> dict[str, Value]:
    """Reads names and numbers that alternate; a number with a decimal point is a float, one without an int32."""
    words = text.split()
    return {
        name: (float(number), REAL32 if "." in number else INT32)
        for name, number in zip(words[::2], words[1::2], strict=True)
    }
