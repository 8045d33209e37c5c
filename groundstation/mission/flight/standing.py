"""For how long a report to stand on the ground is believed.

A vehicle whose link failed as it took off has told last that it stands, and may be anywhere since.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.types import FloatArray
from groundstation.mission.plan.plan import MissionPlan

_LEAST_S = 1.5
_REPORTS = 4.0  # that may be missing where they come rarely


def landed_age_s(plan: MissionPlan) -> FloatArray:
    """Age from which on EXTENDED_SYS_STATE says nothing of now, by the rates of each vehicle's link, shape (n,)."""
    reports_hz = np.array([plan.rates_of(i).status_hz()["EXTENDED_SYS_STATE"] for i in range(plan.size)])
    return np.asarray(np.maximum(_LEAST_S, _REPORTS / reports_hz))
