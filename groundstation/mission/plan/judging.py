"""Judges the values of a mission together and puts the plan together; what is wrong is refused with its remedy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

import numpy as np

from groundstation.core.choices import unknown
from groundstation.core.compensation import AxisResponse, Response
from groundstation.core.errors import UserError
from groundstation.core.formation import Formation
from groundstation.core.metrics import near_pairs
from groundstation.core.regions import SafetyRegion
from groundstation.core.types import FloatArray
from groundstation.core.wind import Airframe
from groundstation.mavlink.addresses import parse_address
from groundstation.mavlink.autopilots import AUTOPILOTS
from groundstation.mission.plan.limits import resolve_limits
from groundstation.mission.plan.links import (
    POSE_HZ,
    check_crtp,
    check_signing,
    check_system_ids,
    fit_links,
    mavlink_link,
    read_forward,
    room_link,
)
from groundstation.mission.plan.own_code import AVOIDANCE, LAW, CodeSource
from groundstation.mission.plan.plan import MissionPlan, region_of
from groundstation.mission.plan.positioning import (
    POSITION_ERROR_M,
    all_offsets,
    check_radius,
    check_tolerances,
    margin_m,
)
from groundstation.mission.plan.profile_spec import ResponseSpec
from groundstation.mission.plan.profiles import (
    PROFILES,
    VehicleProfile,
    approach_rate_1_s,
    compensated,
    compensated_lag_s,
    lead_s_for,
    quiet_lag_s,
    slowest,
)
from groundstation.mission.plan.schema import MissionSpec
from groundstation.mission.plan.stages import Shape, check_clearance, check_order, check_shape, make_stages, plan_moves
from groundstation.mission.plan.vehicle_spec import VehicleSpec
from groundstation.mission.plan.wind import check_wind, gust_margin_m, room_for_wind, wind_limit

_DAMPING_MIN = 0.7
_LAG_SHARES = (0.6, 1.6)
"""63 % of a step horizontally after so many times the lag, at least and at most, says a response that goes with it."""


def build_plan(
    spec: MissionSpec,
    first: Shape,
    source: str,
    others: Mapping[int, Shape] | None = None,
    code: CodeSource | None = None,
) -> MissionPlan:
    """Puts a plan together from values that are valid each for itself, and judges them together.

    Args:
        spec: the mission.
        first: the formation at its top.
        source: the file's name, for messages.
        others: formations of ``form`` steps that name their own, by number of the step.
        code: where laws and avoidance that are not ours are looked for; what is installed only when None.

    Raises:
        UserError: they do not fit each other.
    """
    pads = np.array([vehicle.pad_m for vehicle in spec.vehicles], dtype=np.float64)
    check_order(spec, source)
    shapes = {"formation": first} | {
        f"steps[{number}].{spec.steps[number].kind}": shape for number, shape in (others or {}).items()
    }
    profiles = known_profiles(spec, source)
    _check_vehicles(spec, first.formation, source, profiles)
    vehicle_profiles = tuple(_as_followed(spec, item, profiles) for item in spec.vehicles)
    compensation_s = compensated_lag_s(spec, vehicle_profiles)
    vehicle_profiles = tuple(compensated(item, compensation_s) for item in vehicle_profiles)
    _check_compensation(spec, vehicle_profiles, compensation_s, source)
    profile = slowest(vehicle_profiles)
    if spec.avoidance.activation_m < spec.avoidance.radius_m:
        raise UserError(
            f"{source}: avoidance.activation_m: {spec.avoidance.activation_m} m is less than avoidance.radius_m"
            f" {spec.avoidance.radius_m} m; make it as large at least"
        )
    region = region_of(spec, profile)
    _check_pads(spec, pads, region, source)
    formed = {key: shape for key, shape in shapes.items() if shape.formed}
    for key, shape in formed.items():
        check_shape(spec, shape.formation, region, floor_m=_floor(spec), source=source, key=key)
    _check_takeoff(spec, pads, source)
    _check_upload(spec, source)
    check_crtp(spec, source)
    check_system_ids(spec, source)
    link_of = [mavlink_link(spec, vehicle) for vehicle in spec.vehicles]
    links = tuple(dict.fromkeys(link_of))
    addresses = tuple(parse_address(link) for link in links)
    check_signing(spec, addresses, source)
    rates = fit_links(spec, addresses, source)
    gps = any(vehicle.uses_gps for vehicle in spec.vehicles)
    room_at = room_link(spec, addresses, source)
    positioning = "mocap" if room_at is not None else str(spec.positioning or ("gps" if gps else "mocap"))
    if spec.traffic is not None and not gps:
        raise UserError(
            f"{source}: traffic: places of aircraft are on earth, and no vehicle's are: give one `origin: gps` or"
            " `position: global`, or leave traffic out"
        )
    position_error_m = spec.position_error_m or max(POSITION_ERROR_M[positioning], profile.position_error_m)
    formations = {key: shape.formation.points_enu_m for key, shape in formed.items()}
    if not formed:
        check_radius(source, {"pads": pads}, region=region, position_error_m=position_error_m, positioning=positioning)
    for key, shape in formed.items():
        of_all = {"pads": pads} if key == "formation" else {}
        check_radius(
            source if key == "formation" else f"{source}: {key}",
            {f"formation {shape.formation.name}": shape.formation.points_enu_m} | of_all,
            region=region,
            position_error_m=position_error_m,
            positioning=positioning,
            others=formations | {"pads": pads},
        )
    # Positions are brought to the tick with their velocity; what was not yet said of it counts as delay, and so does
    # the time until the next setpoint.
    waits_s = max(1.0 / rate.setpoint_hz + 0.5 / rate.pose_hz for rate in rates) - 1.0 / spec.rate_hz - 0.5 / POSE_HZ
    profile = replace(
        profile,
        delay_s=profile.delay_s + spec.link_delay_s + max(waits_s, 0.0),
        position_error_m=position_error_m,
    )
    lead_s = lead_s_for(spec, profile)
    if positioning == "gps":
        # By the whole lead: teams that look less far ahead were seen to form within these tolerances all the same.
        check_tolerances(source, spec, approach_rate_1_s(profile, profile.lag_s if spec.lead_s == "auto" else lead_s))
    acceleration_limit_m_s2 = spec.acceleration_limit_m_s2 or profile.acceleration_max_m_s2
    stages, stage_of_step = make_stages(spec, first, others or {}, profile, lead_s, source=source)
    moves, places, room_m = plan_moves(
        spec,
        stages,
        stage_of_step,
        region=region,
        pads_enu_m=pads,
        floor_m=_floor(spec),
        acceleration_limit_m_s2=min(acceleration_limit_m_s2, profile.acceleration_max_m_s2),
        position_error_m=position_error_m,
        positioning=positioning,
        source=source,
    )
    room = room_for_wind(
        spec,
        pads,
        margin_m=margin_m(position_error_m),
        room_m=min(room_m, region.room_m(all_offsets(pads))),
        to_form_m=room_m,
        lead_s=lead_s,
    )
    wind = wind_limit(spec, profile, room)
    return MissionPlan(
        spec=spec,
        source=source,
        stages=stages,
        stage_of_step=stage_of_step,
        moves=moves,
        places_enu_m=places,
        room_m=room_m,
        vehicle_profiles=vehicle_profiles,
        profile=profile,
        lead_s=lead_s,
        links=links,
        addresses=addresses,
        link_of_vehicle=tuple(map(links.index, link_of)),
        rates=rates,
        forward=read_forward(spec, addresses, source),
        room_link=room_at,
        positioning=positioning,
        margin_m=margin_m(position_error_m),
        wind=wind,
        gust_margin_m=gust_margin_m(spec, profile, wind),
        autopilots=tuple(AUTOPILOTS[vehicle.autopilot] for vehicle in spec.vehicles),
        pads_enu_m=pads,
        min_altitude_m=_floor(spec),
        acceleration_limit_m_s2=acceleration_limit_m_s2,
        limits=resolve_limits(spec, margin_m=margin_m(position_error_m), positioning=positioning),
        own_code={
            key: (code or CodeSource()).find(key, named.use, named.options, source)
            for key, named in ((LAW, spec.law), (AVOIDANCE, spec.avoidance.law))
            if named is not None
        },
    )


def check_acceleration(plan: MissionPlan) -> None:
    """Refuses setpoints that change faster than vehicles can follow, for which the damper takes them to be near.

    Not for records: what was flown with an earlier version can still be replayed.

    Raises:
        UserError: with the profile's figure and the remedy.
    """
    limit, profile = plan.acceleration_limit_m_s2, plan.profile
    if limit > profile.acceleration_max_m_s2:
        raise UserError(
            f"{plan.source}: acceleration_limit_m_s2: {limit:g} m/s^2, maximum is {profile.acceleration_max_m_s2:g}"
            f" m/s^2, what the slowest vehicle reaches ({profile.name}): r is kept with vehicles that can follow their"
            " setpoints; leave it out, or say in profiles what your vehicles reach (acceleration_max_m_s2)"
        )


def check_room_for_wind(plan: MissionPlan) -> None:
    """Refuses a wind for which there is no room; not for records either."""
    room = room_for_wind(
        plan.spec,
        plan.pads_enu_m,
        margin_m=plan.margin_m,
        room_m=plan.room_with_pads_m,
        to_form_m=plan.room_m,
        lead_s=plan.lead_s,
    )
    check_wind(plan.source, plan.spec, plan.profile, plan.wind, room)


def known_profiles(spec: MissionSpec, source: str) -> dict[str, VehicleProfile]:
    """The profiles that come along and those of the mission.

    Raises:
        UserError: one of the mission's is like none that is known.
    """
    profiles = dict(PROFILES)
    for name, given in spec.profiles.items():
        like = given.like or name
        if like not in PROFILES:
            raise UserError(
                f"{source}: profiles.{name}.like: {like} is not known; name one of {', '.join(PROFILES)}, whose other"
                " figures it has"
            )
        figures = given.model_dump(exclude={"like", "response"}, exclude_none=True)
        figures["settle_s"] = figures.pop("wind_settle_s", PROFILES[like].airframe.settle_s)
        air = {field.name: figures.pop(field.name) for field in fields(Airframe) if field.name in figures}
        airframe = replace(PROFILES[like].airframe, **air)
        known = replace(PROFILES[like], name=name, airframe=airframe, **figures)
        known = replace(known, lag_up_s=min(known.lag_up_s, known.lag_s))  # upward nobody is slower
        # With another lag or drag it is not the velocity loop that is known.
        same = known.lag_s == PROFILES[like].lag_s and airframe.drag_1_s == PROFILES[like].airframe.drag_1_s
        profiles[name] = known if same else replace(known, response=None)
        if given.response is not None:
            response = _response(given.response, known.lag_s, f"{source}: profiles.{name}.response")
            profiles[name] = replace(known, response=response)
    return profiles


def _response(given: ResponseSpec, lag_s: float, key: str) -> Response:
    """How a vehicle answers by itself, as a mission says.

    Raises:
        UserError: it swings, or is of another vehicle than the lag.
    """
    axes = {name: AxisResponse(**getattr(given, name).model_dump()) for name in ("horizontal", "vertical")}
    for name, axis in axes.items():
        if axis.damping < _DAMPING_MIN:
            raise UserError(
                f"{key}.{name}: damping {axis.damping:.2f}, minimum is {_DAMPING_MIN:g}: the inverse of a loop that"
                " swings asks for what no vehicle can do; leave response out, its setpoints then go as they are"
            )
        least_s = _LAG_SHARES[0] * lag_s if name == "horizontal" else 0.0
        if not least_s <= axis.t63_s() <= _LAG_SHARES[1] * lag_s:
            raise UserError(
                f"{key}.{name}: 63 % of a step after {axis.t63_s():.2f} s, limits {least_s:.2f} and"
                f" {_LAG_SHARES[1] * lag_s:.2f} s for a lag_s of {lag_s:g} s: they tell of different vehicles; take"
                " both from one gs identify, or leave response out"
            )
    return Response(**axes, lag_s=lag_s)


def _as_followed(spec: MissionSpec, vehicle: VehicleSpec, profiles: Mapping[str, VehicleProfile]) -> VehicleProfile:
    """The profile of a vehicle, with what is known of the velocity loop of its autopilot's own firmware."""
    profile, autopilot = profiles[vehicle.profile], AUTOPILOTS.get(vehicle.autopilot)
    own = autopilot is not None and vehicle.profile == autopilot.profile and vehicle.profile not in spec.profiles
    if autopilot is None or autopilot.follows is None or not own:
        return profile
    lag_s, delay_s = autopilot.follows
    return replace(profile, lag_s=lag_s, delay_s=delay_s)


def _check_vehicles(
    spec: MissionSpec, formation: Formation, source: str, profiles: Mapping[str, VehicleProfile]
) -> None:
    vehicles = spec.vehicles
    if spec.formation is not None and len(vehicles) != formation.size:
        raise UserError(
            f"{source}: vehicles: {len(vehicles)} listed, formation {formation.name} has {formation.size} points;"
            " list one vehicle for each point"
        )
    first_with: dict[int, int] = {}
    for number, vehicle in enumerate(vehicles):
        key = f"{source}: vehicles[{number}]"
        if vehicle.id in first_with:
            raise UserError(
                f"{key}.id: {vehicle.id} is the id of vehicles[{first_with[vehicle.id]}] too; give each its own"
            )
        first_with[vehicle.id] = number
        if vehicle.autopilot not in AUTOPILOTS:
            raise UserError(f"{key}.autopilot: {vehicle.autopilot}: {unknown(vehicle.autopilot, AUTOPILOTS)}")
        if vehicle.profile not in profiles:
            raise UserError(f"{key}.profile: {vehicle.profile}: {unknown(vehicle.profile, profiles)}")
        try:
            parse_address(mavlink_link(spec, vehicle))
        except UserError as error:
            raise UserError(f"{key}.link: {str(error).removeprefix('link ')}") from None


def _check_compensation(
    spec: MissionSpec, profiles: Sequence[VehicleProfile], lag_s: float | None, source: str
) -> None:
    """Refuses a compensation that limits would undo, and one that nobody of the team can be given."""
    if spec.compensate_s == "auto" or lag_s is None:
        return
    if spec.compensate_s < lag_s:
        if lag_s <= quiet_lag_s(profiles):
            raise UserError(
                f"{source}: compensate_s: {spec.compensate_s:g} s, minimum is {lag_s:.3g} s: p_1_s of a velocity"
                " loop is so small that less would pass the noise of positions on three times over; make it larger, or"
                " leave it out"
            )
        raise UserError(
            f"{source}: compensate_s: {spec.compensate_s:g} s, minimum is {lag_s:.3g} s, 1.5 times what the speed limit"
            f" of {spec.speed_limit_m_s:g} m/s takes at the acceleration limit: counting on less the team may swing;"
            " make it larger, leave it out, or lower the speed limit"
        )
    if any(profile.response is not None for profile in profiles):
        return
    known = ", ".join(name for name, profile in PROFILES.items() if profile.response is not None)
    raise UserError(
        f"{source}: compensate_s: {lag_s:.3g} s, and no vehicle answers quicker by it: it has to be less than the lag"
        f" of a vehicle, and how one answers is known of {known}, with the lag and drag that come along, and of"
        " profiles with a response of their own (gs identify prints it); leave it out"
    )


def _check_upload(spec: MissionSpec, source: str) -> None:
    """Refuses a fence for the autopilots where nobody knows where on earth it lies."""
    on_earth = spec.anchor is not None or any(v.uses_gps for v in spec.vehicles)
    if spec.fence.upload and not on_earth:
        raise UserError(
            f"{source}: fence.upload: true needs a place on earth, and no vehicle has one; give an anchor, vehicles"
            " with origin: gps, or leave it out"
        )


def _check_pads(spec: MissionSpec, pads: FloatArray, region: SafetyRegion, source: str) -> None:
    radius = spec.avoidance.radius_m
    check_clearance(region, pads, ("vehicles[{}].pad_m", "the pad of vehicles[{}]"), "move the pads apart", source)
    for i, j in np.transpose(near_pairs(pads, 1.01 * radius)).tolist():
        distance = float(np.linalg.norm(pads[i] - pads[j]))
        if distance < radius:
            raise UserError(
                f"{source}: vehicles[{j}].pad_m: {distance:.3g} m from the pad of vehicles[{i}], minimum is"
                f" {radius:g} m (avoidance.radius_m); move the pads apart or lower the radius"
            )
    for axis, (low, high) in enumerate(zip(spec.fence.min_m, spec.fence.max_m, strict=True)):
        if low >= high:
            raise UserError(f"{source}: fence.min_m[{axis}]: {low:g} m is not below fence.max_m[{axis}] {high:g} m")


def _check_takeoff(spec: MissionSpec, pads: FloatArray, source: str) -> None:
    low, high = np.array(spec.fence.min_m), np.array(spec.fence.max_m)
    half_stagger_m = spec.takeoff.stagger_m / 2.0
    if spec.takeoff.height_m - half_stagger_m < _floor(spec):
        raise UserError(
            f"{source}: takeoff.height_m: {spec.takeoff.height_m:g} m less half of takeoff.stagger_m"
            f" {spec.takeoff.stagger_m:g} m is below min_altitude_m {_floor(spec):g} m; start higher or stagger less"
        )
    for number, pad in enumerate(pads):
        over = pad + np.array([0.0, 0.0, spec.takeoff.height_m + half_stagger_m])
        if np.any(pad < low) or np.any(over > high):
            raise UserError(
                f"{source}: vehicles[{number}].pad_m: {pad.tolist()} with the takeoff height of"
                f" {spec.takeoff.height_m:g} m is not inside the fence {low.tolist()} to {high.tolist()}"
            )


def _floor(spec: MissionSpec) -> float:
    return spec.min_altitude_m if spec.min_altitude_m is not None else 0.8 * spec.takeoff.height_m
