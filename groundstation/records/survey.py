"""What is in a log, whoever wrote it: who sent which messages, who is a vehicle, and whether its time stamps hold.

Stamps of other programs' logs are those of a computer's clock, which may be set while it records; the vehicles' own
times since start-up tell. A step is what all vehicles tell that were heard before and after it and what stays: a link
that stalls and then delivers everything at once makes none.
"""

from __future__ import annotations

import itertools
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np

from groundstation.core.types import IntArray
from groundstation.mavlink.codec import Frame, layout, message_id, message_name
from groundstation.mavlink.dialect import dialect

Address = tuple[int, int]
"""System id and component id of a sender."""

_HEARTBEAT = message_id("HEARTBEAT")
_POSITIONS = frozenset({message_id("LOCAL_POSITION_NED"), message_id("GLOBAL_POSITION_INT")})
_TYPE_GCS, _AUTOPILOT_INVALID = dialect().number("MAV_TYPE_GCS"), dialect().number("MAV_AUTOPILOT_INVALID")
_GROUND_SYSID = 255  # the usual id of ground stations
_STEP_US = 500_000
_WINDOW_US = 5_000_000
_FOR_GOOD_US = 60_000_000  # no link is late for as long
_BACK_US = 1_000_000  # boot times that run back further belong to a new start
_PAUSE_US = 10_000_000
_SLOW_SHARE, _SLOW_LEAST_US = 0.5, 2_000_000  # of the time that passed for vehicles, at least
_STEPS_MAX = 4_000  # that vehicles tell of, together: no clock is set as often, and looking at all of them takes long
_BLOCK = 64
_NAMES_MAX = 12
_SENDERS_MAX = 40


class HeartbeatKind(NamedTuple):
    """What a heartbeat says its sender is: MAV_TYPE and MAV_AUTOPILOT."""

    mav_type: int
    mav_autopilot: int

    @property
    def is_ground_station(self) -> bool:
        """Whether it says so."""
        return self.mav_type == _TYPE_GCS

    @property
    def is_autopilot(self) -> bool:
        """Whether it is of the autopilot of a vehicle."""
        return not self.is_ground_station and self.mav_autopilot != _AUTOPILOT_INVALID


def heartbeat_kind(frame: Frame) -> HeartbeatKind | None:
    """What the sender of a heartbeat says that it is; None of any other message."""
    if frame.msgid != _HEARTBEAT:
        return None
    payload = frame.payload.ljust(6, b"\0")
    return HeartbeatKind(payload[4], payload[5])


class Step(NamedTuple):
    """A step of the clock that stamped a log.

    Attributes:
        record: number of the first one behind it.
        size_us: by how much the clock ran ahead from there on.
    """

    record: int
    size_us: int


@dataclass
class Sender:
    """One component of one system.

    Attributes:
        counts: frames by message id.
        kinds: what its heartbeats say.
    """

    counts: Counter[int] = field(default_factory=Counter)
    kinds: Counter[HeartbeatKind] = field(default_factory=Counter)

    @property
    def is_ground_station(self) -> bool:
        """Whether it ever said so."""
        return any(kind.is_ground_station for kind in self.kinds)

    @property
    def is_autopilot(self) -> bool:
        """Whether it ever said that it is the autopilot of a vehicle."""
        return any(kind.is_autopilot for kind in self.kinds)

    @property
    def words(self) -> str:
        """What it said that it is."""
        if self.is_ground_station:
            return "ground station"
        if not self.kinds:
            return "no heartbeat"
        (mav_type, autopilot), _ = self.kinds.most_common(1)[0]
        return f"{_enum('MAV_TYPE', mav_type)}, {_enum('MAV_AUTOPILOT', autopilot)}"


class Survey:
    """A log looked through once.

    Args:
        records: (unix microseconds, frame) in the order of the file.

    Attributes:
        senders: by (system id, component id).
        frames: number of frames.
        steps: of the clock, in order; to be taken off the stamps of all records behind each.
        cut: record from which on the stamps cannot be used: they run back, and nobody tells by how much. None mostly.
        notes: what people have to know of the stamps, a sentence each.
    """

    def __init__(self, records: Iterable[tuple[int, Frame]]) -> None:
        self.senders: dict[Address, Sender] = {}
        self.notes: list[str] = []
        stamps = array("q")
        boots: dict[Address, tuple[array[int], array[int]]] = {}
        for index, (stamp_us, frame) in enumerate(records):
            address = frame.sysid, frame.compid
            sender = self.senders.get(address)
            if sender is None:
                sender = self.senders[address] = Sender()
            sender.counts[frame.msgid] += 1
            stamps.append(stamp_us)
            kind = heartbeat_kind(frame)
            if kind is not None:
                sender.kinds[kind] += 1
            elif (place := _boot_at(frame.msgid)) is not None:
                boot_ms = int.from_bytes(frame.payload[place : place + 4], "little")
                if boot_ms:
                    boots.setdefault(address, (array("q"), array("q")))
                    boots[address][0].append(index)
                    boots[address][1].append(boot_ms * 1000)
        self.frames = len(stamps)
        self._stamps: IntArray = np.array(stamps, dtype=np.int64)
        vehicles = self.vehicle_senders
        clocks = [
            (np.array(at, dtype=np.int64), np.array(boot, dtype=np.int64))
            for address, (at, boot) in boots.items()
            if address in vehicles and len(at) > 1
        ]
        self.steps = _steps(self._stamps, clocks)
        self.cut = self._where_stamps_fail(clocks)

    @property
    def vehicle_senders(self) -> frozenset[Address]:
        """The autopilot of each system that is no ground station."""
        return frozenset(self.autopilots.items())

    @property
    def autopilots(self) -> dict[int, int]:
        """Component id of the autopilot by system id: the one that says so, else 1, else the one that tells positions.

        Systems of which nobody can be the autopilot are left out.
        """
        found: dict[int, int] = {}
        systems: dict[int, dict[int, Sender]] = {}
        for (sysid, compid), item in self.senders.items():
            systems.setdefault(sysid, {})[compid] = item
        for sysid, own in sorted(systems.items()):
            others = [compid for compid, item in sorted(own.items()) if not item.is_ground_station]
            told = [compid for compid in others if own[compid].is_autopilot]
            placed = [compid for compid in others if not own[compid].kinds and _POSITIONS & own[compid].counts.keys()]
            choice = told or placed
            if choice:
                found[sysid] = 1 if 1 in choice else choice[0]
        return found

    def sent_by_ground(self, frame: Frame) -> bool:
        """Whether a ground station sent a frame: one that ever said so, or one with the usual id."""
        sender = self.senders.get((frame.sysid, frame.compid))
        return frame.sysid == _GROUND_SYSID or (sender is not None and sender.is_ground_station)

    def placed(self, name: str) -> list[int]:
        """Systems whose autopilot sent messages of one type, for example LOCAL_POSITION_NED; ground stations never."""
        msgid = message_id(name)
        return [
            sysid
            for sysid, compid in self.autopilots.items()
            if sysid != _GROUND_SYSID and self.senders[sysid, compid].counts[msgid]
        ]

    def shifts_us(self) -> Iterator[int]:
        """By how much the clock ran ahead, record by record, without end."""
        shift = position = 0
        for step in self.steps:
            for _ in range(step.record - position):
                yield shift
            shift, position = shift + step.size_us, step.record
        while True:
            yield shift

    def words(self) -> list[str]:
        """What is in the log, a line for each sender."""
        lines = []
        for (sysid, compid), item in sorted(self.senders.items()):
            names = [f"{message_name(msgid) or f'id {msgid}'} {count}" for msgid, count in item.counts.most_common()]
            more = f" and {len(names) - _NAMES_MAX} other types" if len(names) > _NAMES_MAX else ""
            lines.append(f"system {sysid}, component {compid} ({item.words}): {', '.join(names[:_NAMES_MAX])}{more}")
        if len(lines) > _SENDERS_MAX:
            lines[_SENDERS_MAX:] = [f"and {len(lines) - _SENDERS_MAX} other senders"]
        return lines

    def values(self) -> list[dict[str, object]]:
        """The same as plain values."""
        return [
            {
                "system": sysid,
                "component": compid,
                "is": item.words,
                "messages": {message_name(k) or f"id {k}": count for k, count in item.counts.most_common()},
            }
            for (sysid, compid), item in sorted(self.senders.items())
        ]

    def _where_stamps_fail(self, clocks: Sequence[tuple[IntArray, IntArray]]) -> int | None:
        """Tells of steps, of leaps back that nobody explains and of leaps ahead that nobody can judge."""
        if not self.frames:
            return None
        shift = np.zeros(self.frames, dtype=np.int64)
        for step in self.steps:
            shift[step.record :] += step.size_us
        ours = self._stamps - shift
        for step in self.steps:
            since_s = (int(ours[step.record]) - int(ours[0])) / 1e6
            self.notes.append(
                f"the clock that stamped the log was set by {step.size_us / 1e6:+.2f} s after {since_s:.1f} s, as the"
                " vehicles' own times tell; times behind that are put right by them"
            )
        forward = np.maximum.accumulate(ours)
        back = np.flatnonzero(ours[1:] < forward[:-1] - _STEP_US)
        cut = int(back[0]) + 1 if len(back) else None
        if cut is not None:
            since_s, back_s = (int(forward[cut - 1]) - int(ours[0])) / 1e6, (int(forward[cut - 1] - ours[cut])) / 1e6
            self.notes.append(
                f"the time stamps run back by {back_s:.2f} s after {since_s:.1f} s and no vehicle's own time tells why;"
                f" the last {self.frames - cut} of {self.frames} frames are left out"
            )
        self._tell_slow_stamps(ours[:cut], clocks)
        known = np.zeros(self.frames, dtype=np.bool_)
        for at, boot in clocks:
            for k in np.flatnonzero(np.diff(boot) > _PAUSE_US - _STEP_US).tolist():
                known[at[k] + 1 : at[k + 1] + 1] = True  # a pause by the vehicle's time too
        gaps = np.flatnonzero((np.diff(ours[:cut]) > _PAUSE_US) & ~known[1:][: len(ours[:cut]) - 1])
        for gap in gaps[:3].tolist():
            since_s, long_s = (int(ours[gap]) - int(ours[0])) / 1e6, int(ours[gap + 1] - ours[gap]) / 1e6
            self.notes.append(
                f"nothing was recorded for {long_s:.1f} s after {since_s:.1f} s: a pause, or the clock that stamped the"
                " log was set; no vehicle's own time tells which, and the duration counts it"
            )
        return cut

    def _tell_slow_stamps(self, ours: IntArray, clocks: Sequence[tuple[IntArray, IntArray]]) -> None:
        """Tells of stamps that hardly go on while vehicles' times do: all 0, in milliseconds, of a computer that slept.

        Where they go on quicker nothing is told: who starts anew, or is not heard for a while, looks like that.
        """
        slow: list[tuple[float, float]] = []
        for at, boot in clocks:
            heard = int(np.searchsorted(at, len(ours)))
            if heard > 1:
                runs = [part for part in _runs(boot) if part.start < heard]
                by_itself = sum(int(boot[part][: heard - part.start].max() - boot[part.start]) for part in runs)
                by_stamps = int(ours[at[heard - 1]] - ours[at[0]])
                if by_itself > _SLOW_LEAST_US and by_stamps < _SLOW_SHARE * by_itself:
                    slow.append((by_itself / 1e6, by_stamps / 1e6))
        if 2 * len(slow) > len(clocks):
            own_s, stamps_s = max(slow)
            self.notes.append(
                f"the vehicles' own times go on by {own_s:.1f} s, the time stamps by {stamps_s:.2f} s: the clock that"
                " stamped the log stood still, counts in other units than microseconds, or a simulator ran quicker;"
                " times and speeds by it are wrong, record it anew"
            )


def _steps(stamps: IntArray, clocks: Sequence[tuple[IntArray, IntArray]]) -> list[Step]:
    """Steps that most vehicles tell of those that were heard before and after them."""
    told: list[tuple[int, int, int, int, int]] = []  # clock, records between which it lies, size, time that passed
    for number, (at, boot) in enumerate(clocks):
        told += [(number, *step) for step in itertools.islice(_steps_of(at, stamps[at], boot), _STEPS_MAX)]
        if len(told) >= _STEPS_MAX:
            return []  # stamps at random: they are of no clock, and are left out from where they run back
    told.sort(key=lambda item: item[2] - item[1])
    found: list[Step] = []
    while told:
        _, first, last, size, passed = told[0]
        same: list[tuple[int, int, int, int, int]] = []
        left: list[tuple[int, int, int, int, int]] = []
        for item in told:
            belongs = item[1] < last and item[2] > first and abs(item[3] - size) <= _STEP_US
            (same if belongs else left).append(item)
        told = left
        low, high = max(item[1] for item in same), min(item[2] for item in same)
        for_it = len({item[0] for item in same})
        heard = sum(bool(at[0] <= low and at[-1] >= high) for at, _ in clocks)
        if 2 * for_it <= heard:
            continue  # the clock of one vehicle stood still, or leapt
        leaps = np.diff(stamps[low : high + 1]) * np.sign(size)
        if leaps.max(initial=0) > max(abs(size) - _STEP_US - (passed if size < 0 else 0), 0):
            found.append(Step(low + 1 + int(leaps.argmax()), size))  # else clocks of vehicles stood still, or a link
    return sorted(found)


def _runs(boot: IntArray) -> list[slice]:
    """One vehicle's times from each start of it to the next."""
    starts = [0, *(np.flatnonzero(np.diff(boot) < -_BACK_US) + 1).tolist(), len(boot)]
    return [slice(start, stop) for start, stop in itertools.pairwise(starts)]


def _steps_of(at: IntArray, stamp: IntArray, boot: IntArray) -> Iterator[tuple[int, int, int, int]]:
    """Where one vehicle's time and the stamps come apart for good.

    Messages that are late make the stamps run ahead too, until the link has caught up. So what counts is the quickest
    message before and behind; and where the stamps come back by themselves within a minute, it was the link. Only where
    they run back from one record to the next they were set back.

    Gives the records before and behind it, by how much, and the vehicle's time between them.
    """
    for start, stop in ((part.start, part.stop) for part in _runs(boot)):
        own, ahead = boot[start:stop], stamp[start:stop] - boot[start:stop]
        apart = np.flatnonzero(np.abs(np.diff(ahead)) > _STEP_US)
        if not len(apart):
            continue
        set_back = np.append(np.flatnonzero(np.diff(stamp[start:stop]) < -_STEP_US) + 1, len(own))
        until = set_back[np.searchsorted(set_back, apart + 2)]  # the first one that is behind the next record
        # A vehicle's times may run back a little from one message to the next; between these two they are in order.
        latest, earliest = np.maximum.accumulate(own), np.minimum.accumulate(own[::-1])[::-1]
        since = np.searchsorted(latest, own[apart] - _WINDOW_US)
        near = np.searchsorted(earliest, own[apart + 1] + _WINDOW_US, side="right")
        far = np.searchsorted(earliest, own[apart + 1] + _FOR_GOOD_US, side="right")
        least = _Least(ahead)
        for k, low, close, high in zip(
            *(a.tolist() for a in (apart, since, near, np.minimum(far, until))), strict=True
        ):
            before, behind = least(low, k + 1), least(k + 1, close)
            size = behind - before
            if size > 0 and least(k + 1, high) - before < size / 2:
                continue
            if abs(size) > _STEP_US and np.sign(size) == np.sign(ahead[k + 1] - ahead[k]):
                yield int(at[start + k]), int(at[start + k + 1]), size, int(own[k + 1] - own[k])


class _Least:
    """The least of any run of values, each time in as many steps: by blocks, and the least of 1, 2, 4 ... of those."""

    def __init__(self, values: IntArray) -> None:
        self._values = values
        whole = len(values) // _BLOCK
        self._rows = [values[: whole * _BLOCK].reshape(whole, _BLOCK).min(axis=1)]
        while len(self._rows[-1]) > (width := 1 << (len(self._rows) - 1)):
            row = self._rows[-1]
            self._rows.append(np.minimum(row[:-width], row[width:]))

    def __call__(self, start: int, stop: int) -> int:
        """The least of ``values[start:stop]``, which are one at least."""
        first, last = -(-start // _BLOCK), stop // _BLOCK
        if first >= last:
            return int(self._values[start:stop].min())
        level = (last - first).bit_length() - 1
        row = self._rows[level]
        least = min(int(row[first]), int(row[last - (1 << level)]))
        for low, high in ((start, first * _BLOCK), (last * _BLOCK, stop)):
            if low < high:
                least = min(least, int(self._values[low:high].min()))
        return least


@cache
def _boot_at(msgid: int) -> int | None:
    """Where a message type has its time since start-up, milliseconds; None where it has none."""
    name = message_name(msgid)
    fields = layout(name).dtype.fields if name is not None else None
    if fields is None or "time_boot_ms" not in fields or fields["time_boot_ms"][0].itemsize != 4:
        return None
    return int(fields["time_boot_ms"][1])


def _enum(group: str, value: int) -> str:
    known = dialect().enums[group].get(value)
    return known.removeprefix(f"{group}_").replace("_", " ").lower() if known is not None else f"{group} {value}"
