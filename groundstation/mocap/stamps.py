"""How old a frame is: the system's clock held against ours.

The quickest frame says how the two lie to each other; whatever took longer is older by that. What the quickest one took
itself (exposure, tracking, network: 3 to 10 ms) is not known and not added.
"""

from __future__ import annotations

_DRIFT = 2e-4  # quartz against quartz, and more
_BACK_NS = 2_000_000_000


class FrameClock:
    """One system's.

    Attributes:
        lateness_ns: of the newest frame, against the quickest.
        restarts: how often its clock began anew.
    """

    def __init__(self) -> None:
        self.lateness_ns = self.restarts = 0
        self._offset_ns: int | None = None
        self._heard_ns = self._newest_ns = 0

    def older(self, stamp_ns: int, t_rx_ns: int) -> bool:
        """Whether a frame came behind a newer one; a clock that goes back by seconds has begun anew, and is taken."""
        if self._newest_ns - stamp_ns < _BACK_NS:
            return True
        self.restarts += 1
        self._offset_ns = None
        return False

    def measured_ns(self, stamp_ns: int, t_rx_ns: int) -> int:
        """When a frame was measured, on our clock; never after its arrival.

        Args:
            stamp_ns: by the system's clock; -1: it has none, and the arrival counts.
            t_rx_ns: arrival.
        """
        if stamp_ns < 0:
            self.lateness_ns = 0
            return t_rx_ns
        offset_ns = t_rx_ns - stamp_ns
        if self._offset_ns is not None:
            crept_ns = self._offset_ns + round(_DRIFT * max(0, t_rx_ns - self._heard_ns))
            offset_ns = min(offset_ns, crept_ns)
        self._offset_ns, self._heard_ns, self._newest_ns = offset_ns, t_rx_ns, stamp_ns
        self.lateness_ns = t_rx_ns - stamp_ns - offset_ns
        return stamp_ns + offset_ns
