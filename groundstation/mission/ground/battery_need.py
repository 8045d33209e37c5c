"""How much of its battery a mission takes, and what has to be there before it begins.

The flight is reckoned as it is planned: climb, way to the formation, holds, way back, landing, with times as long as
they were seen to be at most. Hovering endurance comes from the vehicle's profile or the mission (``endurance_s``). What
has to be there is that, with a third on top, and a reserve: ``limits.battery_min``, at which the team is brought home,
or what the way home without a ground station takes, where that is more. Refuses to know batteries: an old one wants a
shorter ``endurance_s``.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from groundstation.core.assignment import fixed_roles
from groundstation.core.types import FloatArray
from groundstation.mission.ground.failsafe import FailsafePlan
from groundstation.mission.plan.plan import MissionPlan

_SPARE = 4.0 / 3.0
_DETOUR = 2.0  # ways in a formation are no straight lines: everybody gives way
_SETTLE_S = 6.0  # to slow down, and to be believed to stand
_LANDING_M_S, _LANDED_S = 0.4, 6.0


@dataclass(frozen=True)
class BatteryNeed:
    """What one vehicle's battery has to hold.

    Attributes:
        flight_s: how long the mission is reckoned to take.
        flight: share of the battery for that, spare included.
        reserve: share that stays.
        endurance_s: that they are shares of.
    """

    flight_s: float
    flight: float
    reserve: float
    endurance_s: float

    @property
    def share(self) -> float:
        """What has to be there at the start, 0 to 1, or more than any battery has."""
        return self.flight + self.reserve

    def words(self) -> str:
        """How it comes about."""
        return (
            f"the mission of about {self.flight_s:.0f} s needs {self.share:.0%}: {self.flight:.0%} to fly, a third on"
            f" top in that ({self.endurance_s:g} s of hovering are a whole battery), and {self.reserve:.0%} in"
            " reserve"
        )


def flight_time_s(plan: MissionPlan, failsafe: FailsafePlan) -> float:
    """How long the mission takes from takeoff to landing."""
    speed_m_s = plan.spec.speed_limit_m_s
    height_m = plan.spec.takeoff.height_m + plan.spec.takeoff.stagger_m / 2.0
    gathered = plan.pads_enu_m + np.array([0.0, 0.0, plan.spec.takeoff.height_m])
    there = fixed_roles(gathered, plan.formation, failsafe.roles).targets_team_enu_m(plan.formation)
    way_m = float(np.linalg.norm(there - gathered, axis=1).max())
    slow_m_s = min(speed_m_s, plan.profile.cruise_m_s)
    move_s = _DETOUR * way_m / slow_m_s + _SETTLE_S + 3.0 * plan.profile.lag_s
    total_s = height_m / min(speed_m_s, plan.profile.climb_m_s) + _SETTLE_S
    total_s += sum(step.longest_s(move_s) for step in plan.spec.steps)
    total_s += _places_way_m(plan, gathered.mean(axis=0)) / slow_m_s + _SETTLE_S * len(plan.places_enu_m)
    return total_s + move_s + height_m / _LANDING_M_S + _LANDED_S


def _places_way_m(plan: MissionPlan, from_m: FloatArray) -> float:
    """The way through all places that are flown to, and back."""
    stops = [from_m, *(place for number in sorted(plan.places_enu_m) for place in plan.places_enu_m[number]), from_m]
    return float(sum(np.linalg.norm(there - here) for here, there in itertools.pairwise(stops)))


def battery_needs(plan: MissionPlan, failsafe: FailsafePlan) -> tuple[BatteryNeed, ...]:
    """What each vehicle's battery has to hold."""
    flight_s = flight_time_s(plan, failsafe)
    needs = []
    for spec, profile in zip(plan.spec.vehicles, plan.vehicle_profiles, strict=True):
        endurance_s = spec.endurance_s or profile.endurance_s
        alone = failsafe.down_s / endurance_s if math.isfinite(failsafe.down_s) else 0.0
        needs.append(
            BatteryNeed(
                flight_s, _SPARE * flight_s / endurance_s, max(plan.spec.limits.battery_min, alone), endurance_s
            )
        )
    return tuple(needs)
