"""A vehicle's log stamps on the gateway's clock, so that a pose that lay in a queue is known to be old.

The quickest packet says how the two clocks lie to each other; whatever took longer is older by that. What the quickest
one took itself is not known and not added (a few ms over a radio).
"""

from __future__ import annotations

_WRAP_MS = 1 << 24
_MS = 1_000_000
_LATE_MS = 500
_DRIFT = 2e-4  # quartz against quartz, and more


class Stamps:
    """One vehicle's.

    Attributes:
        restarts: how often its clock began anew.
        lateness_ns: of the packet before, against the quickest.
    """

    def __init__(self) -> None:
        self.restarts = self.lateness_ns = 0
        self._own_ms: int | None = None
        self._stamp_ms = self._offset_ns = self._heard_ns = 0

    def measured_ns(self, stamp_ms: int, now_ns: int) -> int | None:
        """When a packet's values were measured; None for one that came behind a newer one.

        Args:
            stamp_ms: as the vehicle wrote it, 24 bits.
            now_ns: when it came.
        """
        if self._own_ms is None:
            self._begin(stamp_ms, now_ns)
            return now_ns
        step_ms = (stamp_ms - self._stamp_ms) % _WRAP_MS
        if step_ms > _WRAP_MS // 2:
            if _WRAP_MS - step_ms < _LATE_MS:
                return None
            self.restarts += 1
            self._begin(stamp_ms, now_ns)
            return now_ns
        self._own_ms += step_ms
        crept_ns = self._offset_ns + round(_DRIFT * (now_ns - self._heard_ns))
        self._stamp_ms, self._heard_ns = stamp_ms, now_ns
        self._offset_ns = min(now_ns - self._own_ms * _MS, crept_ns)
        measured_ns = self._own_ms * _MS + self._offset_ns
        self.lateness_ns = now_ns - measured_ns
        return measured_ns

    def _begin(self, stamp_ms: int, now_ns: int) -> None:
        self._own_ms, self._stamp_ms, self._heard_ns = stamp_ms, stamp_ms, now_ns
        self._offset_ns = now_ns - stamp_ms * _MS
        self.lateness_ns = 0
