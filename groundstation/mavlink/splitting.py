"""Cuts what arrives into MAVLink frames: bytes in, frames and left-over bytes out, nothing lost.

Whoever sends may be anybody, so that the work is bounded for every input: each byte is looked at as the possible begin
of a frame twice at most, and a checksum covers 265 bytes at most (see ``FrameSplitter``). Refuses to know what a frame
means, and to check a signature.
"""

from __future__ import annotations

import re
from collections.abc import Hashable
from typing import NamedTuple

from fastcrc import crc16

from groundstation.mavlink.layouts import crc_extra_bytes

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
HEADER_V1 = 6
HEADER_V2 = 10
CRC_BYTES = 2
SIGNATURE_BYTES = 13
INCOMPAT_SIGNED = 0x01
_MAGIC = re.compile(b"[\xfd\xfe]")
_NOWHERE = -1


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


Piece = Frame | bytes
"""A good frame, or bytes that were none."""


class _Extent(NamedTuple):
    """What a header says of its frame: where it would end. ``stop`` is 0 for what cannot be a frame."""

    msgid: int
    header: int
    body_stop: int
    stop: int


class FrameSplitter:
    """Cuts what one peer sends into frames.

    The pieces that ``feed`` returns, joined in order (``raw`` of the frames), are the bytes that went in, but for
    what a stream still holds back because its frame is not complete. Where a checksum fails, the search goes on at
    the very next byte, so that noise never takes a good frame with it. A frame with an id that the dialect does not
    know has no checksum we could test: it is taken by its length when a frame starts behind it or nothing follows, and
    no frame whose checksum is right begins inside it.

    What begins inside is looked for from left to right and remembered, also from call to call: frames that claim to lie
    over each other share what was found, so that no byte is tested anew for each of them.

    Args:
        datagrams: True when frames never span two calls (UDP); what is incomplete at the end of a call is noise then.
    """

    def __init__(self, *, datagrams: bool = True) -> None:
        self._more = not datagrams
        self._held = b""
        # Of the bytes held: up to where frames with a checksum were looked for ahead; where the last one begins that
        # was found, or, in a stream, may begin once it is complete; and which of the two. Between both there is none.
        self._searched = 0
        self._found = _NOWHERE
        self._found_is_good = False

    def feed(self, data: bytes) -> list[Piece]:
        """Takes what arrived.

        Args:
            data: one datagram, or the next bytes of a stream.

        Returns:
            Good frames, and runs of bytes that were none, in the order of arrival.
        """
        if not self._held:
            plain = plain_frame(data)
            if plain is not None:
                return [plain]
        buffer = self._held + data if self._held else data
        pieces: list[Piece] = []
        position = noise_start = 0
        end = len(buffer)
        while (magic := _MAGIC.search(buffer, position)) is not None:
            position = magic.start()
            extent = _extent(buffer, position)
            verdict = self._judge(buffer, position, extent) if extent.stop else False
            if verdict:
                if noise_start < position:
                    pieces.append(buffer[noise_start:position])
                pieces.append(_frame(buffer, position, extent))
                position = noise_start = extent.stop
            elif verdict is None and self._more:
                break
            else:
                position += 1
        else:
            position = end
        if noise_start < position:
            pieces.append(buffer[noise_start:position])
        self._held = buffer[position:]
        self._searched = max(self._searched - position, 0)
        self._found = max(self._found - position, _NOWHERE)
        return pieces

    def _judge(self, buffer: bytes, start: int, extent: _Extent) -> bool | None:
        """Whether a frame begins at a magic byte; None when its end, or that of one inside it, has not arrived."""
        if extent.stop > len(buffer):
            return None
        extra = crc_extra_bytes().get(extent.msgid)
        if extra is not None:
            looked_at = start < self._searched and start != self._found
            return not looked_at and _checksum_is_right(buffer, start, extent, extra)
        if extent.stop < len(buffer) and buffer[extent.stop] not in (MAGIC_V1, MAGIC_V2):
            return False
        return self._none_inside(buffer, start + 1, extent.stop)

    def _none_inside(self, buffer: bytes, start: int, stop: int) -> bool | None:
        """Whether no frame with a right checksum begins in a range; None when one may, once it is complete.

        Called with ranges that begin further and further to the right.
        """
        if self._found >= start:
            if self._found >= stop:
                return True
            if self._found_is_good:
                return False
            position = self._found
        else:
            position = max(self._searched, start)
        known = crc_extra_bytes()
        while position < stop and (magic := _MAGIC.search(buffer, position, stop)) is not None:
            position = magic.start()
            extent = _extent(buffer, position)
            complete = extent.stop <= len(buffer)
            if complete and extent.stop and (extra := known.get(extent.msgid)) is not None:
                good = _checksum_is_right(buffer, position, extent, extra)
            else:
                good = False
            if good or (not complete and self._more and (extent.msgid < 0 or extent.msgid in known)):
                self._found, self._found_is_good, self._searched = position, good, position + 1
                return False if good else None
            position += 1
        self._found, self._searched = _NOWHERE, max(self._searched, stop)
        return True


def _extent(buffer: bytes, start: int) -> _Extent:
    """Reads the header at a magic byte. One that is cut off has id -1 and ends behind the buffer."""
    if buffer[start] == MAGIC_V2:
        header = buffer[start : start + HEADER_V2]
        if len(header) < HEADER_V2:
            return _Extent(-1, HEADER_V2, 0, len(buffer) + 1)
        flags = header[2]
        if flags & ~INCOMPAT_SIGNED:
            return _Extent(-1, HEADER_V2, 0, 0)  # a flag that we do not know changes the format: to be discarded
        body_stop = start + HEADER_V2 + header[1]
        stop = body_stop + (CRC_BYTES + SIGNATURE_BYTES if flags else CRC_BYTES)
        return _Extent(header[7] | header[8] << 8 | header[9] << 16, HEADER_V2, body_stop, stop)
    if start + HEADER_V1 > len(buffer):
        return _Extent(-1, HEADER_V1, 0, len(buffer) + 1)
    body_stop = start + HEADER_V1 + buffer[start + 1]
    return _Extent(buffer[start + 5], HEADER_V1, body_stop, body_stop + CRC_BYTES)


def _checksum_is_right(buffer: bytes, start: int, extent: _Extent, extra: bytes) -> bool:
    body_stop = extent.body_stop
    checksum: int = crc16.mcrf4xx(buffer[start + 1 : body_stop] + extra)
    return checksum == buffer[body_stop] | buffer[body_stop + 1] << 8


def _frame(buffer: bytes, start: int, extent: _Extent) -> Frame:
    msgid, header, body_stop, stop = extent
    ids = start + (4 if header == HEADER_V2 else 2)
    seq, sysid, compid = buffer[ids : ids + 3]
    payload = buffer[start + header : body_stop]
    signed = stop - body_stop > CRC_BYTES
    return Frame(msgid, sysid, compid, seq, payload, buffer[start:stop], 2 if header == HEADER_V2 else 1, signed)


def plain_frame(raw: bytes) -> Frame | None:
    """Reads what mostly comes: one unsigned frame of MAVLink 2, nothing else; None for all that takes a closer look."""
    size = len(raw) - (HEADER_V2 + CRC_BYTES)
    if size < 0 or raw[0] != MAGIC_V2 or raw[1] != size or raw[2]:
        return None
    msgid = raw[7] | raw[8] << 8 | raw[9] << 16
    extra = crc_extra_bytes().get(msgid)
    if extra is None or crc16.mcrf4xx(raw[1:-2] + extra) != raw[-2] | raw[-1] << 8:
        return None
    return Frame(msgid, raw[5], raw[6], raw[4], raw[HEADER_V2:-2], raw, 2, False)


def whole_frame(raw: bytes) -> Frame | None:
    """Reads bytes that are one frame and nothing else; None when they are not."""
    if not raw or raw[0] not in (MAGIC_V1, MAGIC_V2):
        return None
    plain = plain_frame(raw)
    if plain is not None:
        return plain
    extent = _extent(raw, 0)
    if extent.stop != len(raw):
        return None
    return _frame(raw, 0, extent) if FrameSplitter()._judge(raw, 0, extent) else None


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

    def feed(self, source: Hashable, data: bytes, *, stream: bool) -> list[Piece]:
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
