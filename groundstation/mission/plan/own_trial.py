"""Asks a law and an avoidance of one's own once before anything flies: what always fails is found on the desk."""

from __future__ import annotations

import numpy as np

from groundstation.core import frames
from groundstation.core.control import saturate, task_for_roles
from groundstation.core.errors import UserError
from groundstation.core.law import OwnAvoidance, OwnCodeError, OwnLaw, seen_by
from groundstation.core.views import local_views
from groundstation.mission.plan.own_code import AVOIDANCE, LAW
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.stages import roles_for


def check_own_code(plan: MissionPlan) -> None:
    """Lets what the mission names answer for every formation: in its place, and above the pads.

    Raises:
        UserError: it fails, or does not answer with a velocity for each vehicle.
    """
    own, spec, n = plan.own_code, plan.spec, plan.size
    ids = [vehicle.id for vehicle in spec.vehicles]
    key = LAW
    try:
        for stage in plan.stages if own else ():
            gather = plan.pads_enu_m + np.array([0.0, 0.0, spec.takeoff.height_m])
            roles = roles_for(stage, gather)
            for places_enu_m in (stage.formation.points_enu_m[roles], gather):
                views = local_views(
                    frames.ned_from_enu(places_enu_m),
                    np.zeros((n, 3)),
                    np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
                    np.ones((n, n), dtype=np.bool_),
                )
                wish_flu_m_s = np.full((n, 3), 0.1)
                if LAW in own:
                    key = LAW
                    seen = seen_by(
                        views,
                        task_for_roles(stage.formation, stage.shape.gains, roles),
                        stage.scale,
                        stage.control_gain,
                        lead_s=plan.lead_s,
                        upright_1_s=stage.upright_1_s,
                        speed_limit_m_s=spec.speed_limit_m_s,
                        period_s=1.0 / spec.rate_hz,
                    )
                    wish_flu_m_s = OwnLaw(own[LAW].use, own[LAW].make(), ids)(seen)
                if AVOIDANCE in own:
                    key = AVOIDANCE
                    wish_flu_m_s = saturate(wish_flu_m_s, spec.speed_limit_m_s)
                    OwnAvoidance(own[AVOIDANCE].use, own[AVOIDANCE].make(), ids)(views, wish_flu_m_s, plan.region)
    except OwnCodeError as error:
        raise UserError(
            f"{plan.source}: {key}: {error}; asked for formation {stage.formation.name} before the flight, nothing"
            " was armed"
        ) from None
