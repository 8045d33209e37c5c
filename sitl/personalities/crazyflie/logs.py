"""Log blocks: which variables a client wants together, how often, and the packets that carry them.

Limits as in the firmware: 16 blocks, 128 variables, 26 bytes of values a packet. Periods are counted in 10 ms; the
emulated vehicle looks every 20 ms, so that nothing is sent faster than 50 Hz. Refuses to know what variables mean.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from sitl.personalities.crazyflie.tables import Table
from sitl.personalities.crazyflie.variables import I8, I16, I32, SHAPES, U8, U16, U32, VARIABLES, Logged

_CREATE_OLD, _APPEND_OLD, _DELETE, _START, _STOP, _RESET, _CREATE, _APPEND = range(8)
_NO_ENTRY, _NO_COMMAND, _TOO_LARGE, _NO_MEMORY, _EXISTS = 2, 8, 7, 12, 17
_BLOCKS_MAX, _VARIABLES_MAX, _BYTES_MAX = 16, 128, 26
_PERIOD_NS = 10_000_000
_LIMITS = {
    U8: (0, 2**8),
    U16: (0, 2**16),
    U32: (0, 2**32),
    I8: (-(2**7), 2**7),
    I16: (-(2**15), 2**15),
    I32: (-(2**31), 2**31),
}
_NAMES = list(VARIABLES)


@dataclass
class _Block:
    """What is sent together: (type, name) each, and their shape; with ``period_ns`` 0 it stands still."""

    variables: list[tuple[int, str]] = field(default_factory=list)
    shape: str = "<"
    period_ns: int = 0
    next_ns: int = 0


class LogPort:
    """One vehicle's log blocks.

    Args:
        vehicle: whose variables.
    """

    def __init__(self, vehicle: Logged) -> None:
        self._vehicle = vehicle
        self._blocks: dict[int, _Block] = {}
        self.table = Table([(kind, name) for name, (kind, _) in VARIABLES.items()])

    def answer(self, channel: int, data: bytes, now_ns: int) -> bytes | None:
        """The answer to a packet on the logs' port; None to what asks for nothing."""
        if channel == 0:
            return self.table.answer(data)
        if channel != 1 or not data:
            return None
        if data[0] == _RESET:
            self._blocks.clear()
            return bytes((_RESET, 0, 0))
        if len(data) < 2:
            return None
        return data[:2] + bytes((self._settle(data[0], data[1], data[2:], now_ns),))

    def _settle(self, command: int, number: int, rest: bytes, now_ns: int) -> int:
        block = self._blocks.get(number)
        if command == _CREATE:
            if block is not None:
                return _EXISTS
            if len(self._blocks) >= _BLOCKS_MAX:
                return _NO_MEMORY
            block = self._blocks[number] = _Block()
            error = self._append(block, rest)
            if error:
                del self._blocks[number]
            return error
        if command not in (_APPEND, _DELETE, _START, _STOP):
            return _NO_COMMAND
        if block is None:
            return _NO_ENTRY
        if command == _APPEND:
            return self._append(block, rest)
        if command == _DELETE:
            del self._blocks[number]
        else:
            block.period_ns = rest[0] * _PERIOD_NS if command == _START and rest else 0
            block.next_ns = now_ns + block.period_ns
        return 0

    def _append(self, block: _Block, rest: bytes) -> int:
        wanted = list(block.variables)
        for at in range(0, len(rest) - 2, 3):
            kind, number = rest[at] & 0xF, struct.unpack_from("<H", rest, at + 1)[0]
            if number >= len(_NAMES) or kind not in SHAPES:
                return _NO_ENTRY
            wanted.append((kind, _NAMES[number]))
        if sum(struct.calcsize(SHAPES[kind]) for kind, _ in wanted) > _BYTES_MAX:
            return _TOO_LARGE
        others = sum(len(other.variables) for other in self._blocks.values() if other is not block)
        if others + len(wanted) > _VARIABLES_MAX:
            return _NO_MEMORY
        block.variables = wanted
        block.shape = "<" + "".join(SHAPES[kind] for kind, _ in wanted)
        return 0

    def due(self, now_ns: int, own_time_ns: int) -> Iterator[bytes]:
        """The packets that are to be sent now."""
        for number, block in self._blocks.items():
            if not block.period_ns or now_ns < block.next_ns:
                continue
            block.next_ns = max(block.next_ns + block.period_ns, now_ns)
            stamp = struct.pack("<I", own_time_ns // 1_000_000 & 0xFFFFFF)[:3]
            values = [_fitting(kind, VARIABLES[name][1](self._vehicle)) for kind, name in block.variables]
            yield bytes((number,)) + stamp + struct.pack(block.shape, *values)


def _fitting(kind: int, value: float) -> float:
    """The value as its type can hold it."""
    if kind not in _LIMITS:
        return value
    low, end = _LIMITS[kind]
    return min(max(int(value), low), end - 1)
