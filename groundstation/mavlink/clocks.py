"""The vehicles' clocks on ours: when was measured what just arrived, and how sure is that.

Messages carry ``time_boot_ms``, the vehicle's own time since power-up. TIMESYNC round trips that we start (``tc1`` = 0,
``ts1`` = our time) tell how far that clock is ahead: the answer was written somewhere between question and arrival, so
half of the round trip is the uncertainty, and the quickest round trip of late is the best one.

Also tells from ``time_boot_ms`` that a vehicle has started anew, or that two vehicles speak under one system id: the
time runs back once, or again and again. Reads no clock; all times are ns on the caller's.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from groundstation.core.types import BoolArray, FloatArray, IntArray

_KEPT_NS = 60_000_000_000
_KEPT_SAMPLES = 32
_DRIFT = 50e-6  # crystals differ by this much at most: an old sample is worth that much less
_OUTSTANDING = 64
_JUMP_NS = 20_000_000  # beyond what the round trips allow: the clock was set, or belongs to a new start
_BACK_MS = 1_000  # reordering on a link is quicker than this
_BACK_AGAIN = 3  # so many messages in a row with the earlier time: the vehicle has started anew
_FLIPS, _FLIPS_NS = 4, 5_000_000_000


@dataclass
class _Sample:
    t_ns: int
    offset_ns: int
    round_trip_ns: int

    def uncertainty_ns(self, now_ns: int) -> float:
        return self.round_trip_ns / 2 + _DRIFT * (now_ns - self.t_ns)


class Clocks:
    """How far the clocks of n vehicles are ahead of ours.

    Attributes:
        offset_ns: vehicle's time since boot minus our time, shape (n,); of no meaning where not known.
        known: there was a round trip since the vehicle's last start, shape (n,).
        round_trip_s: the quickest round trip of late, NaN where not known, shape (n,).
        samples: round trips since the last start, shape (n,).
    """

    def __init__(self, n: int) -> None:
        self.offset_ns: IntArray = np.zeros(n, dtype=np.int64)
        self.known: BoolArray = np.zeros(n, dtype=np.bool_)
        self.round_trip_s: FloatArray = np.full(n, np.nan)
        self.samples: IntArray = np.zeros(n, dtype=np.int64)
        self._late: list[deque[_Sample]] = [deque(maxlen=_KEPT_SAMPLES) for _ in range(n)]
        self._asked: list[deque[int]] = [deque(maxlen=_OUTSTANDING) for _ in range(n)]

    def asked(self, vehicle: int, ts1_ns: int) -> None:
        """Remembers a question that was sent; answers to anybody else's do not count."""
        self._asked[vehicle].append(ts1_ns)

    def answered(self, vehicle: int, tc1_ns: int, ts1_ns: int, t_rx_ns: int) -> bool:
        """Takes an answer; returns whether the vehicle's clock has run back: it has started anew."""
        if ts1_ns not in self._asked[vehicle] or t_rx_ns < ts1_ns:
            return False
        late = self._late[vehicle]
        sample = _Sample(t_rx_ns, tc1_ns - (ts1_ns + t_rx_ns) // 2, t_rx_ns - ts1_ns)
        if late:
            best = min(late, key=lambda item: item.uncertainty_ns(t_rx_ns))
            jump_ns = sample.offset_ns - best.offset_ns
            if abs(jump_ns) > sample.round_trip_ns / 2 + best.uncertainty_ns(t_rx_ns) + _JUMP_NS:
                self.forget(vehicle)
                if jump_ns < -_BACK_MS * 1_000_000:
                    return True
        self._asked[vehicle] = deque((t for t in self._asked[vehicle] if t != ts1_ns), maxlen=_OUTSTANDING)
        late.append(sample)
        while late[0].t_ns < t_rx_ns - _KEPT_NS:
            late.popleft()
        best = min(late, key=lambda sample: sample.uncertainty_ns(t_rx_ns))
        self.offset_ns[vehicle] = best.offset_ns
        self.round_trip_s[vehicle] = best.round_trip_ns / 1e9
        self.samples[vehicle] += 1
        self.known[vehicle] = True
        return False

    def forget(self, vehicle: int) -> None:
        """The vehicle has started anew: its clock too."""
        self._late[vehicle].clear()
        self._asked[vehicle].clear()
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
        mapped = boot_ms * 1_000_000 + half_ms_ns - self.offset_ns[row]
        return np.where(self.known[row] & (boot_ms > 0), np.minimum(mapped, t_rx_ns), t_rx_ns)


class BootTimes:
    """Order of one message type's time stamps, vehicle by vehicle.

    Args:
        n: number of vehicles.
    """

    def __init__(self, n: int) -> None:
        self._last_ms: IntArray = np.full(n, -1, dtype=np.int64)
        self._back: IntArray = np.zeros(n, dtype=np.int64)
        self._flips: list[deque[int]] = [deque(maxlen=_FLIPS) for _ in range(n)]

    def take(self, row: IntArray, boot_ms: IntArray, t_rx_ns: IntArray) -> tuple[BoolArray, list[int]]:
        """Judges messages in the order of their arrival.

        Args:
            row: vehicles, shape (k,).
            boot_ms: their time stamps, shape (k,).
            t_rx_ns: arrivals, shape (k,).

        Returns:
            Which of them are news, shape (k,), and the vehicles that have started anew.
        """
        fresh: BoolArray = np.ones(len(row), dtype=np.bool_)
        if not self._back.any() and len(set(row.tolist())) == len(row) and bool((boot_ms >= self._last_ms[row]).all()):
            self._last_ms[row] = boot_ms
            return fresh, []
        restarted: list[int] = []
        for k, (vehicle, boot, t_ns) in enumerate(zip(row.tolist(), boot_ms.tolist(), t_rx_ns.tolist(), strict=True)):
            last = int(self._last_ms[vehicle])
            if boot >= last:
                if self._back[vehicle]:
                    self._flips[vehicle].append(t_ns)
                self._back[vehicle] = 0
            elif boot >= last - _BACK_MS:
                fresh[k] = False
                continue
            else:
                self._back[vehicle] += 1
                if self._back[vehicle] < _BACK_AGAIN:
                    fresh[k] = False
                    continue
                self._back[vehicle] = 0
                self._flips[vehicle].append(t_ns)
                restarted.append(vehicle)
            self._last_ms[vehicle] = boot
        return fresh, restarted

    def two_at_once(self, vehicle: int, now_ns: int) -> bool:
        """Whether two vehicles have been speaking under this one's id of late: their times alternate."""
        flips = self._flips[vehicle]
        return len(flips) == _FLIPS and flips[0] > now_ns - _FLIPS_NS
