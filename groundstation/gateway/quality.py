"""How good a vehicle's radio link is, measured while it flies, and what rates that leaves.

Two figures. Of the poses that a vehicle logs at a known rate, how many come: its own time stamps say how many there
were. And how long a packet takes to the vehicle and back, by echoes; one that is not answered counts as late as it is.
Rates fall when either is poor, one level at a time and long before the vehicle's own watchdogs act, and rise again
slowly. Sends nothing.
"""

from __future__ import annotations

import math

_SECOND_NS = 1_000_000_000
_PING_NS = _SECOND_NS // 2
_WAIT_NS = 2 * _SECOND_NS
_SHARE_S = 1.0  # over about so long the share of poses is taken
_WRAP_MS = 1 << 24
_POOR_SHARE, _GOOD_SHARE = 0.7, 0.9
_POOR_TRIP_S, _GOOD_TRIP_S = 0.15, 0.08
_FALL_NS, _RISE_NS = _SECOND_NS // 2, 5 * _SECOND_NS
CAPS_HZ = (math.inf, 20.0, 10.0)
"""Most setpoints, poses and logged poses a second, by level; 10 Hz are what the paper's authors needed."""


class LinkQuality:
    """One vehicle's.

    Args:
        log_hz: poses a second that it logs.

    Attributes:
        heard: share of its poses that came lately, 0 to 1; NaN before.
        trip_s: how long a packet takes there and back; NaN before.
        level: of ``CAPS_HZ``.
    """

    def __init__(self, log_hz: float) -> None:
        self.heard = self.trip_s = math.nan
        self.level = 0
        self._log_hz = log_hz
        self._stamp_ms: int | None = None
        self._posed_ns = 0
        self._number = 0
        self._asked_ns = -_PING_NS
        self._under_way: dict[int, int] = {}
        self._poor_ns: int | None = None
        self._fine_ns: int | None = None

    @property
    def cap_hz(self) -> float:
        """Most setpoints and poses a second at the moment."""
        return CAPS_HZ[self.level]

    @property
    def log_hz(self) -> float:
        """Poses a second that it is to log at the moment."""
        return min(self._log_hz, self.cap_hz)

    def posed(self, stamp_ms: int, now_ns: int) -> None:
        """Takes the stamp of a logged pose, 24 bits."""
        if self._stamp_ms is not None and 0 < (step_ms := (stamp_ms - self._stamp_ms) % _WRAP_MS) < _WRAP_MS // 2:
            missing = max(0, round(step_ms * self.log_hz / 1000.0) - 1)
            weight = 1.0 - math.exp(-step_ms / 1000.0 / _SHARE_S)
            share = 1.0 / (1.0 + missing)
            self.heard = share if math.isnan(self.heard) else self.heard + weight * (share - self.heard)
        self._stamp_ms, self._posed_ns = stamp_ms, now_ns

    def ping(self, now_ns: int) -> int | None:
        """Number of an echo that is to be asked for now; None when none is due."""
        if now_ns - self._asked_ns < _PING_NS:
            return None
        self._asked_ns = now_ns
        self._number = (self._number + 1) & 0xFFFF
        self._under_way[self._number] = now_ns
        return self._number

    def echoed(self, number: int, now_ns: int) -> None:
        """Takes an echo."""
        sent_ns = self._under_way.pop(number, None)
        if sent_ns is not None:
            self.trip_s = (now_ns - sent_ns) / _SECOND_NS
            self._under_way = {k: t_ns for k, t_ns in self._under_way.items() if t_ns > sent_ns}

    def step(self, now_ns: int) -> bool:
        """Judges; returns whether the level has changed."""
        oldest_ns = min(self._under_way.values(), default=now_ns)
        self.trip_s = max(self.trip_s, (now_ns - oldest_ns) / _SECOND_NS) if oldest_ns < now_ns else self.trip_s
        self._under_way = {k: t_ns for k, t_ns in self._under_way.items() if now_ns - t_ns <= _WAIT_NS}
        if self._stamp_ms is not None and now_ns - self._posed_ns > _SECOND_NS // 4:
            self.heard = min(self.heard, 0.5) if not math.isnan(self.heard) else self.heard
        poor = self.heard < _POOR_SHARE or self.trip_s > _POOR_TRIP_S  # NaN is neither
        fine = self.heard > _GOOD_SHARE and self.trip_s < _GOOD_TRIP_S
        self._poor_ns = (now_ns if self._poor_ns is None else self._poor_ns) if poor else None
        self._fine_ns = (now_ns if self._fine_ns is None else self._fine_ns) if fine else None
        if self._poor_ns is not None and now_ns - self._poor_ns >= _FALL_NS and self.level < len(CAPS_HZ) - 1:
            self.level, self._poor_ns = self.level + 1, None
            return True
        if self._fine_ns is not None and now_ns - self._fine_ns >= _RISE_NS and self.level > 0:
            self.level, self._fine_ns = self.level - 1, None
            return True
        return False

    def words(self) -> str:
        """What it is like, and what follows, for people."""
        trip = f", {self.trip_s * 1000.0:.0f} ms there and back" if math.isfinite(self.trip_s) else ""
        link = f"link {self.heard:.0%}{trip}" if math.isfinite(self.heard) else f"link{trip or ' not measured'}"
        return f"{link}: rates {f'at most {self.cap_hz:g} Hz' if self.level else 'as asked for'}"
