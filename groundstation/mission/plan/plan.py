"""A mission that has been read and judged: everything that the flight needs to know of it.

Positions in the file are ENU in one team frame; the plan keeps them so, and the runner turns them to NED once.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from groundstation.core.compensation import Compensator
from groundstation.core.formation import Formation
from groundstation.core.obstacles import Obstacles
from groundstation.core.regions import SafetyRegion, build_region
from groundstation.core.types import FloatArray, IntArray
from groundstation.mavlink.autopilot import Autopilot
from groundstation.mission.plan.limits import Limits
from groundstation.mission.plan.links import LinkPlan
from groundstation.mission.plan.own_code import OwnCode
from groundstation.mission.plan.positioning import (
    all_offsets,
)
from groundstation.mission.plan.profiles import VehicleProfile, approach_rate_1_s, slowest
from groundstation.mission.plan.schema import MissionSpec
from groundstation.mission.plan.stages import FormationPlan, roles_for
from groundstation.mission.plan.wind import WindLimit, grown_by_m

_KEEP_PLACE_1_S = 0.1


@dataclass(frozen=True)
class MissionPlan(LinkPlan, FormationPlan):
    """A mission that has passed every check that needs no vehicle.

    Attributes:
        source: the file's name, for messages.
        vehicle_profiles: figures of each vehicle.
        profile: the slowest vehicle's figures, with the delay of the links and the error of the positions.
        lead_s: how far ahead motion counts in the law, see ``formation_control``.
        positioning: mocap, rtk or gps.
        margin_m: what two positions may be off against each other.
        wind: up to which wind the mission is flown.
        gust_margin_m: what its gusts may take from a distance; r and d are grown by ``keep_out_margin_m``, for both.
        autopilots: one per vehicle.
        pads_enu_m: shape (n, 3), team frame.
        min_altitude_m: nobody who flies the formation goes below, above the team frame's ground.
        acceleration_limit_m_s2: how fast commanded velocities may change.
        limits: resolved.
        own_code: laws and avoidance that are not ours, by the mission's key.
    """

    source: str
    vehicle_profiles: tuple[VehicleProfile, ...]
    profile: VehicleProfile
    lead_s: float
    positioning: str
    margin_m: float
    wind: WindLimit
    gust_margin_m: float
    autopilots: tuple[Autopilot, ...]
    pads_enu_m: FloatArray
    min_altitude_m: float
    acceleration_limit_m_s2: float
    limits: Limits
    own_code: Mapping[str, OwnCode] = field(default_factory=dict)

    @cached_property
    def region(self) -> SafetyRegion:
        """What is kept clear around every vehicle, without the margin."""
        return region_of(self.spec, self.profile)

    @cached_property
    def pad_roles(self) -> IntArray:
        """Role per vehicle from the pads, shape (n,): known before anybody has reported a position."""
        return roles_for(self.stages[self.stage_of_step[0]], self.pads_enu_m)

    @cached_property
    def room_with_pads_m(self) -> float:
        """What the formations and the pads leave between two safety regions at least."""
        return min(self.room_m, self.region.room_m(all_offsets(self.pads_enu_m)))

    @cached_property
    def keep_out_margin_m(self) -> float:
        """What is added to r and d, as far as there is room: for positions that are off, and for gusts."""
        return grown_by_m(self.margin_m, self.gust_margin_m)

    @cached_property
    def obstacles(self) -> Obstacles:
        """What stands in the way, team frame ENU, with r and what positions and gusts may take."""
        bodies = tuple(given.body for given in self.spec.obstacles)
        return Obstacles(bodies, self.spec.avoidance.radius_m + self.keep_out_margin_m)

    @cached_property
    def keep_place_1_s(self) -> float:
        """Share of the team's offset from its place that is taken back in a second: slow against every lag."""
        given = self.spec.keep_place_1_s
        return _KEEP_PLACE_1_S / max(1.0, self.profile.lag_s + self.profile.delay_s) if given == "auto" else given

    @cached_property
    def moved(self) -> bool:
        """Whether the formation is moved, by the mission or by the operator: where it stands in the end is open."""
        return bool(self.moves) or any(step.lead is not None for step in self.spec.steps)

    @cached_property
    def slowness(self) -> float:
        """How many times more gently points are approached because of the links' delay; 1 without any."""
        own = replace(self.profile, delay_s=slowest(self.vehicle_profiles).delay_s)
        return approach_rate_1_s(own, self.lead_s) / approach_rate_1_s(self.profile, self.lead_s)

    def compensator(self) -> Compensator | None:
        """What shapes the commands of one flight; None where they go as they are."""
        responses = [profile.response for profile in self.vehicle_profiles]
        if not any(responses):
            return None
        lags_s = np.array([profile.lag_s for profile in self.vehicle_profiles])
        return Compensator(responses, lags_s, 1.0 / self.spec.rate_hz, self.spec.speed_limit_m_s)

    def record(self) -> dict[str, Any]:
        """The mission with everything resolved, as plain values, for the manifest beside the log."""
        values = self.spec.model_dump(mode="json", exclude={"formation", "gains"}, exclude_none=True)
        own = {number for number, step in enumerate(self.spec.steps) if step.form is not None and step.form.own_shape}
        shapes = []
        for number in sorted(own):
            shape = self.stages[self.stage_of_step[number]].shape
            form = values["steps"][number][self.spec.steps[number].kind]
            form.pop("gains", None)
            form["formation"] = shape.formation.name
            encoded = base64.b64encode(shape.gains_npz).decode()
            shapes.append({"step": number, "formation": _plain(shape.formation), "gains_npz_base64": encoded})
        for item, vehicle, sysid in zip(values["vehicles"], self.spec.vehicles, self.sysids, strict=True):
            if sysid != vehicle.id:
                item["sysid"] = sysid
        code = {key: item.record() for key, item in self.own_code.items()}
        beside = {**({"shapes": shapes} if shapes else {}), **({"own_code": code} if code else {})}
        formation = _plain(self.formation) if self.spec.formation is not None else None
        return {**values, "formation": formation, **beside}


def region_of(spec: MissionSpec, profile: VehicleProfile) -> SafetyRegion:
    """What is kept clear around every vehicle, without the margin."""
    given = spec.avoidance
    half_height_m = profile.half_height_m if given.half_height_m is None else given.half_height_m
    return build_region(given.shape, given.radius_m, given.activation_m, half_height_m)


def _plain(formation: Formation) -> dict[str, Any]:
    """A formation as a formation file has it, scale applied."""
    return {
        "name": formation.name,
        "scale": 1.0,
        "points": formation.points_enu_m.tolist(),
        "edges": [[i + 1, j + 1] for i, j in formation.edges],
    }
