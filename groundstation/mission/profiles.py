"""What a kind of vehicle can do, as far as the control law has to know it.

The figures are step responses seen on real firmware; they set the control gain and the avoidance. A mission may
name another profile for each of its vehicles, and the slowest one counts for the team.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class VehicleProfile:
    """How a vehicle follows a velocity setpoint.

    Attributes:
        name: as missions call it.
        lag_s: time constant tau of its velocity loop (t63 less the delay).
        delay_s: from the telemetry's instant to the setpoint taking effect.
        acceleration_max_m_s2: what it reaches horizontally while holding height.
        position_error_m: standard deviation of its position estimate against the others', one axis.
        half_height_m: how far above and below it downwash is felt; for safety regions that are no spheres.
    """

    name: str
    lag_s: float
    delay_s: float
    acceleration_max_m_s2: float
    position_error_m: float
    half_height_m: float


_CRAZYFLIE_HALF_HEIGHT_M = 0.75
"""Twice the 0.375 m that Crazyswarm takes for each of two Crazyflies (docs/avoidance.md)."""
_HALF_METRE_HALF_HEIGHT_M = 4.0
"""The same for multirotors of 0.5 m and propellers of 0.25 m: downwash grows with the size of the vehicle."""

PROFILES: dict[str, VehicleProfile] = {
    profile.name: profile
    for profile in (
        VehicleProfile("crazyflie", 0.2, 0.05, 4.0, position_error_m=0.01, half_height_m=_CRAZYFLIE_HALF_HEIGHT_M),
        VehicleProfile("px4_quad", 1.0, 0.1, 3.0, position_error_m=0.02, half_height_m=_HALF_METRE_HALF_HEIGHT_M),
        VehicleProfile("arducopter", 0.9, 0.1, 2.5, position_error_m=0.02, half_height_m=_HALF_METRE_HALF_HEIGHT_M),
    )
}


def slowest(profiles: Iterable[VehicleProfile]) -> VehicleProfile:
    """The profile that every vehicle of a mixed team can keep: the worst of each figure."""
    items = list(profiles)
    return VehicleProfile(
        name="+".join(sorted({item.name for item in items})),
        lag_s=max(item.lag_s for item in items),
        delay_s=max(item.delay_s for item in items),
        acceleration_max_m_s2=min(item.acceleration_max_m_s2 for item in items),
        position_error_m=max(item.position_error_m for item in items),
        half_height_m=max(item.half_height_m for item in items),
    )
