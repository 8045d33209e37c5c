"""The kinematic team: the same mission flown by points that do at once what they are told, and are seen exactly.

That is what the paper's proofs are about (single integrators, Sections IV to VI): gains, map f, roles, speed limit and
r are the mission's; no lag, no delay, no margin, and the k of (14) that such vehicles bear. The time that it takes to
form is what the time of real vehicles is held against. Reads no clock and draws nothing at random.
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.app.campaign.cases import Case
from groundstation.core.phases import Phase
from groundstation.core.types import FloatArray
from groundstation.mission.flight.formation_flight import FormationFlight
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.helm import Helm
from groundstation.mission.flight.poses import Poses
from groundstation.mission.ground.failsafe import first_roles
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import plan_from_record
from groundstation.mission.roster import enlist
from groundstation.mission.timing import SECOND_NS
from groundstation.mission.verdict import Figures

_NAME = "kinematic"
_PROFILE = {
    "like": "crazyflie",
    "lag_s": 0.0,
    "delay_s": 1e-3,  # rates are worked out as one over lag and delay
    "acceleration_max_m_s2": 100.0,
    "position_error_m": 1e-9,
}


def kinematic_plan(case: Case) -> MissionPlan:
    """The mission of a case for vehicles that are points.

    Raises:
        UserError: it does not fit together.
    """
    values = dict(case.mission)
    for key in ("position_error_m", "acceleration_limit_m_s2", "positioning", "link_bytes_per_s"):
        values.pop(key, None)
    values |= {
        "link_delay_s": 0.0,
        "profiles": {_NAME: _PROFILE},
        "position_error_m": _PROFILE["position_error_m"],
        "vehicles": [{**vehicle, "profile": _NAME} for vehicle in values["vehicles"]],
    }
    return plan_from_record(values, case.gains_npz, f"run {case.run}, kinematic", case.code)


def kinematic_time_to_form_s(case: Case) -> float:
    """Time in which the kinematic team forms from above the same pads, s; NaN if not in the mission's time.

    Raises:
        UserError: the mission does not fit together.
    """
    plan = kinematic_plan(case)
    figures = Figures()
    flight = FormationFlight(plan, enlist(plan), Helm(Guide(plan), plan.size), figures, lambda kind, text, roles: None)
    flight.assign(first_roles(plan))
    pos_ned_m: FloatArray = flight.gather_ned_m.copy()
    vel_ned_m_s: FloatArray = np.zeros_like(pos_ned_m)
    level = np.tile([1.0, 0.0, 0.0, 0.0], (plan.size, 1))
    nobody = np.zeros(plan.size, dtype=np.bool_)
    period_ns = round(SECOND_NS / plan.spec.rate_hz)
    now_ns = 0
    flight.next_step(now_ns, Poses(pos_ned_m, vel_ned_m_s, level, nobody))
    while True:
        tick = flight.step(now_ns, Poses(pos_ned_m, vel_ned_m_s, level, nobody))
        if math.isfinite(figures.time_to_form_s) or tick.give_up or tick.follows is Phase.RETURN:
            return figures.time_to_form_s
        vel_ned_m_s = tick.vel_ned_m_s
        pos_ned_m = pos_ned_m + vel_ned_m_s * (period_ns / SECOND_NS)
        now_ns += period_ns
