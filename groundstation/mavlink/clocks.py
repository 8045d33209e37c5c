"""The vehicles' clocks on ours: when was measured what just arrived, and how sure is that.

Messages carry ``time_boot_ms``, the vehicle's own time since power-up. TIMESYNC round trips that we start (``tc1`` = 0,
``ts1`` = our time) tell how far that clock is ahead: the answer was written somewhere between question and arrival, so
half of the round trip is the uncertainty, and the quickest round trip of late is the best one. Crystals run alike; a
simulator on a busy computer counts time a few percent slowly, which is worked out from what round trips bound.

Also tells from ``time_boot_ms`` that a vehicle has started anew, or that two vehicles speak under one system id: the
time runs back once, or again and again. That it begins again at 0 after 2^32 ms is neither. Reads no clock; all times
are ns on the caller's.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from groundstation.core.quick import every
from groundstation.core.types import BoolArray, FloatArray, IntArray

_KEPT_NS = 60_000_000_000
_KEPT_SAMPLES = 32
_DRIFT = 50e-6  # crystals differ by this much at most: an old sample is worth that much less
_RATE_MAX = 0.03  # simulators on a busy computer count time up to 2 % slowly
_RATE_SURE = 1e-3  # how well a rate that is not a crystal's is believed to last
_OUTSTANDING = 64
_JUMP_NS = 20_000_000  # beyond what round trips and rates allow: the clock was set, stood still, or began anew
_BACK_MS = 1_000  # reordering on a link is quicker than this
_STALL_NS = 3_000_000_000  # no simulator stands still for longer than this; a vehicle that starts anew is away longer
_LAG_S = 0.25  # beyond the quickest round trip
_BACK_AGAIN = 3  # so many messages in a row with another time: its clock was set, or it has started anew
_FLIPS, _FLIPS_NS = 4, 5_000_000_000
_NO_TIME_NS = 1 << 61  # 73 years: no clock of a vehicle, and its sums stay whole numbers of 64 bits
_WRAP_MS = 1 << 32  # time_boot_ms counts on from 0 after 49.7 days
_WRAP_NS = np.array(_WRAP_MS * 1e6)
_AHEAD_MS = 10_000  # no clock runs further ahead of what has passed here, whatever was under way on a link


@dataclass(frozen=True)
class _Sample:
    t_ns: int
    offset_ns: int
    round_trip_ns: int

    def uncertainty_ns(self, now_ns: int, rate_unsure: float) -> float:
        return self.round_trip_ns / 2 + rate_unsure * (now_ns - self.t_ns)


class Clocks:
    """How far the clocks of n vehicles are ahead of ours, and how much faster they run.

    Attributes:
        offset_ns: vehicle's time since boot minus our time at ``at_ns``, shape (n,); of no meaning where not known.
        at_ns: of our time, shape (n,).
        rate: by how much it grows in each nanosecond of ours, shape (n,); 0 where a crystal's drift explains all that
            was seen.
        known: there was a round trip since the vehicle's last start, shape (n,).
        round_trip_s: the quickest round trip of late, NaN where not known, shape (n,).
        samples: round trips since the last start, shape (n,).
    """

    def __init__(self, n: int) -> None:
        self.offset_ns: IntArray = np.zeros(n, dtype=np.int64)
        self.at_ns: IntArray = np.zeros(n, dtype=np.int64)
        self.rate: FloatArray = np.zeros(n)
        self.known: BoolArray = np.zeros(n, dtype=np.bool_)
        self.round_trip_s: FloatArray = np.full(n, np.nan)
        self.samples: IntArray = np.zeros(n, dtype=np.int64)
        self._late: list[deque[_Sample]] = [deque(maxlen=_KEPT_SAMPLES) for _ in range(n)]
        self._asked: list[deque[int]] = [deque(maxlen=_OUTSTANDING) for _ in range(n)]
        self._told_ns: IntArray = np.zeros(n, dtype=np.int64)
        self._lag_ns: IntArray = np.zeros(n, dtype=np.int64)
        self._odd: dict[int, _Sample] = {}  # by vehicle: an answer that fits no other

    def asked(self, vehicle: int, ts1_ns: int) -> None:
        """Remembers a question that was sent; answers to anybody else's do not count."""
        self._asked[vehicle].append(ts1_ns)

    def answered(self, vehicle: int, tc1_ns: int, ts1_ns: int, t_rx_ns: int) -> bool:
        """Takes an answer; returns whether the vehicle's clock has run back: it has started anew.

        A clock that stood still for a moment is followed from this answer on. Of one that was set, or began anew, two
        answers in a row have to agree: one alone that fits no other sets no clock.
        """
        if ts1_ns not in self._asked[vehicle] or t_rx_ns < ts1_ns or not abs(tc1_ns) < _NO_TIME_NS:
            return False
        late = self._late[vehicle]
        sample = _Sample(t_rx_ns, tc1_ns - (ts1_ns + t_rx_ns) // 2, t_rx_ns - ts1_ns)
        if late:
            newest = late[-1]
            jump_ns = sample.offset_ns - newest.offset_ns
            if _apart(sample, newest):
                back = jump_ns < -_STALL_NS or tc1_ns < self._told_ns[vehicle] - _BACK_MS * 1_000_000
                if back or jump_ns > 0:
                    odd = self._odd.get(vehicle)
                    self._odd[vehicle] = sample
                    if odd is None or _apart(sample, odd):
                        self._answered_once(vehicle, ts1_ns)
                        return False
                late.clear()
                if back:
                    self.forget(vehicle)
                    return True
        self._odd.pop(vehicle, None)
        self._told_ns[vehicle] = tc1_ns
        self._answered_once(vehicle, ts1_ns)
        late.append(sample)
        while late[0].t_ns < t_rx_ns - _KEPT_NS:
            late.popleft()
        rate, unsure = _rate(late)
        best = min(late, key=lambda item: item.uncertainty_ns(t_rx_ns, unsure))
        self.offset_ns[vehicle], self.at_ns[vehicle], self.rate[vehicle] = best.offset_ns, best.t_ns, rate
        self.round_trip_s[vehicle] = best.round_trip_ns / 1e9
        self._lag_ns[vehicle] = 0
        self.samples[vehicle] += 1
        self.known[vehicle] = True
        return False

    def _answered_once(self, vehicle: int, ts1_ns: int) -> None:
        self._asked[vehicle] = deque((t for t in self._asked[vehicle] if t != ts1_ns), maxlen=_OUTSTANDING)

    def forget(self, vehicle: int) -> None:
        """The vehicle has started anew: its clock too."""
        self._late[vehicle].clear()
        self._asked[vehicle].clear()
        self._told_ns[vehicle] = 0
        self._lag_ns[vehicle] = 0
        self.rate[vehicle] = 0.0
        self._odd.pop(vehicle, None)
        self.known[vehicle] = False
        self.round_trip_s[vehicle] = np.nan
        self.samples[vehicle] = 0

    def uncertainty_s(self) -> FloatArray:
        """How far off a mapped time may be, shape (n,): half of the quickest round trip; NaN where not known."""
        return self.round_trip_s / 2.0

    def measured_ns(self, row: IntArray, boot_ms: IntArray, t_rx_ns: IntArray) -> IntArray:
        """When something was measured, on our clock.

        Args:
            row: vehicles, shape (k,).
            boot_ms: their time stamps, shape (k,).
            t_rx_ns: arrivals, shape (k,).

        Returns:
            Shape (k,); never later than the arrival, and the arrival itself where the clock is not known or the
            message bears no time.
        """
        half_ms_ns = 500_000  # whole milliseconds are cut off, not rounded
        offset_ns = self.offset_ns[row]
        if np.count_nonzero(self.rate):
            offset_ns = offset_ns + np.rint(self.rate[row] * (t_rx_ns - self.at_ns[row])).astype(np.int64)
        mapped = boot_ms * 1_000_000 + half_ms_ns - offset_ns
        # TIMESYNC counts on when time_boot_ms begins again.
        turns = np.rint((t_rx_ns - mapped) / _WRAP_NS)
        if np.count_nonzero(turns):
            mapped += turns.astype(np.int64) * (_WRAP_MS * 1_000_000)
        measured_ns = np.where(self.known[row] & (boot_ms > 0), np.minimum(mapped, t_rx_ns), t_rx_ns)
        self._lag_ns[row] = t_rx_ns - measured_ns
        return measured_ns

    def doubtful(self) -> BoolArray:
        """Vehicles that should be asked again at once, shape (n,).

        Their messages seem to have been long under way, so that their clocks may have stood still; or their last answer
        fits no other, and the next one tells whether they have started anew.
        """
        doubtful: BoolArray = np.asarray(self._lag_ns / 1e9 > self.round_trip_s + _LAG_S)  # not with NaN
        doubtful[list(self._odd)] = True
        return doubtful


def _apart(sample: _Sample, other: _Sample) -> bool:
    """Whether two answers cannot be of one clock that nobody has set and that has not stood still."""
    allowed_ns = (sample.round_trip_ns + other.round_trip_ns) / 2 + _RATE_MAX * abs(sample.t_ns - other.t_ns)
    return abs(sample.offset_ns - other.offset_ns) > allowed_ns + _JUMP_NS


def _rate(late: deque[_Sample]) -> tuple[float, float]:
    """How much faster a clock runs than ours by its round trips, and how far off that may be.

    Each round trip bounds the offset to both sides, so two of them bound the rate. Older ones that no rate of today
    explains are dropped. As long as a crystal's drift is possible the rate is taken for that.
    """
    newest = late[-1]
    low, high = -_RATE_MAX, _RATE_MAX
    kept = 1
    for older in reversed(list(late)[:-1]):
        apart_ns = max(newest.t_ns - older.t_ns, 1)
        slack_ns = (newest.round_trip_ns + older.round_trip_ns) / 2
        gone_ns = newest.offset_ns - older.offset_ns
        least, most = (gone_ns - slack_ns) / apart_ns, (gone_ns + slack_ns) / apart_ns
        if max(low, least) > min(high, most):
            break
        low, high = max(low, least), min(high, most)
        kept += 1
    while len(late) > kept:
        late.popleft()
    if low <= _DRIFT and high >= -_DRIFT:
        return 0.0, _DRIFT
    return (low + high) / 2, (high - low) / 2 + _RATE_SURE


class BootTimes:
    """Order of one message type's time stamps, vehicle by vehicle.

    Args:
        n: number of vehicles.

    Attributes:
        quiet: no vehicle's times have ever run back, or jumped.
    """

    def __init__(self, n: int) -> None:
        self._last_ms: IntArray = np.full(n, -1, dtype=np.int64)
        self._last_rx_ns: IntArray = np.zeros(n, dtype=np.int64)
        self._back: IntArray = np.zeros(n, dtype=np.int64)
        self._flips: list[deque[int]] = [deque(maxlen=_FLIPS) for _ in range(n)]
        self.quiet = True

    def take(self, row: IntArray, boot_ms: IntArray, t_rx_ns: IntArray) -> tuple[BoolArray, list[int]]:
        """Judges messages in the order of their arrival.

        Args:
            row: vehicles, shape (k,).
            boot_ms: their time stamps, shape (k,).
            t_rx_ns: arrivals, shape (k,).

        Returns:
            Which of them are news, shape (k,), and the vehicles that have started anew.
        """
        last_ms = self._last_ms[row]
        most_ms = (t_rx_ns - self._last_rx_ns[row]) // 1_000_000 + _AHEAD_MS
        gone_ms = boot_ms - last_ms
        goes_on: BoolArray = (gone_ms >= 0) & (gone_ms <= most_ms)
        if not every(goes_on):
            goes_on |= last_ms < 0  # or it is the first one
        if every(goes_on) and not np.count_nonzero(self._back) and len(set(row.tolist())) == len(row):
            self._last_ms[row], self._last_rx_ns[row] = boot_ms, t_rx_ns
            return goes_on, []
        fresh: BoolArray = np.ones(len(row), dtype=np.bool_)
        restarted: list[int] = []
        for k, (vehicle, boot, t_ns) in enumerate(zip(row.tolist(), boot_ms.tolist(), t_rx_ns.tolist(), strict=True)):
            last = int(self._last_ms[vehicle])
            gone = boot - last
            around = (gone + _WRAP_MS // 2) % _WRAP_MS - _WRAP_MS // 2
            if -_BACK_MS <= around <= self._most_ms(vehicle, t_ns):
                gone = around
            if last < 0 or 0 <= gone <= self._most_ms(vehicle, t_ns):
                if self._back[vehicle]:
                    self._flip(vehicle, t_ns)
                self._back[vehicle] = 0
            elif -_BACK_MS <= gone < 0:
                fresh[k] = False
                continue
            else:
                self._back[vehicle] += 1
                if self._back[vehicle] < _BACK_AGAIN:
                    fresh[k] = False
                    continue
                self._back[vehicle] = 0
                self._flip(vehicle, t_ns)
                if gone < 0:
                    restarted.append(vehicle)
            self._last_ms[vehicle], self._last_rx_ns[vehicle] = boot, t_ns
        return fresh, restarted

    def _flip(self, vehicle: int, t_rx_ns: int) -> None:
        self._flips[vehicle].append(t_rx_ns)
        self.quiet = False

    def _most_ms(self, vehicle: int, t_rx_ns: int) -> int:
        """How far a vehicle's clock can have gone since its last message."""
        return (t_rx_ns - int(self._last_rx_ns[vehicle])) // 1_000_000 + _AHEAD_MS

    def two_at_once(self, vehicle: int, now_ns: int) -> bool:
        """Whether two vehicles have been speaking under this one's id of late: their times alternate."""
        flips = self._flips[vehicle]
        return len(flips) == _FLIPS and flips[0] > now_ns - _FLIPS_NS
