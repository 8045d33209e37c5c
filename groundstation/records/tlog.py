"""Writes and reads .tlog: 8-byte big-endian microseconds of unix time, then the raw MAVLink frame, both directions.

The writer never raises into a flight: a full disk ends the recording and is told once. The reader gives every whole
record of a damaged, truncated or foreign log and says what it left out. Neither reads a clock, and neither lets the
key in a SETUP_SIGNING message near a file.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from mmap import ACCESS_READ, mmap
from operator import attrgetter
from pathlib import Path
from types import TracebackType

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.files import require_regular
from groundstation.core.types import BoolArray, IntArray
from groundstation.mavlink.blocks import Block
from groundstation.mavlink.codec import (
    MAGIC_V1,
    MAGIC_V2,
    Encoder,
    Frame,
    FrameSplitter,
    Piece,
    message_id,
    message_name,
    plain_frame,
    whole_frame,
)
from groundstation.mavlink.station import Outgoing
from groundstation.records.log_file import Settling, Sink, opened
from groundstation.records.notes import (
    FORMAT_VERSION,
    NOISE_BYTES,
    NOISE_SUBJECT,
    OWN_SUBJECT,
    REFUSED_SUBJECT,
    Event,
    Kind,
    Noise,
    Operator,
    Origin,
    Received,
    Record,
    Refused,
    Roles,
    Sent,
    pack_header,
    pack_link,
    pack_origin,
    pack_roles,
    pack_text,
    pack_tick,
    unpack_header,
    unpack_link,
    unpack_origin,
    unpack_roles,
    unpack_tick,
)
from groundstation.records.other_kinds import BEGINNING_BYTES, refuse_other_kinds
from groundstation.records.spans import LATEST_UNIX_US, NEAR_US, Cutter, Span, plain_stretch
from groundstation.records.survey import Survey

GROUND_SYSID = 255
GROUND_COMPID = 190

_STAMP = struct.Struct(">Q")
_SETUP_SIGNING = 256
_FLUSH_NS = 1_000_000_000
_FLUSH_BYTES = 1 << 16
_SMALLEST = 20  # bytes of a record whose frame has no payload
_MAGIC = re.compile(b"[\xfd\xfe]")
_SIGNING_HEADER = re.compile(rb"\xfd.{6}\x00\x01\x00", re.DOTALL)
_SIGNING_BYTES = 10 + 42 + 2 + 13  # header, payload with the key, checksum, signature
_SECRETS_MAX = 256
_LOG_MAX = 4 << 30  # bytes; a hundred vehicles write as much in an hour and more
_MAPPED_MIN = 64 << 20  # bytes
_CAREFUL = 256  # records in one go, before columns are tried again
_JOINED_MAX = 1 << 20  # bytes of one note; a datagram has 65,535 at most


class TlogWriter:
    """Records one flight.

    Attributes:
        problem: None while everything is recorded; after a write failed, one sentence. Nothing is recorded then.

    Args:
        target: file to create (replaced when it exists), or an open binary file, which ``close`` closes. See
            ``recording`` for logs with a manifest.
        epoch_unix_us: unix time of t = 0, microseconds. Times given to the methods are monotonic ns; microseconds
            are kept, what is below is cut off.
        sysid: system id of the ground station; frames of this sender are told apart by direction.
        compid: its component id.
        by_link: vehicles of one system id are on several links: the link of every frame is told, in both directions.

    Raises:
        UserError: the file cannot be created.
    """

    def __init__(
        self,
        target: Path | Sink,
        epoch_unix_us: int,
        *,
        by_link: bool = False,
        sysid: int = GROUND_SYSID,
        compid: int = GROUND_COMPID,
    ) -> None:
        self._file = opened(target) if isinstance(target, Path) else target
        self._name = str(getattr(self._file, "path", "log"))
        self._epoch_unix_us = epoch_unix_us
        self._sender = (sysid, compid)
        self._notes = Encoder(sysid, compid)
        self._secrets: dict[tuple[int, str], tuple[bytes, int]] = {}
        self._by_link = by_link
        self._link: int | None = None
        self._origins: dict[tuple[int, int], tuple[int, str]] = {}
        self._origins_seen: tuple[object, int] = (None, 0)
        self._origins_table: IntArray = np.full((1, 256), -1, dtype=np.int64)
        self._ours: BoolArray = np.zeros((256, 256), dtype=np.bool_)
        self._ours[compid, sysid] = True
        self._buffer = bytearray()
        self._origins_made = 0
        self._flushed_ns: int | None = None
        self._closed = False
        self.problem: str | None = None
        if self._name != "log":  # a log that is cut off at once is a log all the same
            self._begin(0)
            self._flush()

    def __enter__(self) -> TlogWriter:
        """Returns itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes the log."""
        self.close()

    def received(self, link: int, peer: str, data: bytes, t_ns: int) -> None:
        """Records what arrived, raw: one datagram.

        Args:
            link: index of the link, 0 to 65535.
            peer: the sender's address, as the link tells it.
            data: the bytes; frames are kept whole, all others as noise.
            t_ns: arrival, monotonic, ns.
        """
        self.took(link, peer, FrameSplitter().feed(data), t_ns)

    def took(self, link: int, peer: str, pieces: Sequence[Piece], t_ns: int) -> None:
        """The same for what was split before: by whoever read the link, once for all who want to know."""
        if self.problem is not None:
            return
        for piece in pieces:
            if not isinstance(piece, Frame):
                self._noise(link, peer, piece, t_ns)
            elif piece.msgid != _SETUP_SIGNING:
                # A frame that bears our own id counts as sent unless an ORIGIN stands right before it.
                ours = (piece.sysid, piece.compid) == self._sender
                subject = OWN_SUBJECT if ours else piece.sysid
                self._on_link(link, t_ns)
                if ours or self._origins.get(self._source_key(subject, link)) != (link, peer):
                    self._origin(subject, link, peer, t_ns)
                self._write(piece.raw, t_ns)

    def took_block(self, block: Block) -> None:
        """The same for many datagrams, as one piece as long as nothing in them needs a note."""
        if self.problem is not None or self._closed:
            return
        links = block.datagrams.link[block.datagram]
        origin = self._origin_sources(block)[links if self._by_link else 0, block.sysid]
        usual = not block.noise and bool((origin == block.datagrams.source[block.datagram]).all())
        if not usual or bool(((block.msgid == _SETUP_SIGNING) | self._ours[block.compid, block.sysid]).any()):
            for link, peer, pieces, t_ns in block.pieces():
                self.took(link, peer, pieces, t_ns)
            return
        count = len(block)
        if not count:
            return
        times_ns = block.datagrams.t_rx_ns
        if self._flushed_ns is None:
            self._begin(int(times_ns[0]))
        stamps = self._epoch_unix_us + times_ns[block.datagram] // 1000
        records = np.empty(block.size + _STAMP.size * count, dtype=np.uint8)
        at = (block.start + _STAMP.size * np.arange(count))[:, None] + np.arange(_STAMP.size)
        frames = np.ones(len(records), dtype=np.bool_)
        frames[at] = False
        records[frames] = np.frombuffer(block.data, dtype=np.uint8, count=block.size)
        records[at] = stamps.astype(">i8").view(np.uint8).reshape(count, _STAMP.size)
        if self._by_link:
            self._add_by_link(records.tobytes(), links, at[:, 0], times_ns[block.datagram])
        else:
            self._buffer += records.tobytes()
        self._flush_when_due(int(times_ns[-1]))

    def _add_by_link(self, records: bytes, links: IntArray, at: IntArray, times_ns: IntArray) -> None:
        """Adds the records of a block, shape (k,), with a LINK note wherever the link changes."""
        starts = [0, *(np.flatnonzero(np.diff(links)) + 1).tolist()]
        bounds = [*at[starts].tolist(), len(records)]
        for k, first in enumerate(starts):
            self._on_link(int(links[first]), int(times_ns[first]))
            self._buffer += records[bounds[k] : bounds[k + 1]]

    def _origin_sources(self, block: Block) -> IntArray:
        """Which of a block's sources frames of each link and system id are known to come from, -1 for none.

        Shape (links, 256); one row for all where links do not count.
        """
        sources = block.datagrams.sources
        if self._origins_seen[0] is not sources or self._origins_seen[1] != self._origins_made:
            number = {source: k for k, source in enumerate(sources)}
            self._origins_seen = (sources, self._origins_made)
            rows = 1 + max((link for link, _ in sources), default=0) if self._by_link else 1
            self._origins_table = np.full((rows, 256), -1, dtype=np.int64)
            for (row, subject), source in self._origins.items():
                if subject < 256 and max(row, 0) < rows:
                    self._origins_table[max(row, 0), subject] = number.get(source, -1)
        return self._origins_table

    def _source_key(self, subject: int, link: int) -> tuple[int, int]:
        """For what an ORIGIN note counts: a system id, and its link where ids stand on several."""
        return link if self._by_link and subject < 256 else -1, subject

    def _on_link(self, link: int, t_ns: int) -> None:
        if self._by_link and link != self._link:
            self._link = link
            self._note(Kind.LINK, pack_link(link), t_ns)

    def refused(self, link: int, peer: str, frame: Frame, why: int, t_ns: int) -> None:
        """Records a frame that arrived and was not let in; see ``notes.Refused``."""
        if frame.msgid == _SETUP_SIGNING:
            return
        if self._origins.get((-1, REFUSED_SUBJECT)) != (link, peer):
            self._origin(REFUSED_SUBJECT, link, peer, t_ns)
        self._note_pieces(Kind.REFUSED, pack_text(bytes((why,)) + frame.raw), t_ns)

    def sent(self, frame: bytes, t_ns: int) -> None:
        """Records one frame that went out."""
        self.sent_all([frame], t_ns)

    def sent_datagrams(self, datagrams: Sequence[Outgoing], t_ns: int) -> None:
        """Records all that went out at one time."""
        if not self._by_link:
            self.sent_all([frame for datagram in datagrams for frame in datagram.frames], t_ns)
            return
        for link, together in itertools.groupby(datagrams, key=attrgetter("link")):
            self._on_link(link, t_ns)
            self.sent_all([frame for datagram in together for frame in datagram.frames], t_ns)

    def sent_all(self, frames: Sequence[bytes], t_ns: int) -> None:
        """Records frames that went out at one time."""
        shown = [frame for frame in frames if not _SIGNING_HEADER.match(frame)]
        if shown:
            self._write(self._stamp(t_ns).join(shown), t_ns)

    def tick(self, t_ns: int, number: int) -> None:
        """Records the time and the number of a step of the mission object, before the step."""
        self._note(Kind.TICK, pack_tick(t_ns, number), t_ns)

    def operator(self, text: str, t_ns: int) -> None:
        """Records a command of the operator."""
        self._note_pieces(Kind.OPERATOR, pack_text(text.encode("utf-8", "backslashreplace")), t_ns)

    def event(self, text: str, t_ns: int) -> None:
        """Records something for people and the report; ``"phase: NAME"`` begins a phase."""
        self._note_pieces(Kind.EVENT, pack_text(text.encode("utf-8", "backslashreplace")), t_ns)

    def roles(self, roles: Sequence[int | None], t_ns: int) -> None:
        """Records the role of each vehicle, in the order of the mission, counted from 0, None for none."""
        self._note_pieces(Kind.ROLES, pack_roles(roles), t_ns)

    def flush(self) -> None:
        """Writes what is held back, without waiting for the next second; ``problem`` tells whether that went well."""
        if self._flushed_ns is None:
            return
        self._flush()
        if self.problem is None and isinstance(self._file, Settling):
            try:
                self._file.settle()
            except OSError as error:
                self._fail(error)

    def close(self) -> None:
        """Writes what is left and closes the file; a second call does nothing."""
        if self._closed:
            return
        if self._flushed_ns is None:
            self._begin(0)
        self._flush()
        self._closed = True
        try:
            self._file.close()
        except OSError as error:
            self._fail(error)

    def _noise(self, link: int, peer: str, data: bytes, t_ns: int) -> None:
        if self._origins.get((-1, NOISE_SUBJECT)) != (link, peer):
            self._origin(NOISE_SUBJECT, link, peer, t_ns)
        self._note_pieces(Kind.NOISE, pack_text(self._without_keys((link, peer), data), NOISE_BYTES), t_ns)

    def _without_keys(self, source: tuple[int, str], data: bytes) -> bytes:
        """Zeroes what may be the rest of a damaged SETUP_SIGNING, which still shows the key; also in pieces."""
        tail, owed = self._secrets.pop(source, (b"", 0))
        joined = tail + data
        shown = bytes(min(owed, len(data))) + data[owed:]
        owed = max(owed - len(data), 0)
        header = _SIGNING_HEADER.search(joined)
        if header is not None:
            start = max(header.start() - len(tail), 0)
            shown = shown[:start] + bytes(len(data) - start)
            owed = max(owed, _SIGNING_BYTES - (len(joined) - header.start()), 0)
        if owed or 0xFD in joined[-9:]:
            if len(self._secrets) >= _SECRETS_MAX:
                del self._secrets[next(iter(self._secrets))]
            self._secrets[source] = (joined[-9:], owed)
        return shown

    def _origin(self, subject: int, link: int, peer: str, t_ns: int) -> None:
        self._origins[self._source_key(subject, link)] = (link, peer)
        self._origins_made += 1
        self._note_pieces(Kind.ORIGIN, pack_origin(Origin(subject, link, peer)), t_ns)

    def _note_pieces(self, kind: Kind, pieces: Iterator[bytes], t_ns: int) -> None:
        for piece in pieces:
            self._note(kind, piece, t_ns)

    def _note(self, kind: Kind, payload: bytes, t_ns: int) -> None:
        frame = self._notes.encode("TUNNEL", payload_type=int(kind), payload_length=len(payload), payload=payload)
        self._write(frame, t_ns)

    def _begin(self, t_ns: int) -> None:
        self._flushed_ns = t_ns
        self._note(Kind.HEADER, pack_header(self._epoch_unix_us), t_ns)

    def _write(self, frame: bytes, t_ns: int) -> None:
        if self.problem is not None or self._closed:
            return
        if self._flushed_ns is None:
            self._begin(t_ns)
        self._buffer += self._stamp(t_ns) + frame
        self._flush_when_due(t_ns)

    def _stamp(self, t_ns: int) -> bytes:
        return _STAMP.pack(self._epoch_unix_us + t_ns // 1000)

    def _flush_when_due(self, t_ns: int) -> None:
        if t_ns - (self._flushed_ns or 0) >= _FLUSH_NS or len(self._buffer) >= _FLUSH_BYTES:
            self._flushed_ns = t_ns
            self._flush()

    def _flush(self) -> None:
        if self.problem is not None:
            return
        try:
            view = memoryview(self._buffer).toreadonly()
            while view:
                taken = self._file.write(bytes(view))
                view = view[len(view) if taken is None else taken :]
            self._file.flush()
        except OSError as error:
            self._fail(error)
        self._buffer = bytearray()

    def _fail(self, error: OSError) -> None:
        reason = error.strerror or str(error)
        self.problem = f"{self._name}: recording stopped: {reason}"


class TlogReader:
    """Gives the records of one log in the order of the file; may be iterated again.

    Attributes:
        epoch_unix_us: unix time of t = 0, microseconds: as the log says; the first time stamp in foreign logs.
        native: whether this project wrote the log, so that directions, ticks and notes are known.
        damaged_bytes: bytes amid the log that were no record and were skipped, as of the latest iteration.
        truncated_bytes: bytes at the end that are no whole record, as of the latest iteration.
    """

    def __init__(self, data: bytes | mmap, name: str = "log", epoch_unix_us: int | None = None) -> None:
        """Finds the first record.

        Args:
            data: the whole file, read or mapped.
            name: for messages.
            epoch_unix_us: unix time of t = 0 where the log itself does not say.

        Raises:
            UserError: there is no record in it, or it has a later format.
        """
        self._data = data
        self._name = name
        self._survey: Survey | None = None
        self.damaged_bytes = 0
        self.truncated_bytes = 0
        if not data:
            raise UserError(f"{name}: the file is empty, expected a log (.tlog)")
        refuse_other_kinds(data[:BEGINNING_BYTES], name)
        first = next(self._frames(), None)
        if first is None:
            raise UserError(
                f"{name}: no MAVLink frame in {len(data)} bytes, expected a log (.tlog): "
                "8 bytes of time stamp before each frame"
            )
        stamp_us, frame = first
        self._sender = (GROUND_SYSID, GROUND_COMPID)
        self.native = data.find(bytes((*self._sender, 0x81, 0x01, 0x00))) >= 0  # id 385 behind the sender's ids
        self.epoch_unix_us = stamp_us if epoch_unix_us is None else epoch_unix_us
        note = _note_in(frame)
        if note is not None and note[0] == Kind.HEADER and len(note[1]) >= 10:
            version, epoch = unpack_header(note[1])
            if version > FORMAT_VERSION:
                raise UserError(
                    f"{name}: log format {version}, this program reads up to {FORMAT_VERSION}; "
                    "read it with the version that its manifest names"
                )
            self.native = True
            self._sender = (frame.sysid, frame.compid)
            if 0 <= epoch <= LATEST_UNIX_US:  # else damage that no checksum saw
                self.epoch_unix_us = epoch

    def survey(self) -> Survey:
        """What is in the log, and whether its stamps hold; looked through at the first call."""
        if self._survey is None:
            self._survey = Survey(self._frames())
        return self._survey

    @property
    def notes(self) -> list[str]:
        """What people have to know of the time stamps; nothing in logs of this project, whose clock is never set."""
        return [] if self.native else self.survey().notes

    @property
    def message(self) -> str | None:
        """What the latest iteration had to leave out, as one sentence; None when it gave everything."""
        parts = []
        if self.damaged_bytes:
            parts.append(f"{self.damaged_bytes} bytes amid the log were no record and were skipped")
        if self.truncated_bytes:
            parts.append(f"the last {self.truncated_bytes} bytes are no whole record and were left out")
        if self._survey is not None and not self.native and self._survey.cut is not None:
            parts.append("its time stamps run back, and what is behind was left out")
        return f"{self._name}: {'; '.join(parts)}" if parts else None

    def __iter__(self) -> Iterator[Record]:
        """Gives record by record; resets what was left out."""
        return self._native_records() if self.native else self._foreign_records()

    def spans(self) -> Iterator[Record | Span]:
        """The same with stretches of frames as columns; in logs of other programs record by record.

        Between two records that come by themselves what was received is in order, and what was sent.
        """
        if not self.native:
            yield from self
            return
        assembler = _Assembler()
        cutter = Cutter(assembler, self._sender)
        self.damaged_bytes = self.truncated_bytes = 0
        position, last_us = 0, None
        while position < len(self._data):
            stretch = plain_stretch(self._data, position, last_us, self.epoch_unix_us)
            if stretch is not None:
                position, last_us = stretch.stop, stretch.last_us
                yield from cutter.cut(stretch)
                continue
            careful = list(itertools.islice(self._frames_from(position, last_us), _CAREFUL))
            last_us, _, position = careful[-1] if careful else (last_us, None, len(self._data))
            for stamp_us, frame, _ in careful:
                record = self._record(assembler, stamp_us, frame)
                if record is not None:
                    yield record

    def _foreign_records(self) -> Iterator[Record]:
        """Everything is received but what a ground station sent; stamps are put right where its clock was set."""
        survey = self.survey()
        shifted = zip(self._frames(), survey.shifts_us(), strict=False)
        for (stamp_us, frame), shift_us in itertools.islice(shifted, survey.cut):
            if frame.msgid == _SETUP_SIGNING:  # other programs may have written it: it is not handed on
                continue
            t_ns = (stamp_us - shift_us - self.epoch_unix_us) * 1000
            yield Sent(t_ns, frame) if survey.sent_by_ground(frame) else Received(t_ns, 0, "", frame)

    def _native_records(self) -> Iterator[Record]:
        assembler = _Assembler()
        for stamp_us, frame in self._frames():
            record = self._record(assembler, stamp_us, frame)
            if record is not None:
                yield record

    def _record(self, assembler: _Assembler, stamp_us: int, frame: Frame) -> Record | None:
        """What a frame of a log of ours stands for; None for notes that are none by themselves."""
        t_ns = (stamp_us - self.epoch_unix_us) * 1000
        if (frame.sysid, frame.compid) != self._sender:
            return Received(t_ns, *assembler.origin_of(frame.sysid), frame)
        if assembler.next_is_received:
            assembler.next_is_received = False
            return Received(t_ns, *assembler.origin_of(OWN_SUBJECT), frame)
        note = _note_in(frame)
        return Sent(t_ns, frame, assembler.link) if note is None else assembler.take(t_ns, *note)

    def _frames(self) -> Iterator[tuple[int, Frame]]:
        """Gives (unix microseconds, frame) of each whole record."""
        self.damaged_bytes = self.truncated_bytes = 0
        for stamp_us, frame, _ in self._frames_from(0, None):
            yield stamp_us, frame

    def _frames_from(self, position: int, last_us: int | None) -> Iterator[tuple[int, Frame, int]]:
        """Gives (unix microseconds, frame, where the next record begins) of each whole record from a place on."""
        data, end = self._data, len(self._data)
        while position < end:
            start = position
            # One record behind the other, with nothing strange about it: so they come by the hundred thousand.
            if start + _SMALLEST <= end:
                frame = plain_frame(data[start + 8 : start + _SMALLEST + data[start + 9]])
                stamp_us = _stamp_at(data, start)
                near = last_us is None or abs(stamp_us - last_us) <= NEAR_US
                if frame is not None and near and stamp_us <= LATEST_UNIX_US:
                    position, last_us = start + 8 + len(frame.raw), stamp_us
                    yield stamp_us, frame, position
                    continue
            found = self._record_at(start, last_us)
            while found is None:
                magic = _MAGIC.search(data, start + 9)
                if magic is None:
                    self.truncated_bytes = end - position
                    return
                start = magic.start() - 8
                found = self._record_at(start, last_us)
            self.damaged_bytes += start - position
            last_us, frame = found
            position = start + 8 + len(frame.raw)
            yield last_us, frame, position

    def _record_at(self, start: int, last_us: int | None) -> tuple[int, Frame] | None:
        """Reads the record at ``start``; None when there is none that can be believed.

        The frame has a checksum, its time stamp has not: it must be near that of the record before or after. A frame
        with an id that the dialect does not know cannot be checked, so that a record (or the end) must follow it.
        """
        data = self._data
        if start + 8 + 8 > len(data):
            return None
        magic = data[start + 8]
        if magic == MAGIC_V2:
            size = 12 + data[start + 9] + (13 if data[start + 10] & 1 else 0)
        elif magic == MAGIC_V1:
            size = 8 + data[start + 9]
        else:
            return None
        stamp_us = _stamp_at(data, start)
        stop = start + 8 + size
        if stop > len(data) or stamp_us > LATEST_UNIX_US:
            return None
        frame = whole_frame(data[start + 8 : stop])
        if frame is None:
            return None
        known = message_name(frame.msgid) is not None
        near = last_us is None or abs(stamp_us - last_us) <= NEAR_US
        if near and (known or len(data) - stop < 9):
            return stamp_us, frame
        if len(data) - stop < 9 or data[stop + 8] not in (MAGIC_V1, MAGIC_V2):
            return None
        next_us = _stamp_at(data, stop)
        follows = abs(next_us - stamp_us) <= NEAR_US or (near and next_us <= LATEST_UNIX_US)
        return (stamp_us, frame) if follows else None


class _Assembler:
    """Turns notes into records, joining those that needed several frames, and remembers where frames came from.

    Attributes:
        link: of the frames that follow, where the log tells it.
        origins: (link, peer) by link, None where it does not count, and subject.
        next_is_received: an ORIGIN of OWN_SUBJECT stood last: the next frame with our own ids was received.
    """

    def __init__(self) -> None:
        self._parts: dict[int, bytearray] = {}
        self._roles: list[int | None] = []
        self.origins: dict[tuple[int | None, int], tuple[int, str]] = {}
        self.link: int | None = None
        self.next_is_received = False

    def origin_of(self, subject: int) -> tuple[int, str]:
        """Link and peer that frames of a system id, or of another subject of ORIGIN notes, come from."""
        known = self.origins.get((self.link if subject < NOISE_SUBJECT else None, subject))
        return known or (self.link or 0, "")

    def take(self, t_ns: int, kind: int, payload: bytes) -> Record | None:
        """Takes one note; returns the record that it completes, if any. Kinds of later formats are passed over."""
        with contextlib.suppress(ValueError):  # a note cut short by damage that no checksum saw
            if kind == Kind.TICK:
                return unpack_tick(payload)
            if kind == Kind.ROLES:
                return self._take_roles(t_ns, payload)
            if kind == Kind.LINK:
                self.link = unpack_link(payload)
                return None
            if kind in _IN_PARTS and payload:
                text = self._parts.pop(kind, bytearray())
                text += payload[1:]
                if len(text) > _JOINED_MAX:
                    return None  # nobody writes as much: damage, or somebody who means to fill the memory
                if payload[0]:
                    self._parts[kind] = text
                    return None
                return _IN_PARTS[Kind(kind)](self, t_ns, bytes(text))
        return None

    def _take_roles(self, t_ns: int, payload: bytes) -> Record | None:
        first, count, roles = unpack_roles(payload)
        if first == 0:
            self._roles = []
        if first == len(self._roles):
            self._roles += roles
        return Roles(t_ns, tuple(self._roles)) if len(self._roles) == count else None

    def _take_origin(self, _t_ns: int, joined: bytes) -> None:
        origin = unpack_origin(joined)
        told = self.link is not None and origin.subject < NOISE_SUBJECT
        self.origins[origin.link if told else None, origin.subject] = (origin.link, origin.peer)
        self.next_is_received = origin.subject == OWN_SUBJECT

    def _take_noise(self, t_ns: int, data: bytes) -> Record:
        return Noise(t_ns, *self.origin_of(NOISE_SUBJECT), data)

    def _take_refused(self, t_ns: int, joined: bytes) -> Record | None:
        return Refused(t_ns, *self.origin_of(REFUSED_SUBJECT), joined[0], joined[1:]) if joined else None

    def _take_operator(self, t_ns: int, text: bytes) -> Record:
        return Operator(t_ns, text.decode(errors="replace"))

    def _take_event(self, t_ns: int, text: bytes) -> Record:
        return Event(t_ns, text.decode(errors="replace"))


_IN_PARTS: dict[int, Callable[[_Assembler, int, bytes], Record | None]] = {
    Kind.ORIGIN: _Assembler._take_origin,
    Kind.NOISE: _Assembler._take_noise,
    Kind.OPERATOR: _Assembler._take_operator,
    Kind.EVENT: _Assembler._take_event,
    Kind.REFUSED: _Assembler._take_refused,
}


def read_tlog(path: Path, epoch_unix_us: int | None = None) -> TlogReader:
    """Opens a log of this or another program (QGroundControl, MAVProxy; MAVLink 1 and 2).

    Args:
        path: the .tlog file.
        epoch_unix_us: unix time of t = 0 where the log itself does not say.

    Raises:
        UserError: no such file, not readable, empty, or not a log.
    """
    try:
        require_regular(path, _LOG_MAX, "a log")
        data = _content(path)
    except FileNotFoundError as error:
        raise UserError(f"{path}: no such log; give the .tlog file that a flight or an import wrote") from error
    except OSError as error:
        raise UserError(f"{path}: cannot read the log: {error.strerror or error}") from error
    return TlogReader(data, os.fspath(path), epoch_unix_us)


def _content(path: Path) -> bytes | mmap:
    """The whole file; a large one is mapped, so that only what is being read is in memory."""
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size < _MAPPED_MIN:
            return file.read()
        return mmap(file.fileno(), 0, access=ACCESS_READ)


def _note_in(frame: Frame) -> tuple[int, bytes] | None:
    """Payload type and payload of a log-only TUNNEL frame, None for any other."""
    if frame.msgid != _TUNNEL_ID:
        return None
    whole = frame.payload.ljust(5, b"\0")
    kind = whole[0] | whole[1] << 8
    length = whole[4]
    if not Kind.HEADER <= kind <= 0x9FFF:
        return None
    return kind, whole[5 : 5 + length].ljust(length, b"\0")


def _stamp_at(data: bytes | mmap, start: int) -> int:
    return int(_STAMP.unpack_from(data, start)[0])


_TUNNEL_ID = message_id("TUNNEL")
