"""Many datagrams in one buffer, cut into frames and read as columns together: no work in Python for each frame.

Finds exactly what ``FrameSplitter`` finds in each datagram by itself, whatever the bytes are; a test holds them side by
side. All that may be the begin of a frame is looked at in the same few steps, so that bytes made up to take long do
not.

Streams, whose frames come in pieces, and links on which signatures are checked go through ``FrameSplitter``.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray

from groundstation.core.quick import every, some
from groundstation.core.types import BoolArray, IntArray
from groundstation.mavlink.checksums import ROW, Sums, Words, stretches_checksum
from groundstation.mavlink.codec import Batch
from groundstation.mavlink.layouts import crc_extra_bytes, layouts_by_id
from groundstation.mavlink.splitting import (
    CRC_BYTES,
    HEADER_V1,
    HEADER_V2,
    INCOMPAT_SIGNED,
    MAGIC_V2,
    SIGNATURE_BYTES,
    Frame,
    Piece,
)

_BEHIND = 2 * ROW  # bytes that may be read behind the last one
_ID_MAX = 0xFFFF
_SOURCES_MAX = 2_000
_FEW = 100
_CHAIN_MAX = 64  # frames of a datagram; more, and smaller ones, are searched for
_OVERLAP_MAX = 4  # times that a byte is looked at by each frame that may lie there
_SHORTEST = HEADER_V2 + CRC_BYTES  # a frame of MAVLink 2 without a payload
_FEW_BYTES = 8_192  # as long as frames are quicker looked at one by one
_FAR = np.iinfo(np.int64).max
_HEADER = struct.Struct("<3B4xHB")  # magic, size, flags, and the message id in two parts


class Datagrams(NamedTuple):
    """Where datagrams lie in a buffer, whence they came and when.

    Attributes:
        offsets: where each begins, and where the last one ends, shape (m + 1,).
        link: where each came in, shape (m,).
        source: which of ``sources`` it came from, shape (m,).
        t_rx_ns: when, shape (m,).
        sources: (link, peer) of all that spoke.
    """

    offsets: IntArray
    link: IntArray
    source: IntArray
    t_rx_ns: IntArray
    sources: tuple[tuple[int, str], ...]


@dataclass(frozen=True)
class Block:
    """The frames of some datagrams, in the order of arrival.

    Attributes:
        data: the bytes of all datagrams, and zeros behind them.
        size: bytes of the datagrams.
        start: where each frame begins, shape (k,).
        stop: where it ends, shape (k,).
        payload: where its payload begins, shape (k,).
        payload_size: bytes of it, as sent, shape (k,).
        msgid: message ids, shape (k,).
        known: whether the dialect knows them, so that the checksum was tested, shape (k,).
        seq: sequence numbers, shape (k,).
        sysid: senders' system ids, shape (k,).
        compid: their component ids, shape (k,).
        signed: whether it carries a signature (which nobody has checked), shape (k,).
        datagram: number of the datagram that it came in, shape (k,).
        datagrams: what is known of the datagrams.
    """

    data: bytes
    size: int
    start: IntArray
    stop: IntArray
    payload: IntArray
    payload_size: IntArray
    msgid: IntArray
    known: BoolArray
    seq: IntArray
    sysid: IntArray
    compid: IntArray
    signed: BoolArray
    datagram: IntArray
    datagrams: Datagrams

    def __len__(self) -> int:
        """Number of frames, k."""
        return len(self.start)

    @property
    def noise(self) -> int:
        """Bytes that were no frame."""
        return self.size - int((self.stop - self.start).sum())

    def pieces(self) -> Iterator[tuple[int, str, list[Piece], int]]:
        """Link, peer, pieces and time of each datagram, as ``FrameSplitter`` gives the pieces; for the careful path."""
        offsets, data = self.datagrams.offsets.tolist(), self.data
        first = np.searchsorted(self.datagram, np.arange(len(offsets))).tolist()
        starts, stops = self.start.tolist(), self.stop.tolist()
        at = zip(self.datagrams.source.tolist(), self.datagrams.t_rx_ns.tolist(), strict=True)
        for number, (source, t_rx_ns) in enumerate(at):
            position, end = offsets[number], offsets[number + 1]
            pieces: list[Piece] = []
            for k in range(first[number], first[number + 1]):
                if position < starts[k]:
                    pieces.append(data[position : starts[k]])
                position = stops[k]
                pieces.append(self._frame(k, data[starts[k] : position]))
            if position < end:
                pieces.append(data[position:end])
            link, peer = self.datagrams.sources[source]
            yield link, peer, pieces, t_rx_ns

    def _frame(self, k: int, raw: bytes) -> Frame:
        payload, size = int(self.payload[k]), int(self.payload_size[k])
        return Frame(
            int(self.msgid[k]),
            int(self.sysid[k]),
            int(self.compid[k]),
            int(self.seq[k]),
            self.data[payload : payload + size],
            raw,
            2 if raw[0] == MAGIC_V2 else 1,
            bool(self.signed[k]),
        )

    def decode(self, wanted: Collection[int] | None = None, among: IntArray | None = None) -> list[Batch]:
        """Turns frames into columns, one batch for each message type; see ``codec.decode``.

        Args:
            wanted: ids of the messages that are asked for; None for all that the dialect knows.
            among: numbers of the frames, ascending, shape (j,); None for all.
        """
        msgid = self.msgid if among is None else self.msgid[among]
        batches = []
        known = layouts_by_id()
        for number in _in_order(msgid):
            shape = known.get(number)
            if shape is None or (wanted is not None and number not in wanted):
                continue
            rows = (msgid == number).nonzero()[0]
            if among is not None:
                rows = among[rows]
            values = self._window(shape.size)[self.payload[rows]]
            size = self.payload_size[rows]
            # A newer dialect appends fields that this one does not know: what is past the size is not in the window.
            sizes = size.tolist() if len(size) <= _FEW else (int(size.min()), int(size.max()))
            least, most = min(sizes), min(max(sizes), shape.size)
            if least < shape.size:  # the rest was cut off, or never sent: it reads as zeros
                raw = values.view(np.uint8).reshape(len(rows), shape.size)
                raw[:, most:] = 0
                if least < most:
                    raw[:, least:most][np.arange(least, most) >= size[:, None]] = 0
            sysid, compid = self.sysid[rows].astype(np.uint8), self.compid[rows].astype(np.uint8)
            batches.append(Batch(shape.name, sysid, compid, rows, values.view(shape.dtype)))
        return batches

    def _window(self, size: int) -> NDArray[np.void]:
        """Pieces of a size that begin at every byte of the buffer; a view."""
        count = len(self.data) - size + 1
        return np.ndarray((count,), dtype=_void(size), buffer=self.data, strides=(1,))


class Arrivals:
    """Collects datagrams until somebody takes them as a block.

    Attributes:
        size: bytes so far.
    """

    def __init__(self) -> None:
        self.size = 0
        self._items: list[tuple[int, str, bytes, int]] = []
        self._number: dict[tuple[int, str], int] = {}
        self._named: tuple[tuple[int, str], ...] = ()

    def __len__(self) -> int:
        """Number of datagrams."""
        return len(self._items)

    def add(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> None:
        """Takes one datagram."""
        self._items.append((link, peer, data, t_rx_ns))
        self.size += len(data)

    def extend(self, datagrams: Sequence[tuple[int, str, bytes, int]]) -> None:
        """Takes many datagrams: link, peer, bytes, time of each."""
        self._items += datagrams
        self.size += sum([len(item[2]) for item in datagrams])

    def datagrams(self) -> list[tuple[int, str, bytes, int]]:
        """Hands out the datagrams one by one: link, peer, bytes, time."""
        taken, self._items = self._items, []
        self.size = 0
        return taken

    def block(self) -> Block:
        """Hands out the datagrams as a block."""
        items, number = self.datagrams(), self._number
        offsets = np.zeros(len(items) + 1, dtype=np.int64)
        datas = [item[2] for item in items]
        np.add.accumulate(list(map(len, datas)), out=offsets[1:])
        sources = [number.setdefault(item[:2], len(number)) for item in items]
        if len(self._named) != len(number):
            self._named = tuple(number)
        where = Datagrams(
            offsets,
            link=np.array([item[0] for item in items], dtype=np.int64),
            source=np.array(sources, dtype=np.int64),
            t_rx_ns=np.array([item[3] for item in items], dtype=np.int64),
            sources=self._named,
        )
        block = split(b"".join(datas), where)
        if len(number) > _SOURCES_MAX:
            number.clear()
            self._named = ()
        return block


def merge(blocks: Sequence[Block]) -> Block:
    """One block of several; they stand one behind the other."""
    if len(blocks) == 1:
        return blocks[0]
    sizes = np.cumsum([0, *(block.size for block in blocks)]).tolist()
    counts = np.cumsum([0, *(len(block.datagrams.link) for block in blocks)]).tolist()
    number: dict[tuple[int, str], int] = {}
    parts = []
    for block, before in zip(blocks, sizes, strict=False):
        item = block.datagrams
        names = np.array([number.setdefault(name, len(number)) for name in item.sources], dtype=np.int64)
        parts.append(item._replace(offsets=item.offsets[:-1] + before, source=names[item.source]))

    return Block(
        b"".join([*(block.data[: block.size] for block in blocks), bytes(_BEHIND)]),
        sizes[-1],
        _behind([block.start for block in blocks], sizes),
        _behind([block.stop for block in blocks], sizes),
        _behind([block.payload for block in blocks], sizes),
        np.concatenate([block.payload_size for block in blocks]),
        np.concatenate([block.msgid for block in blocks]),
        np.concatenate([block.known for block in blocks]),
        np.concatenate([block.seq for block in blocks]),
        np.concatenate([block.sysid for block in blocks]),
        np.concatenate([block.compid for block in blocks]),
        np.concatenate([block.signed for block in blocks]),
        _behind([block.datagram for block in blocks], counts),
        Datagrams(
            np.append(np.concatenate([part.offsets for part in parts]), sizes[-1]),
            np.concatenate([part.link for part in parts]),
            np.concatenate([part.source for part in parts]),
            np.concatenate([part.t_rx_ns for part in parts]),
            tuple(number),
        ),
    )


def _behind(columns: Sequence[IntArray], before: Sequence[int]) -> IntArray:
    """Places of several buffers in one that has them one behind the other."""
    return np.concatenate([column + add for column, add in zip(columns, before, strict=False)])


def split(data: bytes, datagrams: Datagrams) -> Block:
    """Finds the frames of datagrams that stand one behind the other."""
    size = len(data)
    if size <= _FEW_BYTES:
        begins = _plain_begins(data, datagrams.offsets.tolist())
        if begins:
            return _plain_block(data + bytes(_BEHIND), size, np.array(begins, dtype=np.int64), datagrams)
    else:
        padded = data + bytes(_BEHIND)
        start = _plain_chains(padded, size, datagrams.offsets)
        if len(start):
            return _plain_block(padded, size, start, datagrams)
    return _search(data, datagrams)


def _search(data: bytes, datagrams: Datagrams) -> Block:
    """The same, whatever the bytes are: all that may be the begin of a frame is looked at together."""
    size = len(data)
    data += bytes(_BEHIND + -size % ROW)
    octets = np.frombuffer(data, dtype=np.uint8)
    words = _words_of(data)
    longs: IntArray = np.ndarray((size,), dtype="<i8", buffer=data, strides=(1,))

    at = _is_magic(octets[:size]).nonzero()[0]
    datagram = np.searchsorted(datagrams.offsets, at, side="right") - 1
    head = longs[at]
    second = (head & 0xFF) == MAGIC_V2
    payload = at + np.where(second, HEADER_V2, HEADER_V1)
    body_stop = payload + ((head >> 8) & 0xFF)
    flags = np.where(second, (head >> 16) & 0xFF, 0)
    stop = body_stop + CRC_BYTES + SIGNATURE_BYTES * (flags & INCOMPAT_SIGNED)
    limit = datagrams.offsets[datagram + 1]
    fits = ((stop <= limit) & (flags <= INCOMPAT_SIGNED)).nonzero()[0]
    if len(fits) < len(at):
        at, datagram, head, second, payload, body_stop, flags, stop, limit = (
            column[fits] for column in (at, datagram, head, second, payload, body_stop, flags, stop, limit)
        )
    msgid = np.where(second, _ids(head, words, at), (head >> 40) & 0xFF)

    extra = _extras()[np.minimum(msgid, _ID_MAX)]
    known = extra >= 0
    chosen = known.copy()
    if len(at):
        tested = slice(None) if every(known) else known.nonzero()[0]
        begins, ends, more = at[tested] + 1, body_stop[tested], extra[tested].astype(np.uint16)
        if int((ends - begins).sum()) <= _OVERLAP_MAX * size:
            made = stretches_checksum(data, begins, ends, more)
        else:  # made up to take long
            made = Sums(octets).checksums(begins, ends, more)
        chosen[tested] = made == words[ends]
        if not isinstance(tested, slice):
            unknown = (~known).nonzero()[0]
            good = np.append(at[chosen], _FAR)
            follows = (stop[unknown] == limit[unknown]) | _is_magic(octets[stop[unknown]])
            none_inside = good[np.searchsorted(good, at[unknown], side="right")] >= stop[unknown]
            chosen[unknown] = follows & none_inside
    rows = chosen.nonzero()[0]
    begins, ends = at[rows], stop[rows]
    if some(begins[1:] < ends[:-1]):
        rows = rows[_one_behind_the_other(begins.tolist(), ends.tolist())]
        begins, ends = at[rows], stop[rows]
    names = head[rows] >> np.where(second[rows], 32, 16)
    return Block(
        data,
        size,
        begins,
        ends,
        payload[rows],
        body_stop[rows] - payload[rows],
        msgid[rows],
        known[rows],
        names & 0xFF,
        (names >> 8) & 0xFF,
        (names >> 16) & 0xFF,
        flags[rows] > 0,
        datagram[rows],
        datagrams,
    )


def _plain_begins(data: bytes, offsets: list[int]) -> list[int]:
    """Where the frames begin of datagrams that hold whole, unsigned, known frames of MAVLink 2 and nothing else.

    ``FrameSplitter`` finds the same ones there, since it takes what begins where the frame before has ended. Nothing
    comes back where there is anything else: that takes a closer look.
    """
    extras, checksum, header = crc_extra_bytes(), crc16.mcrf4xx, _HEADER.unpack_from
    begins: list[int] = []
    position = 0
    for end in offsets[1:]:
        while position < end:
            stop = position + _SHORTEST
            if stop > end:
                return []
            magic, size, flags, low, high = header(data, position)
            stop += size
            extra = extras.get(low | high << 16)
            if magic != MAGIC_V2 or flags or extra is None or stop > end:
                return []
            told = data[stop - 2] | data[stop - 1] << 8
            if checksum(data[position + 1 : stop - CRC_BYTES] + extra) != told:
                return []
            begins.append(position)
            position = stop
    return begins


def _plain_chains(data: bytes, size: int, offsets: IntArray) -> IntArray:
    """The same where there are many: of all datagrams one frame after the other, with zeros behind the data."""
    heads: IntArray = np.ndarray((size,), dtype="<i8", buffer=data, strides=(1,))
    none: IntArray = np.zeros(0, dtype=np.int64)
    at, end = offsets[:-1], offsets[1:]
    chains: list[IntArray] = []
    while True:
        on = at < end
        if not every(on):
            at, end = at[on], end[on]
            if not len(at):
                break
        head = heads[at]
        following = at + (((head >> 8) & 0xFF) + _SHORTEST)
        if len(chains) == _CHAIN_MAX or not every(((head & 0xFF00FF) == MAGIC_V2) & (following <= end)):
            return none
        chains.append(at)
        at = following
    if not chains:
        return none
    start = chains[0] if len(chains) == 1 else np.sort(np.concatenate(chains))
    head, words = heads[start], _words_of(data)
    extra = _extras()[np.minimum(_ids(head, words, start), _ID_MAX)]
    if int(extra.min()) < 0:
        return none
    stop = start + (((head >> 8) & 0xFF) + HEADER_V2)
    made = stretches_checksum(data, start + 1, stop, extra.astype(np.uint16))
    return start if every(made == words[stop]) else none


def _words_of(data: bytes) -> Words:
    """Two bytes from every byte on; a view."""
    return np.ndarray((len(data) - 1,), dtype="<u2", buffer=data, strides=(1,))


def _ids(head: IntArray, words: Words, start: IntArray) -> IntArray:
    """Message ids of frames of MAVLink 2, from their first eight bytes and the two behind these."""
    return ((head >> 56) & 0xFF) | (words[start + 8].astype(np.int64) << 8)


def _plain_block(data: bytes, size: int, start: IntArray, datagrams: Datagrams) -> Block:
    """A block of nothing but whole, unsigned, known frames of MAVLink 2 that begin there; zeros are behind the data."""
    head = np.ndarray((size,), dtype="<i8", buffer=data, strides=(1,))[start]
    count, payload_size = len(start), (head >> 8) & 0xFF
    return Block(
        data,
        size,
        start,
        start + (payload_size + _SHORTEST),
        start + HEADER_V2,
        payload_size,
        _ids(head, _words_of(data), start),
        np.ones(count, dtype=np.bool_),
        (head >> 32) & 0xFF,
        (head >> 40) & 0xFF,
        (head >> 48) & 0xFF,
        np.zeros(count, dtype=np.bool_),
        datagrams.offsets.searchsorted(start, side="right") - 1,
        datagrams,
    )


def _in_order(numbers: IntArray) -> list[int]:
    """Each number once, in the order in which they first appear."""
    if len(numbers) <= _FEW:
        return list(dict.fromkeys(numbers.tolist()))
    found = []
    while len(numbers):
        found.append(int(numbers[0]))
        numbers = numbers[numbers != found[-1]]
        if len(found) == _FEW:  # so many kinds are not the usual
            return found + list(dict.fromkeys(numbers.tolist()))
    return found


def _is_magic(octets: NDArray[np.uint8]) -> BoolArray:
    result: BoolArray = (octets - np.uint8(0xFD)) < 2
    return result


def _one_behind_the_other(begins: list[int], ends: list[int]) -> list[int]:
    """Numbers of those that do not begin inside one that was taken before."""
    taken, free = [], 0
    for number, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        if begin >= free:
            taken.append(number)
            free = end
    return taken


@cache
def _void(size: int) -> np.dtype[np.void]:
    return np.dtype(f"V{size}")


@cache
def _extras() -> NDArray[np.int16]:
    """The byte behind the payload by message id, -1 for ids that the dialect does not know."""
    table = np.full(_ID_MAX + 1, -1, dtype=np.int16)
    for msgid, shape in layouts_by_id().items():
        if msgid >= _ID_MAX:
            raise AssertionError(f"{shape.name}: id {msgid}, room for ids below {_ID_MAX}")
        table[msgid] = shape.crc_extra
    return table
