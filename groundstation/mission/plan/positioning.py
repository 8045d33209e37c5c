"""How well the team knows where it is, and what that leaves of r and of the tolerance.

The avoidance keeps *reported* distances above r plus a margin. The margin is what two positions may be off against
each other: then true distances stay above r. Refuses a mission whose formation or pads leave no room for it, and one
that wants to be formed more closely than vehicles that wander by GPS can be over its links.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.regions import SafetyRegion
from groundstation.core.types import FloatArray
from groundstation.mission.plan.schema import MissionSpec

POSITION_ERROR_M = {"mocap": 0.01, "rtk": 0.03, "gps": 0.24}
"""Standard deviation of a position, one axis, by source. GPS: vehicles side by side wander by up to 1 m against
each other, which is three standard deviations of a difference."""
SMOOTHED_1_S = {"mocap": 0.5, "rtk": 0.5, "gps": 1.0}
"""How fast reported positions draw the places to them that the law is shown (`core.smoothing`), by source: what the
velocity wanders by against what the position does. GPS: its velocities are wrong for seconds."""
_WANDER_M_S = 0.04
"""Standard deviation of a velocity that GPS and IMU do not notice: at zero command vehicles were seen to wander by up
to 2.5 m a minute."""
DEVIATIONS = 3.0
_TINY = 1e-6


def margin_m(position_error_m: float) -> float:
    """What is added to r: three standard deviations of the distance of two positions that are off on their own."""
    return DEVIATIONS * math.sqrt(2.0) * position_error_m


def margin_deviations(position_error_m: float, velocity_error_m_s: float, horizon_s: float) -> float:
    """How many standard deviations the margin is of what the damper counts with, both errors together.

    It holds d + T d' against r: the error of a distance and T times that of its rate, which add in squares where they
    are independent. The margin knows of the first alone.

    Args:
        position_error_m: standard deviation of a position, one axis, > 0.
        velocity_error_m_s: of a velocity, one axis, lasting; what changes from tick to tick costs far less.
        horizon_s: T.
    """
    combined_m = math.sqrt(2.0) * math.hypot(position_error_m, horizon_s * velocity_error_m_s)
    return margin_m(position_error_m) / combined_m


def tolerance_min_m(rate_1_s: float) -> float:
    """How far off a distance stays under a law that takes errors back at a rate, both vehicles wandering by GPS."""
    return DEVIATIONS * math.sqrt(2.0) * _WANDER_M_S / rate_1_s


def check_tolerances(source: str, spec: MissionSpec, rate_1_s: float) -> None:
    """Refuses a formation that GPS and the links' delay would never let come true.

    Args:
        source: the mission's name.
        spec: steps and link delay.
        rate_1_s: of the approach, which a delay lowers.

    Raises:
        UserError: with the tolerance that can be reached.
    """
    least_m = math.ceil(100.0 * tolerance_min_m(rate_1_s)) / 100.0
    for number, step in enumerate(spec.steps):
        if step.form is not None and step.form.tolerance_m < least_m:
            raise UserError(
                f"{source}: steps[{number}].{step.kind}.tolerance_m: {step.form.tolerance_m:g} m, minimum is"
                f" {least_m:g} m:"
                f" vehicles wander by GPS, and with the delay of these links (link_delay_s: {spec.link_delay_s:g}) that"
                " is taken back slowly; widen the tolerance, or use quicker links"
            )


def check_radius(
    source: str,
    places: Mapping[str, FloatArray],
    *,
    region: SafetyRegion,
    position_error_m: float,
    positioning: str,
    others: Mapping[str, FloatArray] | None = None,
) -> None:
    """Refuses an r that the positions cannot keep.

    Args:
        source: the mission's name.
        places: points that the vehicles stand or hover at, shape (n, 3) each, by what they are: formations, pads.
        region: with r.
        position_error_m: standard deviation, one axis.
        positioning: name of the source, for messages.
        others: places that are judged elsewhere; the r that is named can be kept there too.

    Raises:
        UserError: with the r that could be kept everywhere, or that there is none.
    """
    margin = margin_m(position_error_m)
    rooms_m = {what: region.room_m(all_offsets(points)) for what, points in places.items()}
    what = min(rooms_m, key=lambda name: rooms_m[name])
    if margin < rooms_m[what]:
        return
    everywhere = [all_offsets(points) for points in (*places.values(), *(others or {}).values())]
    r = f"{source}: avoidance.radius_m: {region.radius_m:g} m"
    apart = f"move further apart, or use better positions than {positioning} (positioning, position_error_m)"
    if not region.by_distance:
        tiny = _shrunk(region)
        helps = min(tiny.room_m(offsets) for offsets in everywhere) > margin
        smaller = "lower radius_m or half_height_m, or move further apart"
        raise UserError(
            f"{r} with the {region.name} cannot be kept with {positioning} positions: two of them may be"
            f" {margin:.2f} m off against each other, and around the {region.name} there are"
            f" {max(rooms_m[what], 0.0):.2g} m of room in the {what};"
            f" {smaller if helps else f'no size could be kept: {apart}'}"
        )
    shortest = rooms_m[what] + region.radius_m
    least = min(region.room_m(offsets) for offsets in everywhere) + region.radius_m
    able = math.floor(100.0 * (least - margin) - 1e-9) / 100.0
    remedy = f"an r of {able:g} m could be kept: lower r, or move further apart"
    if able <= 0.0:
        remedy = f"no r could be kept: {apart}"
    raise UserError(
        f"{r} cannot be kept with {positioning} positions: two of"
        f" them may be {margin:.2f} m off against each other, and the shortest distance of the {what} is"
        f" {shortest:.3g} m; {remedy}"
    )


def _shrunk(region: SafetyRegion) -> SafetyRegion:
    """A region of the same shape that is next to nothing: what would be left if r were lowered as far as can be."""
    lengths = {field.name: _TINY * getattr(region, field.name) for field in fields(region)}
    return replace(region, **lengths)


def all_offsets(points_m: FloatArray) -> FloatArray:
    """From each point to each later one, shape (n (n - 1) / 2, 3)."""
    first, second = np.triu_indices(len(points_m), 1)
    return np.asarray(points_m[second] - points_m[first], dtype=np.float64)
