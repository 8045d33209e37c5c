"""The splitter's work for every byte has a bound, whatever the bytes are, and pymavlink finds no frame that we miss.

Work is counted from outside, so that any way of splitting can be judged: lines of Python that run in the splitter's
module, and bytes that go through the checksum.
"""

from __future__ import annotations

import inspect
import sys
from itertools import pairwise
from types import FrameType
from typing import Any, NamedTuple

import pytest
from hypothesis import given, settings, target
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, message_name

LINES_PER_BYTE = 30  # seen: 19
CHECKED_PER_BYTE = 2 * 266
GOOD = Encoder(4).encode("HEARTBEAT", type=2, autopilot=12, system_status=3, mavlink_version=3)
GOOD_V1 = Encoder(5, version=1).encode("HEARTBEAT", type=2, autopilot=12, system_status=3, mavlink_version=3)
UNKNOWN_V1 = next(number for number in range(256) if message_name(number) is None)


class Work(NamedTuple):
    """What splitting took, for each byte that was put in."""

    lines: float
    checked: float


class _Counter:
    """Stands in for the checksum, and traces the splitter's module."""

    def __init__(self) -> None:
        self.lines = self.checked = 0
        self._module = sys.modules[FrameSplitter.__module__]
        self._file = inspect.getfile(FrameSplitter)
        self._checksum: Any = vars(self._module)["crc16"]

    def mcrf4xx(self, data: bytes) -> int:
        self.checked += len(data)
        return int(self._checksum.mcrf4xx(data))

    def trace(self, frame: FrameType, event: str, _: object) -> Any:
        if frame.f_code.co_filename != self._file:
            return None
        self.lines += event == "line"
        return self.trace

    def feed(self, splitter: FrameSplitter, parts: list[bytes]) -> Work:
        before = sys.gettrace()
        vars(self._module)["crc16"] = self
        sys.settrace(self.trace)
        try:
            for part in parts:
                splitter.feed(part)
        finally:
            sys.settrace(before)
            vars(self._module)["crc16"] = self._checksum
        size = sum(map(len, parts))
        return Work(self.lines / size, self.checked / size)


def work(data: bytes, cuts: list[int] | None = None) -> Work:
    """Counts the work for one datagram, or for a stream in pieces."""
    if cuts is None:
        return _Counter().feed(FrameSplitter(), [data])
    ends = sorted({0, len(data), *(cut for cut in cuts if cut < len(data))})
    return _Counter().feed(FrameSplitter(datagrams=False), [data[start:stop] for start, stop in pairwise(ends)])


UNKNOWN = bytes((0xFE, 254, 0xFE, 0xFE, 0xFE, UNKNOWN_V1))  # with a header of DEBUG (254) inside
WINDOWS = UNKNOWN * 39 + GOOD  # each of them is tested up to the good frame at the end


@pytest.mark.parametrize("size", [1_400, 20_000])
@pytest.mark.parametrize(
    "unit",
    [
        WINDOWS,
        UNKNOWN,
        bytes((0xFE,)),
        bytes((0xFD,)),
        bytes((0xFE, 255, 0xFE, 255, 0xFE, 0)),
        bytes((0xFD, 255, 0, 0, 0xFE, 1, 1, 0, 0, 0)),
        bytes((0xFD, 255, 1, 0, 0, 1, 1, 0xFF, 0xFF, 0xFF)),
    ],
    ids=["windows", "unknown", "fe", "fd", "known", "known v2", "unknown v2"],
)
def test_hostile_bytes_take_no_more_work_than_the_bound(unit: bytes, size: int) -> None:
    data = (unit * (size // len(unit) + 1))[:size]
    for calls, done in ((0.0, work(data)), (1 / 7, work(data, list(range(0, size, 7))))):
        assert done.lines <= LINES_PER_BYTE * (1.0 + calls)
        assert done.checked <= CHECKED_PER_BYTE


def _bits() -> st.SearchStrategy[bytes]:
    length = st.sampled_from([0, 1, 9, 30, 200, 254, 255]) | st.integers(0, 255)
    low = st.sampled_from([0, 30, 254, UNKNOWN_V1, 0xFD, 0xFE])
    magic = st.sampled_from([0xFD, 0xFE])
    return st.one_of(
        st.builds(lambda n, a, b, m: bytes((0xFE, n, a, b, 1, m)), length, magic, magic, low),
        st.builds(
            lambda n, f, a, m, h: bytes((0xFD, n, f, 0, a, 1, 1, m, 0, h)),
            length, st.sampled_from([0, 0, 1, 2]), magic, low, st.sampled_from([0, 255]),
        ),
        st.sampled_from([GOOD, GOOD_V1, GOOD[:7], GOOD[-5:]]),
        st.builds(lambda m, n: bytes((m,)) * n, magic, st.integers(1, 12)),
        st.binary(max_size=6),
    )  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(
    unit=st.lists(_bits(), min_size=1, max_size=30).map(b"".join).filter(bool), piece=st.none() | st.integers(1, 400)
)
def test_no_bytes_are_found_that_take_more_work(unit: bytes, piece: int | None) -> None:
    size = 1_400
    data = (unit * (size // len(unit) + 1))[:size]
    # Each call takes a little by itself: what is bounded is work for each byte and each call.
    calls = 0.0 if piece is None else 1.0 / piece
    done = work(data, None if piece is None else list(range(0, size, piece)))
    target(done.lines, label="lines for each byte")
    target(done.checked, label="bytes through the checksum for each byte")
    assert done.lines <= LINES_PER_BYTE * (1.0 + calls)
    assert done.checked <= CHECKED_PER_BYTE


@settings(deadline=None)
@given(st.lists(_bits(), max_size=20).map(b"".join), st.integers(1, 40))
def test_a_stream_in_other_pieces_gives_the_same_frames(data: bytes, piece: int) -> None:
    data += bytes(600)  # a stream waits for the end of what may be a frame
    whole, cut = FrameSplitter(datagrams=False), FrameSplitter(datagrams=False)
    pieces = [item for start in range(0, len(data), piece) for item in cut.feed(data[start : start + piece])]
    at_once = whole.feed(data)
    raws = [item.raw if isinstance(item, Frame) else item for item in pieces]
    assert b"".join(raws) + cut._held == data
    good = [item.raw for item in pieces if isinstance(item, Frame) and message_name(item.msgid) is not None]
    assert good == [item.raw for item in at_once if isinstance(item, Frame) and message_name(item.msgid) is not None]


_SENT = [GOOD, GOOD_V1, Encoder(9).encode("LOCAL_POSITION_NED", time_boot_ms=7, x=1.0, vz=-2.0)]


@settings(deadline=None)
@given(st.lists(st.sampled_from(_SENT) | _bits() | st.binary(max_size=40), max_size=12))
def test_what_pymavlink_finds_amid_garbage_we_find_too(parts: list[bytes]) -> None:
    """pymavlink skips what it takes for the length of a bad frame, so that we may find more than it does."""
    data = b"".join(parts)
    reader = dialect.MAVLink(None)
    reader.robust_parsing = True
    read = reader.parse_buffer(data) or []
    theirs = [bytes(item.get_msgbuf()) for item in read if not item.get_type().startswith(("BAD_DATA", "UNKNOWN_"))]
    ours = [item.raw for item in FrameSplitter().feed(data) if isinstance(item, Frame)]
    for raw in theirs:
        if raw not in ours:  # hidden by another good frame that begins before it
            start = data.index(raw)
            covered = [data.index(item) for item in ours if data.index(item) < start < data.index(item) + len(item)]
            assert covered, raw.hex()
