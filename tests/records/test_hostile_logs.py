"""What a log costs to read has a bound for every byte, whatever is in it: work is counted, not time.

Lines of Python that run in the reader's modules, bytes that go through the checksum, and elements that numpy looks at.
"""

from __future__ import annotations

import inspect
import random
import sys
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from types import FrameType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, target
from hypothesis import strategies as st

from groundstation.core.errors import UserError
from groundstation.mavlink import splitting
from groundstation.mavlink.codec import Encoder, message_name
from groundstation.records import survey, tlog
from groundstation.records.tlog import TlogReader

LINES_PER_BYTE = 300  # seen: 193; each byte may begin a frame, in two passes of some hundred lines
CHECKED_PER_BYTE = 300
ELEMENTS_PER_RECORD = 400  # seen: 288
T0_US = 1_700_000_000_000_000
SECOND_US = 1_000_000
GOOD = Encoder(4).encode("HEARTBEAT", type=2, autopilot=12, system_status=3, mavlink_version=3)
UNKNOWN_V1 = next(number for number in range(256) if message_name(number) is None)


def _record(stamp_us: int, frame: bytes) -> bytes:
    return stamp_us.to_bytes(8, "big") + frame


class _Counter:
    """Counts lines of three modules, and bytes through the checksum."""

    def __init__(self) -> None:
        self.lines = self.checked = 0
        self._files = {inspect.getfile(module) for module in (tlog, survey, splitting)}
        self._checksum: Any = vars(splitting)["crc16"]

    def mcrf4xx(self, data: bytes) -> int:
        self.checked += len(data)
        return int(self._checksum.mcrf4xx(data))

    def _trace(self, frame: FrameType, event: str, _: object) -> Any:
        if frame.f_code.co_filename not in self._files:
            return None
        self.lines += event == "line"
        return self._trace

    def read(self, data: bytes) -> None:
        before = sys.gettrace()
        vars(splitting)["crc16"] = self
        sys.settrace(self._trace)
        try:
            with suppress(UserError):  # refused at once, where it looks like another kind of file
                for _ in TlogReader(data):
                    pass
        finally:
            sys.settrace(before)
            vars(splitting)["crc16"] = self._checksum


def _assert_bounded(data: bytes) -> float:
    """Returns the lines for each byte."""
    done = _Counter()
    done.read(data)
    assert done.lines <= LINES_PER_BYTE * len(data)
    assert done.checked <= CHECKED_PER_BYTE * len(data)
    return done.lines / len(data)


@pytest.mark.parametrize(
    "unit",
    [
        bytes((0xFE,)),
        bytes((0xFD,)),
        bytes((0xFE, 254, 0xFE, 0xFE, 0xFE, UNKNOWN_V1)),
        bytes((0xFE, 255, 0xFE, 255, 0xFE, 0)),
        bytes((0xFD, 255, 1, 0, 0, 1, 1, 0xFF, 0xFF, 0xFF)),
        _record(T0_US, bytes((0xFE, 200, 1, 1, 1, UNKNOWN_V1))),
        _record(T0_US, GOOD)[:-1],
    ],
    ids=["fe", "fd", "unknown", "known", "unknown v2", "stamped", "cut"],
)
def test_bytes_that_are_no_records_take_no_more_work_than_the_bound(unit: bytes) -> None:
    first = _record(T0_US, GOOD)
    _assert_bounded(first + (unit * (8_000 // len(unit) + 1))[:8_000] + first)


def _bits() -> st.SearchStrategy[bytes]:
    magic = st.sampled_from([0xFD, 0xFE])
    length = st.sampled_from([0, 1, 9, 200, 255])
    return st.one_of(
        st.builds(lambda n, a, m: bytes((0xFE, n, a, a, 1, m)), length, magic, st.sampled_from([0, 30, UNKNOWN_V1])),
        st.builds(lambda n, f, a: bytes((0xFD, n, f, 0, a, 1, 1, 0, 0, 0)), length, st.sampled_from([0, 1]), magic),
        st.sampled_from([GOOD, _record(T0_US, GOOD), _record(T0_US, b""), GOOD[:7]]),
        st.builds(lambda m, n: bytes((m,)) * n, magic, st.integers(1, 12)),
        st.binary(max_size=6),
    )


@settings(max_examples=25, deadline=None)
@given(st.lists(_bits(), min_size=1, max_size=20).map(b"".join).filter(bool))
def test_no_bytes_are_found_that_take_more_work(unit: bytes) -> None:
    lines = _assert_bounded(_record(T0_US, GOOD) + (unit * (3_000 // len(unit) + 1))[:3_000])
    target(lines, label="lines for each byte")


def _senders(number: int, _: random.Random) -> tuple[int, int, int, int]:
    return T0_US + 20_000 * number, 20 * number, 1 + number % 250, 1 + number // 250


def _there_and_back(number: int, _: random.Random) -> tuple[int, int, int, int]:
    return T0_US + 20_000 * number + number % 2 * 3_600 * SECOND_US, 20 * number, 1, 1


def _at_random(number: int, rng: random.Random) -> tuple[int, int, int, int]:
    return T0_US + rng.randrange(80_000 * SECOND_US), 20 * number, 1 + number % 3, 1


def _restarts(number: int, rng: random.Random) -> tuple[int, int, int, int]:
    return T0_US + 20_000 * number, rng.randrange(1 << 32), 1, 1


@pytest.mark.parametrize("story", [_senders, _there_and_back, _at_random, _restarts])
def test_good_records_that_make_no_sense_take_no_more_work_than_the_bound(
    story: Callable[[int, random.Random], tuple[int, int, int, int]],
) -> None:
    rng, records = random.Random(1), []
    for number in range(1_500):
        stamp_us, boot_ms, sysid, compid = story(number, rng)
        frame = Encoder(sysid, compid).encode("LOCAL_POSITION_NED", time_boot_ms=boot_ms, x=1.0)
        records.append(_record(stamp_us, frame))
    _assert_bounded(b"".join(records))


class _Counted(np.ndarray[Any, Any]):
    """Counts the elements that ufuncs are given."""

    elements = 0

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        plain = [item.view(np.ndarray) if isinstance(item, _Counted) else item for item in inputs]
        _Counted.elements += sum(np.size(item) for item in plain)
        result = getattr(ufunc, method)(*plain, **kwargs)
        return result.view(_Counted) if isinstance(result, np.ndarray) else result


def _counted(values: list[int]) -> Any:
    return np.array(values, dtype=np.int64).view(_Counted)


@pytest.mark.parametrize("kind", ["stamps at random", "all at one time", "there and back", "boot times at random"])
def test_where_stamps_come_apart_is_found_with_so_many_looks_at_each_record(kind: str) -> None:
    rng = random.Random(2)
    for count in (2_000, 16_000):
        boot = [20_000 * k for k in range(count)]
        stamp = [T0_US + 20_000 * k for k in range(count)]
        if kind == "stamps at random":
            stamp = [T0_US + rng.randrange(80_000 * SECOND_US) for _ in range(count)]
        elif kind == "all at one time":
            boot, stamp = [SECOND_US] * count, [T0_US + k % 2 * 3_600 * SECOND_US for k in range(count)]
        elif kind == "there and back":
            stamp = [at + k % 2 * 3_600 * SECOND_US for k, at in enumerate(stamp)]
        else:
            boot = [rng.randrange(900_000) + k for k in range(count)]
            stamp = [T0_US + 20_000 * k for k in range(count)]
        _Counted.elements = 0
        for _ in survey._steps_of(_counted(list(range(count))), _counted(stamp), _counted(boot)):
            pass
        assert _Counted.elements <= ELEMENTS_PER_RECORD * count


@settings(max_examples=60, deadline=None)
@given(
    moves=st.lists(
        st.tuples(st.integers(1, 9), st.sampled_from([0, 0, 0, 0, 1, -1, 7, -7, 100])), min_size=2, max_size=300
    )
)
def test_where_stamps_come_apart_is_what_looking_at_all_records_gives(
    moves: list[tuple[int, int]],
) -> None:
    boot, stamp, ahead_us = [0], [T0_US], 0
    for seconds, leap_s in moves:
        ahead_us += leap_s * SECOND_US
        boot.append(boot[-1] + seconds * SECOND_US)
        stamp.append(T0_US + boot[-1] + ahead_us)
    late = [at - own for at, own in zip(stamp, boot, strict=True)]
    expected = []
    for k, (one, other) in enumerate(pairwise(late)):
        if abs(other - one) <= SECOND_US // 2:
            continue
        before = min(late[j] for j in range(k + 1) if boot[j] >= boot[k] - 5 * SECOND_US)
        later = range(k + 1, len(late))
        behind = min(late[j] for j in later if boot[j] <= boot[k + 1] + 5 * SECOND_US)
        until = next((j for j in later if j > k + 1 and stamp[j] < stamp[j - 1] - SECOND_US // 2), len(late))
        stays = min(late[j] for j in range(k + 1, until) if boot[j] <= boot[k + 1] + 60 * SECOND_US)
        size = behind - before
        if (size > 0 and stays - before < size / 2) or abs(size) <= SECOND_US // 2 or (size > 0) != (other > one):
            continue
        expected.append((k, k + 1, size, boot[k + 1] - boot[k]))
    at = np.arange(len(boot))
    assert list(survey._steps_of(at, np.array(stamp), np.array(boot))) == expected


def test_stamps_that_leap_more_often_than_any_clock_is_set_are_of_no_clock() -> None:
    count, rng = 12_000, random.Random(3)
    stamps = np.array([T0_US + rng.randrange(80_000 * SECOND_US) for _ in range(count)])
    clocks = [(np.arange(start, count, 2), 20_000 * np.arange(start, count, 2)) for start in (0, 1)]
    assert survey._steps(stamps, clocks) == []
