"""The limits of a mission, resolved once: what the file leaves open follows from its other values."""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.mission.plan.schema import MissionSpec


@dataclass(frozen=True)
class Limits:
    """Limits that the file may leave open.

    Attributes:
        pad_error_m: how far from its pad a vehicle may report to stand.
        frame_drift_m: how far a vehicle's two positions, local and global, may drift apart.
        pose_jump_m: how far a vehicle's positions may move otherwise than its velocities say.
        tracking_m_s: how far a vehicle's velocity may be off what it was told, over a second.
        lost_radius_m: how much larger than r an obstacle that nobody sees may become.
        battery_warn: share of the battery below which people are told.
        battery_land: share of the battery below which a vehicle lands where it is.
        battery_land_v: the same in volts; None without.
    """

    pad_error_m: float
    frame_drift_m: float
    pose_jump_m: float
    tracking_m_s: float
    lost_radius_m: float
    battery_warn: float
    battery_land: float
    battery_land_v: float | None


def resolve_limits(spec: MissionSpec, *, margin_m: float, positioning: str) -> Limits:
    """Works out what the file leaves open.

    Args:
        spec: the mission.
        margin_m: what two positions may be off against each other.
        positioning: mocap, rtk or gps.
    """
    given = spec.limits
    # Half of r, so that a drift is found before it takes away what keeps vehicles apart; what two positions may be
    # off; and what 0.2 s of badly known time make of the speed.
    jump_m = min(0.5, 0.5 * spec.avoidance.radius_m) + margin_m + 0.2 * spec.speed_limit_m_s
    low_v = given.battery_min_v
    return Limits(
        pad_error_m=given.pad_error_m or 0.3 + (margin_m if positioning == "gps" else 0.0),
        frame_drift_m=given.frame_drift_m or 0.5 + margin_m,
        pose_jump_m=given.pose_jump_m or jump_m,
        tracking_m_s=given.tracking_m_s or max(0.3, 0.6 * spec.speed_limit_m_s),
        lost_radius_m=0.5 * spec.avoidance.radius_m if given.lost_radius_m is None else given.lost_radius_m,
        battery_warn=min(given.battery_min + 0.1, 0.99) if given.battery_warn is None else given.battery_warn,
        battery_land=0.5 * given.battery_min if given.battery_land is None else given.battery_land,
        battery_land_v=0.95 * low_v if given.battery_land_v is None and low_v is not None else given.battery_land_v,
    )
