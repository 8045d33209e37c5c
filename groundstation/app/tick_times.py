"""How punctual the loop on the wall clock was: percentiles of three times of every tick, in constant memory.

Counted in buckets each 2 % wider than the one before, so that a flight of an hour takes as much room as one of a minute
and a percentile is right to 2 %.
"""

from __future__ import annotations

import math

import numpy as np

_LEAST_S, _MOST_S, _WIDER = 1e-6, 100.0, 1.02
_BUCKETS = math.ceil(math.log(_MOST_S / _LEAST_S) / math.log(_WIDER)) + 1
TIMES = "tick_late_ms", "tick_work_ms", "telemetry_to_setpoint_ms"
"""Keys of the figures in the answer of ``gs fly --json``."""
_SHARES = {"p50": 0.5, "p90": 0.9, "p99": 0.99}


class Percentiles:
    """Counts times and says which are exceeded how rarely; the longest is kept as it is."""

    def __init__(self) -> None:
        self._counts = [0] * _BUCKETS
        self._count, self._longest_s = 0, 0.0

    def add(self, time_s: float) -> None:
        """Counts one; less than a microsecond counts as one."""
        place = math.log(max(time_s, _LEAST_S) / _LEAST_S) / math.log(_WIDER)
        self._counts[min(math.ceil(place - 1e-9), _BUCKETS - 1)] += 1
        self._count += 1
        self._longest_s = max(self._longest_s, time_s)

    def figures_ms(self) -> dict[str, float] | None:
        """``p50``, ``p90``, ``p99`` and ``max``, milliseconds, none of them told too short; None before the first."""
        if not self._count:
            return None
        figures = {name: self._reached_s(share) for name, share in _SHARES.items()} | {"max": self._longest_s}
        return {name: round(1e3 * value_s, 4) for name, value_s in figures.items()}

    def _reached_s(self, share: float) -> float:
        """The upper end of the bucket in which this share of all is reached, or the longest where that is less."""
        left = math.ceil(share * self._count)
        for bucket, count in enumerate(self._counts):
            left -= count
            if left <= 0 and bucket < _BUCKETS - 1:  # the last one has no end
                return min(_LEAST_S * _WIDER**bucket, self._longest_s)
        return self._longest_s


class TickTimes:
    """The three times of a tick on the wall clock."""

    def __init__(self) -> None:
        self._late, self._work, self._pose = Percentiles(), Percentiles(), Percentiles()
        self._worst_s = math.nan

    def tick(self, due_ns: int, began_ns: int, sent_ns: int, heard_ns: int | None, *, steers: bool) -> None:
        """Counts one tick.

        Args:
            due_ns: when it should have begun.
            began_ns: when it did.
            sent_ns: when the last of what it sends was handed to the system.
            heard_ns: when the last datagram was taken in before it; None where none came since the tick before.
            steers: whether setpoints were among what was sent.
        """
        self._worst_s = float(np.fmax(self._worst_s, (sent_ns - due_ns) / 1e9))
        self._late.add((began_ns - due_ns) / 1e9)
        self._work.add((sent_ns - began_ns) / 1e9)
        if steers and heard_ns is not None:
            self._pose.add((sent_ns - heard_ns) / 1e9)

    def take_worst_ms(self) -> float:
        """Longest from when a tick was due to when it had sent, since this was last asked, ms; NaN without a tick."""
        worst_s, self._worst_s = self._worst_s, math.nan
        return 1e3 * worst_s

    def figures(self) -> dict[str, dict[str, float] | None]:
        """As the answer of ``gs fly --json`` has them, by the keys of ``TIMES``."""
        return dict(zip(TIMES, (one.figures_ms() for one in (self._late, self._work, self._pose)), strict=True))

    def words(self) -> str:
        """For the log; "" before the first tick."""
        told = ((key.removesuffix("_ms").replace("_", " "), value) for key, value in self.figures().items() if value)
        return "; ".join(f"{name} " + ", ".join(f"{at} {ms:g} ms" for at, ms in value.items()) for name, value in told)
