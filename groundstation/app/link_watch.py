"""How the radio links of a flight's vehicles were at their worst, as their gateway measured them."""

from __future__ import annotations

import numpy as np

from groundstation.app.session import Session
from groundstation.core.types import FloatArray

_ROWS_MAX = 8


class LinkWatch:
    """Looks on after every tick, while somebody is in the air.

    Args:
        n: vehicles.

    Attributes:
        heard: smallest share of what a radio sent that came, NaN where nobody measures it, shape (n,).
        trip_s: longest way there and back, shape (n,).
        now_ns: time of the last look.
    """

    def __init__(self, n: int) -> None:
        self.heard: FloatArray = np.full(n, np.nan)
        self.trip_s: FloatArray = np.full(n, np.nan)
        self.now_ns = 0
        self._ids: list[int] = []

    def __call__(self, session: Session, now_ns: int) -> None:
        """Takes what is known."""
        self.now_ns = now_ns
        runner = session.runner
        if runner.airborne.any():
            self._ids = runner.fleet.ids.tolist()
            self.heard = np.fmin(self.heard, runner.fleet.link_heard)
            self.trip_s = np.fmax(self.trip_s, runner.fleet.link_trip_s)

    def words(self) -> str:
        """Those that were worst, "" where nothing was measured."""
        known = np.flatnonzero(np.isfinite(self.heard)).tolist()
        if not known:
            return ""
        worst = sorted(known, key=lambda row: (self.heard[row], -self.trip_s[row]))[:_ROWS_MAX]
        told = []
        for row in worst:
            trip = f", {self.trip_s[row] * 1000.0:.0f} ms" if np.isfinite(self.trip_s[row]) else ""
            told.append(f"{self._ids[row]} {self.heard[row]:.0%}{trip}")
        return f"radio links at their worst: {'; '.join(told)}"
