"""A mission file with all that belongs to it: formation, gains, vehicles, judged together before anything flies.

Positions in the file are ENU in one team frame; the plan keeps them so, and the runner turns them to NED once.
"""

from __future__ import annotations

import base64
import itertools
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.core.control import ScaleFunction
from groundstation.core.errors import UserError
from groundstation.core.files import is_file, read_yaml, validate
from groundstation.core.formation import Formation, Gains
from groundstation.core.motion import MovePlan
from groundstation.core.regions import SafetyRegion, build_region
from groundstation.core.types import FloatArray
from groundstation.core.wind import Airframe
from groundstation.design.store import (
    FormationFile,
    check_gains,
    load_formation,
    load_gains,
    save_gains,
    to_formation,
)
from groundstation.mavlink.addresses import LinkAddress, parse_address
from groundstation.mavlink.autopilots import AUTOPILOTS, Autopilot
from groundstation.mission.plan.budget import LinkRates, fit_rates, frame_bytes
from groundstation.mission.plan.overrides import override_value
from groundstation.mission.plan.positioning import (
    POSITION_ERROR_M,
    all_offsets,
    check_radius,
    check_tolerances,
    margin_m,
)
from groundstation.mission.plan.profiles import PROFILES, VehicleProfile, approach_rate_1_s, slowest
from groundstation.mission.plan.schema import FormStep, MissionSpec
from groundstation.mission.plan.stages import Shape, Stage, check_clearance, check_shape, make_stages, plan_moves
from groundstation.mission.plan.wind import WindLimit, check_wind, grown_by_m, gust_margin_m, room_for_wind, wind_limit

_POSITION_MESSAGES = {"local": "LOCAL_POSITION_NED", "global": "GLOBAL_POSITION_INT"}
_POSE_HZ = 50.0
_KEEP_PLACE_1_S = 0.1


@dataclass(frozen=True)
class MissionPlan:
    """A mission that has passed every check that needs no vehicle.

    Attributes:
        spec: the file's own values.
        source: the file's name, for messages.
        stages: the formations with their gains and laws, the one at the top of the mission first.
        stage_of_step: stage under way in each step.
        moves: ``move`` steps by their number.
        room_m: what the formations leave between two safety regions at least, at any size they are given.
        vehicle_profiles: figures of each vehicle.
        profile: the slowest vehicle's figures, with the delay of the links and the error of the positions.
        lead_s: how far ahead motion counts in the law, see ``formation_control``.
        links: link addresses, each once.
        addresses: the same, read.
        link_of_vehicle: index into ``links`` per vehicle.
        rates: of each link.
        positioning: mocap, rtk or gps.
        margin_m: what two positions may be off against each other.
        wind: up to which wind the mission is flown.
        gust_margin_m: what its gusts may take from a distance; r and d are grown by ``keep_out_margin_m``, for both.
        autopilots: one per vehicle.
        pads_enu_m: shape (n, 3), team frame.
        min_altitude_m: nobody who flies the formation goes below, above the team frame's ground.
        acceleration_limit_m_s2: how fast commanded velocities may change.
    """

    spec: MissionSpec
    source: str
    stages: tuple[Stage, ...]
    stage_of_step: tuple[int, ...]
    moves: Mapping[int, MovePlan]
    room_m: float
    vehicle_profiles: tuple[VehicleProfile, ...]
    profile: VehicleProfile
    lead_s: float
    links: tuple[str, ...]
    addresses: tuple[LinkAddress, ...]
    link_of_vehicle: tuple[int, ...]
    rates: tuple[LinkRates, ...]
    positioning: str
    margin_m: float
    wind: WindLimit
    gust_margin_m: float
    autopilots: tuple[Autopilot, ...]
    pads_enu_m: FloatArray
    min_altitude_m: float
    acceleration_limit_m_s2: float

    @property
    def size(self) -> int:
        """Number of vehicles, n."""
        return len(self.spec.vehicles)

    @property
    def region(self) -> SafetyRegion:
        """What is kept clear around every vehicle, without the margin."""
        return _region(self.spec, self.profile)

    @property
    def room_with_pads_m(self) -> float:
        """What the formations and the pads leave between two safety regions at least."""
        return min(self.room_m, self.region.room_m(all_offsets(self.pads_enu_m)))

    @property
    def keep_out_margin_m(self) -> float:
        """What is added to r and d, as far as there is room: for positions that are off, and for gusts."""
        return grown_by_m(self.margin_m, self.gust_margin_m)

    @property
    def keep_place_1_s(self) -> float:
        """Share of the team's offset from its place that is taken back in a second: slow against every lag."""
        given = self.spec.keep_place_1_s
        return _KEEP_PLACE_1_S / max(1.0, self.profile.lag_s + self.profile.delay_s) if given == "auto" else given

    @property
    def formation(self) -> Formation:
        """The formation at the top of the mission: points and sensing graph, ENU."""
        return self.stages[0].formation

    @property
    def gains(self) -> Gains:
        """Its gains."""
        return self.stages[0].shape.gains

    @property
    def gains_npz(self) -> bytes:
        """The gains file that they came from, for the record."""
        return self.stages[0].shape.gains_npz

    @property
    def control_gain(self) -> float:
        """What multiplies (14) for it: k."""
        return self.stages[0].control_gain

    @property
    def scale(self) -> ScaleFunction:
        """The map f of (14) for it."""
        return self.stages[0].scale

    @property
    def upright_1_s(self) -> float:
        """Weight of the term that keeps it right side up, see ``formation_control``."""
        return self.stages[0].upright_1_s

    @property
    def stream_links(self) -> tuple[int, ...]:
        """Links on which a frame may arrive in two pieces."""
        return tuple(number for number, address in enumerate(self.addresses) if address.is_stream)

    @property
    def pad_error_m(self) -> float:
        """How far from its pad a vehicle may report to stand."""
        return self.spec.limits.pad_error_m or 0.3 + (self.margin_m if self.positioning == "gps" else 0.0)

    @property
    def frame_drift_m(self) -> float:
        """How far a vehicle's two positions, local and global, may drift apart."""
        return self.spec.limits.frame_drift_m or 0.5 + self.margin_m

    @property
    def pose_jump_m(self) -> float:
        """How far a vehicle's positions may move otherwise than its velocities say.

        Half of r, so that a drift is found before it takes away what keeps vehicles apart; what two positions may be
        off; and what 0.2 s of badly known time make of the speed.
        """
        spec = self.spec
        automatic = min(0.5, 0.5 * spec.avoidance.radius_m) + self.margin_m + 0.2 * spec.speed_limit_m_s
        return spec.limits.pose_jump_m or automatic

    @property
    def tracking_m_s(self) -> float:
        """How far a vehicle's velocity may be off what it was told, over a second."""
        return self.spec.limits.tracking_m_s or max(0.3, 0.6 * self.spec.speed_limit_m_s)

    @property
    def lost_radius_m(self) -> float:
        """How much larger than r an obstacle that nobody sees may become."""
        limit = self.spec.limits.lost_radius_m
        return 0.5 * self.spec.avoidance.radius_m if limit is None else limit

    @property
    def battery_warn(self) -> float:
        """Share of the battery below which people are told."""
        limits = self.spec.limits
        return min(limits.battery_min + 0.1, 0.99) if limits.battery_warn is None else limits.battery_warn

    @property
    def battery_land(self) -> float:
        """Share of the battery below which a vehicle lands where it is."""
        limits = self.spec.limits
        return 0.5 * limits.battery_min if limits.battery_land is None else limits.battery_land

    @property
    def battery_land_v(self) -> float | None:
        """The same in volts; None without."""
        limits = self.spec.limits
        low = limits.battery_min_v
        return 0.95 * low if limits.battery_land_v is None and low is not None else limits.battery_land_v

    @property
    def slowness(self) -> float:
        """How many times more gently points are approached because of the links' delay; 1 without any."""
        own = replace(self.profile, delay_s=slowest(self.vehicle_profiles).delay_s)
        return approach_rate_1_s(own, self.lead_s) / approach_rate_1_s(self.profile, self.lead_s)

    def rates_of(self, vehicle: int) -> LinkRates:
        """Rates of a vehicle."""
        return self.rates[self.link_of_vehicle[vehicle]]

    def position_message(self, vehicle: int) -> str:
        """Message type that a vehicle's positions come in."""
        return _POSITION_MESSAGES[self.spec.vehicles[vehicle].position]

    def key_file(self, link: int) -> str | None:
        """File with the signing key of a link, as the mission names it; None for a link that is not signed."""
        return _key_file(self.spec, self.links[link])

    @property
    def signed_links(self) -> tuple[int, ...]:
        """Links on which everything is signed."""
        return tuple(link for link in range(len(self.links)) if self.key_file(link) is not None)

    def link_id(self, link: int) -> int:
        """Link id in our signatures on a link: as the mission says, or the link's number, counted on from its own."""
        signing = self.spec.signing
        own = signing.links.get(self.links[link]) if signing is not None else None
        if own is not None and own.link_id is not None:
            return own.link_id
        return ((signing.link_id or 0) + link) % 256 if signing is not None else 0

    def uses_gps(self, vehicle: int) -> bool:
        """Whether a vehicle's place in the team frame comes from its place on earth."""
        spec = self.spec.vehicles[vehicle]
        return spec.position == "global" or spec.origin == "gps"

    def record(self) -> dict[str, Any]:
        """The mission with everything resolved, as plain values, for the manifest beside the log."""
        values = self.spec.model_dump(mode="json", exclude={"formation", "gains"}, exclude_none=True)
        own = {number for number, step in enumerate(self.spec.steps) if isinstance(step, FormStep) and step.own_shape}
        shapes = []
        for number in sorted(own):
            shape = self.stages[self.stage_of_step[number]].shape
            form = values["steps"][number]["form"]
            form.pop("gains", None)
            form["formation"] = shape.formation.name
            encoded = base64.b64encode(shape.gains_npz).decode()
            shapes.append({"step": number, "formation": _plain(shape.formation), "gains_npz_base64": encoded})
        return {**values, "formation": _plain(self.formation), **({"shapes": shapes} if shapes else {})}


def _plain(formation: Formation) -> dict[str, Any]:
    """A formation as a formation file has it, scale applied."""
    return {
        "name": formation.name,
        "scale": 1.0,
        "points": formation.points_enu_m.tolist(),
        "edges": [[i + 1, j + 1] for i, j in formation.edges],
    }


def read_spec(path: Path, overrides: Sequence[str] = ()) -> MissionSpec:
    """Reads a mission file alone; nothing is judged but its shape.

    Raises:
        UserError: it is no mission file, or an override does not fit it.
    """
    values = read_yaml(path)
    for override in overrides:
        override_value(values, override)
    return validate(MissionSpec, values, str(path))


def load_mission(path: Path, overrides: Sequence[str] = ()) -> MissionPlan:
    """Reads a mission file, its formations and their gains; designs the gains where the file names none.

    Args:
        path: mission file.
        overrides: ``key.path=value``, the value in YAML, list items by number from 0.

    Raises:
        UserError: anything wrong, with file, key, value, limit and remedy.
    """
    spec = read_spec(path, overrides)
    shapes = _Shapes(path)
    first = shapes.read(spec.formation, spec.gains, spec.formation_scale)
    others = {}
    for number, step in enumerate(spec.steps):
        if isinstance(step, FormStep) and step.own_shape:
            form = step
            # Gains belong to points: those of the mission go with the mission's formation only.
            gains = form.gains if form.formation is not None or form.gains is not None else spec.gains
            size = form.formation_scale if form.formation is not None or form.formation_scale else spec.formation_scale
            others[number] = shapes.read(form.formation or spec.formation, gains, size, f"steps[{number}].form.")
    plan = build_plan(spec, first, str(path), others)
    _check_acceleration(plan)
    _check_wind(plan)
    return plan


class _Shapes:
    """Reads formations and gains of one mission, and designs each missing one once."""

    def __init__(self, mission: Path) -> None:
        self._mission = mission
        self._designed: dict[Path, Shape] = {}

    def read(self, formation: str, gains: str | None, size: float | None, key: str = "") -> Shape:
        """Reads a formation, at the size given in place of its own scale, with its gains."""
        formation_path = _relative(self._mission, formation, f"{key}formation")
        as_in_file = load_formation(formation_path)
        factor = 1.0
        if size is not None:
            factor = size / validate(FormationFile, read_yaml(formation_path), str(formation_path)).scale
        sized = as_in_file if size is None else replace(as_in_file, points_enu_m=factor * as_in_file.points_enu_m)
        if gains is None:
            if formation_path not in self._designed:
                self._designed[formation_path] = self._design(as_in_file, formation, key)
            return replace(self._designed[formation_path], formation=sized)
        gains_path = _relative(self._mission, gains, f"{key}gains")
        stored = load_gains(gains_path)
        check_gains(stored, as_in_file)  # gains belong to a shape, whatever its size
        return Shape(sized, stored.gains, gains_path.read_bytes())

    def _design(self, formation: Formation, name: str, key: str) -> Shape:
        from groundstation.design.designer import design  # noqa: PLC0415 - loads solvers that most missions do without

        result = design(formation)
        if result.gains is None or result.certificate is None:
            raise UserError(f"{self._mission}: {key}formation: {name}: no gains exist: {result.reason}")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "gains.npz"
            save_gains(file, formation, result.gains, result.certificate, result.method)
            return Shape(formation, result.gains, file.read_bytes())


def plan_from_record(mission: Mapping[str, Any], gains_npz: bytes, source: str) -> MissionPlan:
    """Puts a plan together from what ``MissionPlan.record`` gave and the gains file's bytes.

    Raises:
        UserError: the record is not one of ours, or what it holds does not fit together.
    """
    values = dict(mission)
    points = values.pop("formation", None)
    if not isinstance(points, Mapping):
        raise UserError(f"{source}: mission.formation: is missing, the manifest is not one of a mission")
    shapes = values.pop("shapes", [])
    name = str(points.get("name"))
    spec = validate(MissionSpec, {**values, "formation": name, "gains": None}, f"{source}: mission")
    first = _shape_from_record(
        points, gains_npz, f"{source}: mission.formation", resized=spec.formation_scale is not None
    )
    others: dict[int, Shape] = {}
    try:
        for item in shapes:
            number = int(item["step"])
            npz = base64.b64decode(item["gains_npz_base64"], validate=True)
            where = f"{source}: mission.shapes[{len(others)}].formation"
            others[number] = _shape_from_record(item["formation"], npz, where, resized=True)
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{source}: mission.shapes: {error}; the manifest is damaged") from error
    wanted = {number for number, step in enumerate(spec.steps) if isinstance(step, FormStep) and step.own_shape}
    if wanted != set(others):
        raise UserError(f"{source}: mission.shapes: are for steps {sorted(others)}, expected {sorted(wanted)}")
    return build_plan(spec, first, source, others)


def _shape_from_record(points: Any, gains_npz: bytes, where: str, *, resized: bool) -> Shape:
    """A formation and its gains out of a manifest, checked against each other."""
    formation = to_formation(validate(FormationFile, dict(points), where))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "gains.npz"
        file.write_bytes(gains_npz)
        stored = load_gains(file)
    size, stored_size = (float(np.abs(points).max()) for points in (formation.points_enu_m, stored.points_enu_m))
    same_size = formation
    if resized and size > 0.0:
        same_size = replace(formation, points_enu_m=formation.points_enu_m * (stored_size / size))
    check_gains(stored, same_size)
    return Shape(formation, stored.gains, gains_npz)


def build_plan(spec: MissionSpec, first: Shape, source: str, others: Mapping[int, Shape] | None = None) -> MissionPlan:
    """Puts a plan together from values that are valid each for itself, and judges them together.

    Args:
        spec: the mission.
        first: the formation at its top.
        source: the file's name, for messages.
        others: formations of ``form`` steps that name their own, by number of the step.

    Raises:
        UserError: they do not fit each other.
    """
    pads = np.array([vehicle.pad_m for vehicle in spec.vehicles], dtype=np.float64)
    if not isinstance(spec.steps[0], FormStep):
        raise UserError(f"{source}: steps[0]: the first step has to be `form`; there is nothing to hold before it")
    shapes = {"formation": first} | {f"steps[{number}].form": shape for number, shape in (others or {}).items()}
    profiles = known_profiles(spec, source)
    _check_vehicles(spec, first.formation, source, profiles)
    vehicle_profiles = tuple(profiles[vehicle.profile] for vehicle in spec.vehicles)
    profile = slowest(vehicle_profiles)
    if spec.avoidance.activation_m < spec.avoidance.radius_m:
        raise UserError(
            f"{source}: avoidance.activation_m: {spec.avoidance.activation_m} m is less than avoidance.radius_m"
            f" {spec.avoidance.radius_m} m; make it as large at least"
        )
    region = _region(spec, profile)
    _check_pads(spec, pads, region, source)
    for key, shape in shapes.items():
        check_shape(spec, shape.formation, region, floor_m=_floor(spec), source=source, key=key)
    _check_takeoff(spec, pads, source)
    links = tuple(dict.fromkeys(vehicle.link for vehicle in spec.vehicles))
    addresses = tuple(parse_address(link) for link in links)
    _check_signing(spec, addresses, source)
    rates = _fit_links(spec, addresses, source)
    gps = any(vehicle.position == "global" or vehicle.origin == "gps" for vehicle in spec.vehicles)
    positioning = spec.positioning or ("gps" if gps else "mocap")
    position_error_m = spec.position_error_m or max(POSITION_ERROR_M[positioning], profile.position_error_m)
    formations = {key: shape.formation.points_enu_m for key, shape in shapes.items()}
    for key, shape in shapes.items():
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
    waits_s = max(1.0 / rate.setpoint_hz + 0.5 / rate.pose_hz for rate in rates) - 1.0 / spec.rate_hz - 0.5 / _POSE_HZ
    profile = replace(
        profile,
        delay_s=profile.delay_s + spec.link_delay_s + max(waits_s, 0.0),
        position_error_m=position_error_m,
    )
    lead_s = profile.lag_s if spec.lead_s == "auto" else spec.lead_s
    if positioning == "gps":
        check_tolerances(source, spec, approach_rate_1_s(profile, lead_s))
    acceleration_limit_m_s2 = spec.acceleration_limit_m_s2 or profile.acceleration_max_m_s2
    stages, stage_of_step = make_stages(spec, first, others or {}, profile, lead_s, source=source)
    moves, room_m = plan_moves(
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
        lead_s=lead_s,
    )
    wind = wind_limit(spec, profile, room)
    return MissionPlan(
        spec=spec,
        source=source,
        stages=stages,
        stage_of_step=stage_of_step,
        moves=moves,
        room_m=room_m,
        vehicle_profiles=vehicle_profiles,
        profile=profile,
        lead_s=lead_s,
        links=links,
        addresses=addresses,
        link_of_vehicle=tuple(links.index(vehicle.link) for vehicle in spec.vehicles),
        rates=rates,
        positioning=positioning,
        margin_m=margin_m(position_error_m),
        wind=wind,
        gust_margin_m=gust_margin_m(spec, profile, wind),
        autopilots=tuple(AUTOPILOTS[vehicle.autopilot] for vehicle in spec.vehicles),
        pads_enu_m=pads,
        min_altitude_m=_floor(spec),
        acceleration_limit_m_s2=acceleration_limit_m_s2,
    )


def _check_acceleration(plan: MissionPlan) -> None:
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


def _check_wind(plan: MissionPlan) -> None:
    """Refuses a wind for which there is no room; not for records either."""
    room = room_for_wind(
        plan.spec, plan.pads_enu_m, margin_m=plan.margin_m, room_m=plan.room_with_pads_m, lead_s=plan.lead_s
    )
    check_wind(plan.source, plan.spec, plan.profile, plan.wind, room)


def _fit_links(spec: MissionSpec, addresses: Sequence[LinkAddress], source: str) -> tuple[LinkRates, ...]:
    """Fits message rates to the links."""
    for link in spec.link_bytes_per_s:
        if link not in {address.url for address in addresses}:
            raise UserError(
                f"{source}: link_bytes_per_s: {link}: no vehicle uses this link; correct it or leave it out"
            )
    fitted = []
    for address in addresses:
        users = [vehicle for vehicle in spec.vehicles if vehicle.link == address.url]
        limit = spec.link_bytes_per_s.get(address.url, address.bytes_per_s)
        position = max((_POSITION_MESSAGES[vehicle.position] for vehicle in users), key=frame_bytes)
        wanted_hz = min(spec.rate_hz, _POSE_HZ)
        try:
            fitted.append(
                fit_rates(
                    address.url,
                    len(users),
                    limit,
                    pose_hz=wanted_hz,
                    setpoint_hz=spec.rate_hz,
                    position=position,
                    cross_check=any(v.position == "local" and v.origin == "gps" for v in users),
                    signed=_key_file(spec, address.url) is not None,
                )
            )
        except UserError as error:
            raise UserError(f"{source}: {error}") from None
    return tuple(fitted)


def _key_file(spec: MissionSpec, link: str) -> str | None:
    if spec.signing is None:
        return None
    own = spec.signing.links.get(link)
    return spec.signing.key_file if own is None else own.key_file


def _check_signing(spec: MissionSpec, addresses: Sequence[LinkAddress], source: str) -> None:
    if spec.signing is None:
        return
    for link in spec.signing.links:
        if link not in {address.url for address in addresses}:
            raise UserError(f"{source}: signing.links: {link}: no vehicle uses this link; correct it or leave it out")
    signed = [address for address in addresses if _key_file(spec, address.url) is not None]
    if not signed:
        raise UserError(
            f"{source}: signing.key_file: is missing, no link would be signed; name one, or leave signing out"
        )
    for address in signed:
        if address.through_mavsdk:
            raise UserError(
                f"{source}: signing: {address.url}: MAVSDK sends setpoints by itself, which cannot be signed here; use"
                f" {address.url.removeprefix('mavsdk://')}, or give the link key_file: null in signing.links"
            )


def _relative(mission: Path, name: str, key: str) -> Path:
    path = Path(name)
    if not path.is_absolute():
        path = mission.parent / path
    if not is_file(path):
        raise UserError(f"{mission}: {key}: {name}: no such file (looked for {path}); correct the path")
    return path


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
        figures = given.model_dump(exclude={"like"}, exclude_none=True)
        figures["settle_s"] = figures.pop("wind_settle_s", PROFILES[like].airframe.settle_s)
        air = {field.name: figures.pop(field.name) for field in fields(Airframe) if field.name in figures}
        airframe = replace(PROFILES[like].airframe, **air)
        profiles[name] = replace(PROFILES[like], name=name, airframe=airframe, **figures)
    return profiles


def _check_vehicles(
    spec: MissionSpec, formation: Formation, source: str, profiles: Mapping[str, VehicleProfile]
) -> None:
    vehicles = spec.vehicles
    if len(vehicles) != formation.size:
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
            raise UserError(f"{key}.autopilot: {vehicle.autopilot} is not known; use one of {', '.join(AUTOPILOTS)}")
        if vehicle.profile not in profiles:
            raise UserError(f"{key}.profile: {vehicle.profile} is not known; use one of {', '.join(profiles)}")
        try:
            parse_address(vehicle.link)
        except UserError as error:
            raise UserError(f"{key}.link: {str(error).removeprefix('link ')}") from None


def _region(spec: MissionSpec, profile: VehicleProfile) -> SafetyRegion:
    given = spec.avoidance
    half_height_m = profile.half_height_m if given.half_height_m is None else given.half_height_m
    return build_region(given.shape, given.radius_m, given.activation_m, half_height_m)


def _check_pads(spec: MissionSpec, pads: FloatArray, region: SafetyRegion, source: str) -> None:
    radius = spec.avoidance.radius_m
    check_clearance(region, pads, ("vehicles[{}].pad_m", "the pad of vehicles[{}]"), "move the pads apart", source)
    for i, j in itertools.combinations(range(len(pads)), 2):
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
