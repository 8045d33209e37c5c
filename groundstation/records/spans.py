"""Stretches of a log read as columns: what a thousand vehicles say is too much to be looked at frame by frame.

Between two notes that have to be read one by one (events, roles, where frames come from) the order of what was received
and what was sent does not matter to whoever reads a flight as arrays. Whatever is strange about a record, a checksum, a
signature, MAVLink 1, a stamp that leaps, is left to the careful reader (``tlog``), which gives the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from mmap import mmap
from typing import Protocol

import numpy as np

from groundstation.core.quick import every
from groundstation.core.types import BoolArray, IntArray
from groundstation.mavlink.blocks import Block, Datagrams, split
from groundstation.mavlink.codec import MAGIC_V2, message_id, whole_frame
from groundstation.records.notes import NOISE_SUBJECT, OWN_SUBJECT, Kind, Received, Record, unpack_link

LATEST_UNIX_US = 4_102_444_800_000_000  # 2100-01-01
NEAR_US = 86_400_000_000  # one day: neighbours in a log are nearer than that
STAMP_BYTES = 8
_SMALLEST = 20  # bytes of a record whose frame has no payload
_RECORDS = 16_384
_FEW = 64  # records that are read one by one as quickly
_NOTE_FIRST, _NOTE_LAST = 0x9000, 0x9FFF
_PAYLOAD_AT = 5  # of a TUNNEL: behind type, target and length
_TUNNEL = message_id("TUNNEL")


class Assembler(Protocol):
    """Joins notes and remembers where frames come from; see ``tlog``."""

    link: int | None
    next_is_received: bool
    origins: dict[tuple[int | None, int], tuple[int, str]]

    def origin_of(self, subject: int) -> tuple[int, str]:
        """Link and peer of a subject."""

    def take(self, t_ns: int, kind: int, payload: bytes) -> Record | None:
        """Takes one note."""


@dataclass(frozen=True)
class Span:
    """Records of a log between two notes.

    Attributes:
        received: frames that arrived, each as a datagram of its own, with link, peer and time.
        sent: frames that the ground station sent, with their times.
        sent_link: over which link, shape (k,); -1 where the log does not tell.
        ticks: of the mission object.
        first_ns: time of the first record.
        last_ns: latest time of a record.
    """

    received: Block
    sent: Block
    sent_link: IntArray
    ticks: int
    first_ns: int
    last_ns: int


@dataclass(frozen=True)
class Stretch:
    """Plain records one behind the other.

    Attributes:
        block: their frames, each as a datagram of its own; links and sources are not known yet.
        t_ns: their times, shape (k,).
        stop: where the next record begins in the file.
        last_us: stamp of the last one.
    """

    block: Block
    t_ns: IntArray
    stop: int
    last_us: int


def plain_stretch(data: bytes | mmap, position: int, last_us: int | None, epoch_unix_us: int) -> Stretch | None:
    """Plain records from a place in a file on, up to so many; None where they are few, or anything is strange.

    Args:
        data: the file.
        position: where a record begins.
        last_us: stamp of the record before; None at the begin.
        epoch_unix_us: unix time of t = 0.
    """
    starts: list[int] = []
    at, end = position, len(data) - _SMALLEST
    while len(starts) < _RECORDS and at <= end and data[at + STAMP_BYTES] == MAGIC_V2 and not data[at + 10]:
        starts.append(at)
        at += _SMALLEST + data[at + 9]
    if starts and at > len(data):
        at = starts.pop()
    count = len(starts)
    if count < _FEW:
        return None
    raw = np.frombuffer(data[position:at], dtype=np.uint8)
    first = np.array(starts, dtype=np.int64) - position
    stamp_at = first[:, None] + np.arange(STAMP_BYTES)
    stamps = raw[stamp_at].view(">u8")[:, 0].astype(np.int64)
    leaps = np.abs(np.diff(stamps, prepend=stamps[0] if last_us is None else last_us))
    if not every((leaps <= NEAR_US) & (stamps <= LATEST_UNIX_US)):
        return None
    is_frame = np.ones(len(raw), dtype=np.bool_)
    is_frame[stamp_at] = False
    frames = raw[is_frame].tobytes()
    t_ns = (stamps - epoch_unix_us) * 1000
    none = np.zeros(count, dtype=np.int64)
    offsets = np.append(first - STAMP_BYTES * np.arange(count), len(frames))
    block = split(frames, Datagrams(offsets, none, none, t_ns, ((0, ""),)))
    if len(block) != count or block.noise or not every(block.known):
        return None
    return Stretch(block, t_ns, at, int(stamps[-1]))


class Cutter:
    """Cuts stretches into spans at the notes that have to be read one by one.

    Args:
        assembler: of the log; shared with whoever reads its records one by one.
        sender: system and component id of the ground station.
    """

    def __init__(self, assembler: Assembler, sender: tuple[int, int]) -> None:
        self._assembler, self._sender = assembler, sender
        self._number: dict[tuple[int, str], int] = {(0, ""): 0}
        self._sources = tuple(self._number)

    def cut(self, stretch: Stretch) -> Iterator[Record | Span]:
        """Gives its spans, and what its notes tell, in order."""
        block, assembler = stretch.block, self._assembler
        ours: BoolArray = (block.sysid == self._sender[0]) & (block.compid == self._sender[1])
        octets = np.frombuffer(block.data, dtype=np.uint8).astype(np.int64)
        kind = octets[block.payload] | octets[block.payload + 1] << 8
        note = ours & (block.msgid == _TUNNEL) & (kind >= _NOTE_FIRST) & (kind <= _NOTE_LAST)
        link = np.full(len(block), -1 if assembler.link is None else assembler.link, dtype=np.int64)
        sent, begin, ticks = ours & ~note, 0, 0
        if assembler.next_is_received:
            yield self._own_frame(stretch, 0)
            begin = 1
        for row in note.nonzero()[0].tolist():
            if row < begin:
                continue
            if kind[row] == Kind.TICK:
                ticks += 1
                continue
            if kind[row] == Kind.LINK:
                assembler.link = unpack_link(_payload(block, row))
                link[row:] = assembler.link
                continue
            if row > begin:
                yield self._span(stretch, slice(begin, row), (ours, sent), link, ticks)
            begin, ticks = row + 1, 0
            record = assembler.take(int(stretch.t_ns[row]), int(kind[row]), _payload(block, row))
            if record is not None:
                yield record
            if assembler.next_is_received and begin < len(block):
                yield self._own_frame(stretch, begin)
                begin += 1
        if begin < len(block):
            yield self._span(stretch, slice(begin, len(block)), (ours, sent), link, ticks)

    def _own_frame(self, stretch: Stretch, row: int) -> Received:
        """A frame that bears our own ids and yet was received."""
        self._assembler.next_is_received = False
        block = stretch.block
        frame = whole_frame(block.data[int(block.start[row]) : int(block.stop[row])])
        assert frame is not None  # noqa: S101 - it is one of a stretch of nothing else
        return Received(int(stretch.t_ns[row]), *self._assembler.origin_of(OWN_SUBJECT), frame)

    def _span(
        self, stretch: Stretch, part: slice, ours_sent: tuple[BoolArray, BoolArray], link: IntArray, ticks: int
    ) -> Span:
        ours, sent = ours_sent
        rows = np.arange(part.start, part.stop)
        came, went = rows[~ours[part]], rows[sent[part]]
        t_ns = stretch.t_ns[part]
        return Span(
            self._with_origins(stretch.block, came, link),
            _rows(stretch.block, went),
            link[went],
            ticks,
            int(t_ns[0]),
            int(t_ns.max()),
        )

    def _with_origins(self, block: Block, rows: IntArray, link: IntArray) -> Block:
        """Frames that arrived, with the link and the peer that the notes before them tell."""
        told = self._assembler.link is not None
        of_row = np.maximum(link[rows], 0) if told else np.zeros(len(rows), dtype=np.int64)
        table = np.full((int(of_row.max(initial=0)) + 1, 256), -1, dtype=np.int64)
        for (at, subject), source in self._assembler.origins.items():
            if subject < NOISE_SUBJECT and (at is not None) == told and (at or 0) < len(table):
                table[at or 0, subject] = self._source(source)
        source = table[of_row, block.sysid[rows]]
        for nowhere in np.unique(of_row[source < 0]).tolist():
            source[(source < 0) & (of_row == nowhere)] = self._source((nowhere, ""))
        if len(self._sources) != len(self._number):
            self._sources = tuple(self._number)
        links = np.array([at for at, _ in self._sources], dtype=np.int64)
        where = block.datagrams
        whole = np.zeros(len(block), dtype=np.int64)
        named, at_link = whole.copy(), whole
        named[rows], at_link[rows] = source, links[source]
        return _rows(replace(block, datagrams=where._replace(link=at_link, source=named, sources=self._sources)), rows)

    def _source(self, source: tuple[int, str]) -> int:
        return self._number.setdefault(source, len(self._number))


def _payload(block: Block, row: int) -> bytes:
    """What a note holds."""
    start, size = int(block.payload[row]), int(block.payload_size[row])
    whole = block.data[start : start + size].ljust(_PAYLOAD_AT, b"\0")
    return whole[_PAYLOAD_AT : _PAYLOAD_AT + whole[4]].ljust(whole[4], b"\0")


def _rows(block: Block, rows: IntArray) -> Block:
    """Some of the frames of a block."""
    return replace(
        block,
        start=block.start[rows],
        stop=block.stop[rows],
        payload=block.payload[rows],
        payload_size=block.payload_size[rows],
        msgid=block.msgid[rows],
        known=block.known[rows],
        seq=block.seq[rows],
        sysid=block.sysid[rows],
        compid=block.compid[rows],
        signed=block.signed[rows],
        datagram=block.datagram[rows],
    )
