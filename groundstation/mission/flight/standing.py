"""Who stands on the ground by its own report, for as long as that report is believed.

A vehicle whose link failed as it took off has told last that it stands, and may be anywhere since.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.vehicle import NEVER, Fleet
from groundstation.mission.plan.links import LinkPlan

_LEAST_S = 1.5
_REPORTS = 4.0  # that may be missing where they come rarely


class Standing:
    """Who stands, asked by many and worked out once a tick: what is found in a tick counts from the next one on.

    Args:
        plan: the rates of each vehicle's link.
        fleet: what the vehicles report.
    """

    def __init__(self, plan: LinkPlan, fleet: Fleet) -> None:
        self._fleet = fleet
        self._limit_s = _limit_s(plan)
        self._at_ns = NEVER
        self._stands: BoolArray = np.zeros(plan.size, dtype=np.bool_)
        self._airborne = self._stands

    def at(self, now_ns: int) -> BoolArray:
        """Vehicles that report to stand on the ground, and have done so lately, shape (n,)."""
        self._look(now_ns)
        return self._stands

    def airborne(self, now_ns: int) -> BoolArray:
        """Vehicles that are armed and have not told lately that they stand on the ground, shape (n,)."""
        self._look(now_ns)
        return self._airborne

    def _look(self, now_ns: int) -> None:
        if now_ns != self._at_ns:
            self._at_ns, self._stands = now_ns, self._fleet.stands(now_ns, self._limit_s)
            self._airborne = self._fleet.armed & ~self._stands


def _limit_s(plan: LinkPlan) -> FloatArray:
    """Age from which on EXTENDED_SYS_STATE says nothing of now, by the rates of each vehicle's link, shape (n,)."""
    reports_hz = np.array([plan.rates_of(i).status_hz()["EXTENDED_SYS_STATE"] for i in range(plan.size)])
    return np.asarray(np.maximum(_LEAST_S, _REPORTS / reports_hz))
