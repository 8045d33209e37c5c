"""The wind that a mission may be flown in, and what it adds to r.

Gusts push two vehicles towards each other faster than the avoidance can take back, by so much and no more; that much is
added to r beside what positions may be off. Refuses a mission that leaves no room for the wind it allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from groundstation.core.damper import DamperParams
from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray
from groundstation.core.wind import GUST_TAU_S, blown_m, distance_deviation
from groundstation.mission.plan.profiles import VehicleProfile, approach_rate_1_s
from groundstation.mission.plan.schema import MissionSpec

_DEVIATIONS = 3.0
ROOM_SHARE = 0.9
"""Of the room that a formation leaves: more than that cannot be kept clear without locking everybody in."""
_CALM_M_S = 1.0  # mean wind that nobody reckons with
_UNASKED_SHARE = 0.6  # of it, where the mission names no limit: who has to squeeze past others forms late or never


@dataclass(frozen=True)
class WindLimit:
    """Wind up to which the distances hold.

    Attributes:
        mean_m_s: mean wind, horizontal.
        gust_m_s: standard deviation of the gusts, one axis.
    """

    mean_m_s: float
    gust_m_s: float

    def words(self) -> str:
        """For people."""
        return f"mean {self.mean_m_s:g} m/s, gusts {self.gust_m_s:g} m/s"


@dataclass(frozen=True)
class WindRoom:
    """What a mission has for the wind.

    Attributes:
        margin_m: what positions may be off, already part of what r is grown by.
        room_m: by how much the region can grow before the formation or the pads touch it.
        to_form_m: the same of the formation alone, in which the others move.
        to_wall_m: from each pad to the nearest wall of the fence, shape (n,).
        to_others_m: what r leaves between the nearest two pads of vehicles that a wind blows off differently.
        others: those two, by their place in the mission.
        lead_s: of the law.
    """

    margin_m: float
    room_m: float
    to_form_m: float
    to_wall_m: FloatArray
    to_others_m: float
    others: tuple[int, int]
    lead_s: float


def room_for_wind(
    spec: MissionSpec, pads_enu_m: FloatArray, *, margin_m: float, room_m: float, to_form_m: float, lead_s: float
) -> WindRoom:
    """Puts together what a mission has for the wind; arguments as in ``WindRoom``."""
    low, high = np.array(spec.fence.min_m)[:2], np.array(spec.fence.max_m)[:2]
    to_wall_m = np.minimum(pads_enu_m[:, :2] - low, high - pads_enu_m[:, :2]).min(axis=1)
    apart_m, others = _nearest_of_other_kinds(spec, pads_enu_m)
    return WindRoom(margin_m, room_m, to_form_m, to_wall_m, apart_m - spec.avoidance.radius_m, others, lead_s)


def _nearest_of_other_kinds(spec: MissionSpec, pads_enu_m: FloatArray) -> tuple[float, tuple[int, int]]:
    """Distance of the two nearest pads of vehicles of two kinds, and which; infinite where all are of one.

    Autopilots lift off at instants of their own (ArduCopter 0.4 to 0.8 s after PX4), by velocity or holding their
    place: one kind is blown off while the other still stands.
    """
    kinds = [(vehicle.autopilot, vehicle.profile) for vehicle in spec.vehicles]
    numbers = {kind: k for k, kind in enumerate(dict.fromkeys(kinds))}
    if len(numbers) == 1:
        return math.inf, (0, 0)
    kind = np.array([numbers[item] for item in kinds])
    nearest, pair = math.inf, (0, 0)
    for k in range(len(kinds) - 1):
        others = k + 1 + np.flatnonzero(kind[k + 1 :] != kind[k])
        if len(others):
            apart_m = np.linalg.norm(pads_enu_m[others] - pads_enu_m[k], axis=1)
            if apart_m.min() < nearest:
                nearest, pair = float(apart_m.min()), (k, int(others[apart_m.argmin()]))
    return nearest, pair


def wind_limit(spec: MissionSpec, profile: VehicleProfile, room: WindRoom) -> WindLimit:
    """The mission's own limits; where it has none, those of the profile as far as there is room for them."""
    given = spec.wind
    mean_m_s = given.mean_m_s
    if mean_m_s is None:
        mean_m_s = _mean_that_fits(spec, profile, room, profile.wind_mean_m_s)
    gust_m_s = given.gust_m_s
    if gust_m_s is None:
        ease = replace(room, room_m=min(room.room_m, _UNASKED_SHARE / ROOM_SHARE * room.to_form_m))
        gust_m_s = min(profile.wind_gust_m_s, _gust_that_fits(spec, profile, ease, mean_m_s))
    return WindLimit(mean_m_s, gust_m_s)


def _mean_that_fits(spec: MissionSpec, profile: VehicleProfile, room: WindRoom, most_m_s: float) -> float:
    """Largest mean wind, to half a m/s, that blows nobody over the fence or into another's region at takeoff.

    For others it is never less than what is no wind, as far as the fence allows that.
    """
    least_m = float(room.to_wall_m.min())
    for half in range(math.floor(2.0 * most_m_s), 0, -1):
        mean_m_s = most_m_s if half == math.floor(2.0 * most_m_s) else half / 2.0
        if blown_at_takeoff_m(profile, room.lead_s, spec.speed_limit_m_s, mean_m_s) > least_m:
            continue
        if mean_m_s <= _CALM_M_S or blown_nearer_m(spec, profile, room, mean_m_s) <= room.to_others_m:
            return mean_m_s
    return 0.0


def blown_nearer_m(spec: MissionSpec, profile: VehicleProfile, room: WindRoom, mean_m_s: float) -> float:
    """By how much two vehicles of different kinds may come nearer at takeoff: by the mean wind, and by gusts."""
    given = spec.wind.gust_m_s
    gust_m_s = profile.wind_gust_m_s if given is None else given
    gust_m = gust_m_s * _metres_per_gust(spec, profile, mean_m_s)
    return blown_at_takeoff_m(profile, room.lead_s, spec.speed_limit_m_s, mean_m_s) + gust_m


def _gust_that_fits(spec: MissionSpec, profile: VehicleProfile, room: WindRoom, mean_m_s: float) -> float:
    """Largest gusts, rounded down to 0.01 m/s, for which there is room."""
    left_m = math.sqrt(max((ROOM_SHARE * room.room_m) ** 2 - room.margin_m**2, 0.0))
    if math.isinf(left_m):  # nobody else flies
        return math.inf
    return max(math.floor(100.0 * left_m / _metres_per_gust(spec, profile, mean_m_s) - 1e-9) / 100.0, 0.0)


def gust_margin_m(spec: MissionSpec, profile: VehicleProfile, limit: WindLimit) -> float:
    """What gusts at the limit may take from a distance that the avoidance holds: three standard deviations.

    Args:
        spec: speed limit, rates.
        profile: the slowest vehicle, with the delay of the links.
        limit: the wind.
    """
    return limit.gust_m_s * _metres_per_gust(spec, profile, limit.mean_m_s)


def _metres_per_gust(spec: MissionSpec, profile: VehicleProfile, mean_m_s: float) -> float:
    params = DamperParams(
        radius_m=spec.avoidance.radius_m,
        margin_m=0.0,
        lag_s=profile.lag_s,
        delay_s=profile.delay_s,
        tick_s=1.0 / spec.rate_hz,
        speed_limit_m_s=spec.speed_limit_m_s,
        accel_limit_m_s2=profile.acceleration_max_m_s2,
    )
    frame = profile.airframe
    worst_s2 = max(
        distance_deviation(
            frame,
            tau_s,
            rate_1_s=params.rate_1_s,
            horizon_s=params.horizon_s,
            stale_s=params.delay_s + params.tick_s,
        )
        for tau_s in GUST_TAU_S
    )
    return _DEVIATIONS * worst_s2 * frame.slope_1_s(mean_m_s)


def sway_s2(profile: VehicleProfile, lead_s: float) -> float:
    """How far distances of a formation sway, three standard deviations, per m/s^2 of push by gusts.

    Reckoned for a law half as quick as a place is approached with: its slower modes sway more, its quicker ones less.

    Args:
        profile: the slowest vehicle, with the delay of the links.
        lead_s: of the law.
    """
    rate_1_s = 0.5 * approach_rate_1_s(profile, lead_s)
    stale_s = max(profile.delay_s, 1e-3)
    return _DEVIATIONS * max(
        distance_deviation(profile.airframe, tau_s, rate_1_s=rate_1_s, horizon_s=lead_s, stale_s=stale_s)
        for tau_s in GUST_TAU_S
    )


def blown_at_takeoff_m(profile: VehicleProfile, lead_s: float, speed_limit_m_s: float, mean_m_s: float) -> float:
    """How far a vehicle is blown from above its pad before it holds against the mean wind.

    While it climbs, half of the speed limit is what is left for going back.
    """
    rate_1_s = approach_rate_1_s(profile, lead_s)
    return blown_m(profile.airframe, mean_m_s, rate_1_s=rate_1_s, lead_s=lead_s, speed_m_s=0.5 * speed_limit_m_s)


def grown_by_m(margin_m: float, gust_m: float) -> float:
    """What r is grown by: what positions may be off and what gusts take are independent, and add in squares."""
    return math.hypot(margin_m, gust_m)


def check_wind(source: str, spec: MissionSpec, profile: VehicleProfile, limit: WindLimit, room: WindRoom) -> None:
    """Refuses a wind that the vehicles cannot stand against, or for which there is no room.

    Args:
        source: the mission's name.
        spec: the mission.
        profile: the slowest, with the delay of the links.
        limit: the wind.
        room: for it.

    Raises:
        UserError: with key, value, limit and remedy.
    """
    if limit.mean_m_s > profile.wind_mean_m_s:
        raise UserError(
            f"{source}: wind.mean_m_s: {limit.mean_m_s:g} m/s, maximum is {profile.wind_mean_m_s:g} m/s, what the"
            f" vehicles stand against ({profile.name}); allow less, or say in profiles what yours stand against"
            " (wind_mean_m_s)"
        )
    nearest = int(np.argmin(room.to_wall_m))
    wall_m = float(room.to_wall_m[nearest])
    blown = blown_at_takeoff_m(profile, room.lead_s, spec.speed_limit_m_s, limit.mean_m_s)
    if blown > wall_m and limit.mean_m_s > 0.0:
        able_m_s = _mean_that_fits(spec, profile, room, limit.mean_m_s)
        raise UserError(
            f"{source}: wind.mean_m_s: {limit.mean_m_s:g} m/s may blow a vehicle {blown:.1f} m aside at takeoff, and"
            f" vehicles[{nearest}].pad_m is {wall_m:.2g} m from the fence; {able_m_s:g} m/s could be allowed: allow"
            " less wind, enlarge the fence, or raise speed_limit_m_s"
        )
    nearer_m = blown_nearer_m(spec, profile, room, limit.mean_m_s)
    if nearer_m > room.to_others_m and limit.mean_m_s > _CALM_M_S:
        able_m_s = _mean_that_fits(spec, profile, room, limit.mean_m_s)
        pair = [spec.vehicles[k] for k in room.others]
        alike = pair[0].autopilot == pair[1].autopilot  # then it is the profile that tells them apart
        first, second = (f"{item.id} ({item.profile if alike else item.autopilot})" for item in pair)
        raise UserError(
            f"{source}: wind.mean_m_s: {limit.mean_m_s:g} m/s may bring vehicles {first} and {second} nearer by"
            f" {nearer_m:.2f} m at takeoff, since not all kinds lift off and are blown off alike; their pads leave"
            f" {max(room.to_others_m, 0.0):.2f} m beside avoidance.radius_m {spec.avoidance.radius_m:g} m;"
            f" {able_m_s:g} m/s could be allowed: allow less wind, or move pads of different kinds further apart"
        )
    gust_m = gust_margin_m(spec, profile, limit)
    together_m, left_m = grown_by_m(room.margin_m, gust_m), ROOM_SHARE * room.room_m
    if together_m > max(left_m, room.margin_m):
        able_m_s = _gust_that_fits(spec, profile, room, limit.mean_m_s)
        raise UserError(
            f"{source}: wind.gust_m_s: {limit.gust_m_s:g} m/s with a mean of {limit.mean_m_s:g} m/s may bring two"
            f" vehicles nearer by {gust_m:.2f} m, {together_m:.2f} m with what positions are off; the formation and the"
            f" pads leave {left_m:.2f} m of room around avoidance.radius_m {spec.avoidance.radius_m:g} m; gusts of"
            f" {able_m_s:g} m/s could be allowed: allow weaker gusts or less mean wind, lower radius_m, or move further"
            " apart"
        )
