"""MAVLink's checksum of many stretches of one buffer at once, with the same work for each byte however they overlap.

The checksum (CRC-16/MCRF4XX) is linear: a step takes the register s and a byte b to A(s ^ b). With the inverse of A,
byte j of a row adds A^-j(b) to a sum over exclusive or, whatever comes later, so that the register behind a stretch
from a to b is A^b of (sum up to b) ^ (sum up to a) ^ A^-a(the register at the begin). Sums are kept row by row, so that
the tables of powers stay small.

Refuses to know what a frame is. Checked against ``fastcrc`` in tests.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray

ROW = 256
"""Bytes of a row; buffers given to ``Sums`` have whole rows."""
_GROUP = 4
_AT_ONCE = 48  # rows
_FEW_ALIKE = 16  # stretches of one length; fewer are looked at one by one
_LONGEST = 272  # bytes that ``rows_checksum`` takes
_START = 0xFFFF
_POLYNOMIAL = 0x8408  # reversed

IntArray = NDArray[np.int64]
Words = NDArray[np.uint16]


class _Tables(NamedTuple):
    """Powers of A.

    ``step`` is A of a low byte; ``back`` is A^-j of a byte, at j * 256 + byte; ``begin`` is A^-j of the first
    register; ``low`` and ``high`` are A^j of a low and of a high byte, at j * 256 + byte.
    """

    step: Words
    back: Words
    begin: Words
    low: Words
    high: Words


@cache
def _tables() -> _Tables:
    step: Words = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        step = np.asarray((step >> 1) ^ np.where(step & 1, _POLYNOMIAL, 0), dtype=np.uint16)
    of_high = np.zeros(256, dtype=np.uint16)
    of_high[step >> 8] = np.arange(256)  # which byte has a step with that high byte
    back = np.empty((_LONGEST, 257), dtype=np.uint16)
    back[0, :256], back[0, 256] = np.arange(256), _START
    low, high = (np.empty((_LONGEST + 1, 256), dtype=np.uint16) for _ in range(2))
    low[0], high[0] = np.arange(256), np.arange(256) << 8
    for power in range(1, _LONGEST):
        byte = of_high[back[power - 1] >> 8]
        back[power] = (back[power - 1] ^ step[byte]) << 8 | byte
    for table in (low, high):
        for power in range(1, _LONGEST + 1):
            table[power] = step[table[power - 1] & 0xFF] ^ table[power - 1] >> 8
    return _Tables(step, back[:, :256].ravel(), back[:, 256].copy(), low.ravel(), high.ravel())


@cache
def _offsets(count: int) -> IntArray:
    return np.arange(count, dtype=np.int64) * 256


class Sums:
    """Sums over a buffer, from which the checksum of any stretch follows.

    Kept within groups of four bytes, and over groups within rows: both together are one addition more for each stretch
    and much less for each byte.

    Args:
        data: bytes, whole rows, shape (n,).
    """

    def __init__(self, data: NDArray[np.uint8]) -> None:
        rows, back = data.reshape(-1, ROW), _tables().back
        within: Words = np.empty(rows.shape, dtype=np.uint16)
        for first in range(0, len(rows), _AT_ONCE):  # places take eight times as much room as the bytes
            part = slice(first, first + _AT_ONCE)
            back.take(rows[part] + _offsets(ROW), mode="clip", out=within[part])
        groups = within.view("<u8")
        groups ^= groups << np.uint64(16)
        groups ^= groups << np.uint64(32)
        over: Words = np.bitwise_xor.accumulate(within[:, _GROUP - 1 :: _GROUP], axis=1)
        groups <<= np.uint64(16)  # sums up to a byte, without it
        self._within = within.ravel()
        self._rows = over[:, -1]
        before = np.zeros(over.shape, dtype=np.uint16)
        before[:, 1:] = over[:, :-1]
        self._groups: Words = before.ravel()

    def checksums(self, start: IntArray, stop: IntArray, extra: Words) -> Words:
        """Checksums of stretches, each with one more byte behind it.

        Args:
            start: first bytes, >= 1, shape (k,).
            stop: behind the last bytes, at most two rows further on, shape (k,).
            extra: the bytes that follow, shape (k,).

        Returns:
            Shape (k,).
        """
        tables = _tables()
        row = start >> 8
        register = tables.begin[start & 0xFF] ^ self._before(start)
        rows_on = (stop >> 8) - row
        if rows_on.any():
            row_low, row_high = tables.low[ROW * 256 :], tables.high[ROW * 256 :]
            for hop in range(int(rows_on.max())):
                at = np.flatnonzero(rows_on > hop)
                whole = register[at] ^ self._rows[row[at] + hop]
                register[at] = row_low[whole & 0xFF] ^ row_high[whole >> 8]
        register ^= self._before(stop)
        return _with_extra(_forward(register, stop & 0xFF), extra)

    def _before(self, at: IntArray) -> Words:
        """Sum from the begin of a row up to a byte in it, without it."""
        before: Words = self._within[at] ^ self._groups[at >> 2]
        return before


def stretches_checksum(data: bytes, start: IntArray, stop: IntArray, extra: Words) -> Words:
    """The same for stretches that hardly overlap: two bytes are taken at a time, of all together.

    Args:
        data: bytes, and as many behind each begin as the longest stretch has, and one more.
        start: first bytes, shape (k,).
        stop: behind the last bytes, shape (k,), all of them behind their begins.
        extra: the bytes that follow, shape (k,).

    Returns:
        Shape (k,).
    """
    if not len(start):
        return np.zeros(0, dtype=np.uint16)
    length = stop - start
    counts = np.bincount(length)
    rare = counts < _FEW_ALIKE
    if not (rare & (counts > 0)).any():
        return _with_extra(_together(data, start, length), extra)
    register: Words = np.empty(len(start), dtype=np.uint16)
    alone = rare[length]
    rows = (~alone).nonzero()[0]
    if len(rows):
        register[rows] = _together(data, start[rows], length[rows])
    rows = alone.nonzero()[0]
    ends = zip(start[rows].tolist(), stop[rows].tolist(), strict=True)
    register[rows] = [crc16.mcrf4xx(data[begin:end]) for begin, end in ends]
    return _with_extra(register, extra)


def _together(data: bytes, start: IntArray, length: IntArray) -> Words:
    """Registers behind stretches, shape (k,) each: all go on by two bytes at a time, as far as each goes."""
    order = np.argsort(length, kind="stable")
    begin, size = start[order], length[order]
    double, width = _double_step(), int(size[-1]) + 1 & ~1
    window: NDArray[np.void] = np.ndarray((len(data) - width + 1,), dtype=f"V{width}", buffer=data, strides=(1,))
    columns: Words = window[begin].view("<u2").reshape(len(begin), width // 2).T
    register: Words = np.full(len(begin), _START, dtype=np.uint16)
    # Those that still go on stand behind those that have ended.
    goes_on = np.searchsorted(size >> 1, np.arange(int(size[-1]) >> 1), side="right").tolist()
    for pair, first in zip(columns, goes_on, strict=False):
        register[first:] = double.take(register[first:] ^ pair[first:])
    odd = (size & 1).nonzero()[0]
    if len(odd):
        octets = np.frombuffer(data, dtype=np.uint8)[begin[odd] + size[odd] - 1]
        register[odd] = _with_extra(register[odd], octets.astype(np.uint16))
    in_place: Words = np.empty_like(register)
    in_place[order] = register
    return in_place


@cache
def _double_step() -> Words:
    """Two steps at once, by the register with two bytes added to it."""
    once = _with_extra(np.arange(1 << 16, dtype=np.uint16), np.uint16(0))
    return _with_extra(once, np.uint16(0))


def rows_checksum(rows: NDArray[np.uint8], length: IntArray, extra: int) -> Words:
    """Checksums of many rows that are filled up with zeros, each with one more byte behind it.

    Args:
        rows: shape (k, width), width up to 272; what is behind ``length`` is zero.
        length: bytes that count, shape (k,).
        extra: the byte that follows each.

    Returns:
        Shape (k,).
    """
    first = rows[:1]
    varying = np.flatnonzero((rows != first).any(axis=0))
    back, offsets = _tables().back, _offsets(rows.shape[1])
    # Zeros add nothing, and a column that is the same in all rows is added once.
    common = back.take(first[0] + offsets)
    common[varying] = 0
    register = np.bitwise_xor.reduce(back.take(rows[:, varying] + offsets[varying]), axis=1)
    register ^= np.uint16(_START) ^ np.bitwise_xor.reduce(common)
    return _with_extra(_forward(register, length), np.uint16(extra))


def _forward(register: Words, power: IntArray) -> Words:
    """A to a power, shape (k,) each."""
    tables, at = _tables(), power << 8
    moved: Words = tables.low[at + (register & 0xFF)] ^ tables.high[at + (register >> 8)]
    return moved


def _with_extra(register: Words, extra: Words | np.uint16) -> Words:
    register = register ^ extra
    stepped: Words = _tables().step[register & 0xFF] ^ (register >> 8)
    return stepped
