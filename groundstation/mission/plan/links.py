"""The links of a mission: which there are, who is behind each, what it carries, and whether it is signed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from groundstation.core.errors import UserError
from groundstation.mavlink.addresses import GATEWAY_LINK, LinkAddress, is_crtp, mavlink_url, parse_address, radio_of
from groundstation.mavlink.autopilots import AUTOPILOTS
from groundstation.mission.plan.budget import LinkRates, fit_rates, frame_bytes
from groundstation.mission.plan.gateway_spec import GatewaySpec
from groundstation.mission.plan.positioning_spec import MovingBodySpec, PositioningSpec
from groundstation.mission.plan.schema import MissionSpec
from groundstation.mission.plan.vehicle_spec import SYSTEM_IDS, VehicleSpec, system_ids
from groundstation.mocap.bodies import LINK, RoomConfig, room_config

_POSITION_MESSAGES = {"local": "LOCAL_POSITION_NED", "global": "GLOBAL_POSITION_INT"}
_POSES_MIN_HZ = 30.0
POSE_HZ = 50.0
"""Positions are asked for no more often than this."""


@dataclass(frozen=True)
class LinkPlan:
    """The links of a mission, and what comes over them.

    Attributes:
        spec: the file's own values.
        links: link addresses, each once.
        addresses: the same, read.
        link_of_vehicle: index into ``links`` per vehicle.
        rates: of each link.
        forward: where another ground station watches along; None for nowhere.
        room_link: by which frames of a motion capture system come in; None for none.
    """

    spec: MissionSpec
    links: tuple[str, ...]
    addresses: tuple[LinkAddress, ...]
    link_of_vehicle: tuple[int, ...]
    rates: tuple[LinkRates, ...]
    forward: LinkAddress | None
    room_link: LinkAddress | None

    @property
    def all_links(self) -> tuple[str, ...]:
        """The vehicles' links, and the room's after them."""
        return (*self.links, *(() if self.room_link is None else (self.room_link.url,)))

    @property
    def size(self) -> int:
        """Number of vehicles, n."""
        return len(self.spec.vehicles)

    @cached_property
    def sysids(self) -> tuple[int, ...]:
        """MAVLink system id of each vehicle on its link."""
        return system_ids(self.spec.vehicles)

    @property
    def stream_links(self) -> tuple[int, ...]:
        """Links on which a frame may arrive in two pieces."""
        return tuple(number for number, address in enumerate(self.addresses) if address.is_stream)

    @property
    def crtp_links(self) -> dict[int, str]:
        """Cflib addresses of the vehicles that a gateway of the flight's own serves, by id."""
        return {vehicle.id: vehicle.link for vehicle in self.spec.vehicles if is_crtp(vehicle.link)}

    @property
    def gateway(self) -> GatewaySpec:
        """What that gateway is like."""
        return self.spec.gateway or GatewaySpec()

    @property
    def moving_bodies(self) -> tuple[MovingBodySpec, ...]:
        """Bodies of the motion capture that are obstacles."""
        given = self.spec.positioning
        return given.obstacles if isinstance(given, PositioningSpec) else ()

    def room(self) -> RoomConfig | None:
        """Whom to look for in the frames of a motion capture system; None where the mission has none."""
        if self.room_link is None:
            return None
        return room_config(self.spec.model_dump(mode="json"), self.room_link.url, len(self.links))

    def rates_of(self, vehicle: int) -> LinkRates:
        """Rates of a vehicle."""
        return self.rates[self.link_of_vehicle[vehicle]]

    def position_message(self, vehicle: int) -> str:
        """Message type that a vehicle's positions come in."""
        return _POSITION_MESSAGES[self.spec.vehicles[vehicle].position]

    def key_file(self, link: int) -> str | None:
        """File with the signing key of a link, as the mission names it; None for a link that is not signed."""
        return key_file_of(self.spec, self.links[link])

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
        return self.spec.vehicles[vehicle].uses_gps


def mavlink_link(spec: MissionSpec, vehicle: VehicleSpec) -> str:
    """By which link a vehicle's MAVLink comes: its own, or that of the flight's gateway."""
    return mavlink_url(vehicle.link, None if spec.gateway is None else spec.gateway.link)


def check_crtp(spec: MissionSpec, source: str) -> None:
    """Refuses addresses that no gateway could serve.

    Raises:
        UserError: with key and remedy.
    """
    first_with: dict[str, int] = {}
    for number, vehicle in enumerate(spec.vehicles):
        if not is_crtp(vehicle.link):
            continue
        key = f"{source}: vehicles[{number}].link"
        autopilot = AUTOPILOTS.get(vehicle.autopilot)
        if autopilot is not None and not autopilot.behind_a_gateway:
            raise UserError(
                f"{key}: {vehicle.link}: a Crazyflie's own firmware is behind it, not {vehicle.autopilot}; write"
                " autopilot: crazyflie, or udpin://HOST:PORT for a vehicle that speaks MAVLink"
            )
        try:
            radio_of(vehicle.link)
        except (UserError, ValueError) as error:
            raise UserError(f"{key}: {error}") from None
        if vehicle.link in first_with:
            raise UserError(
                f"{key}: {vehicle.link} is that of vehicles[{first_with[vehicle.link]}] too; each has its own address"
            )
        first_with[vehicle.link] = number
    address = parse_address((spec.gateway or GatewaySpec()).link)
    if first_with and (address.kind != "udpout" or address.through_mavsdk):
        raise UserError(f"{source}: gateway.link: {address.url}: expected udpout://HOST:PORT, as {GATEWAY_LINK}")


def check_system_ids(spec: MissionSpec, source: str) -> None:
    """Refuses two vehicles of one system id on one link, and others than its id where that alone names a vehicle.

    Raises:
        UserError: with key and remedy.
    """
    sysids = system_ids(spec.vehicles)
    first_with: dict[tuple[str, int], int] = {}
    for number, (vehicle, sysid) in enumerate(zip(spec.vehicles, sysids, strict=True)):
        key, at = f"{source}: vehicles[{number}].sysid", (mavlink_link(spec, vehicle), sysid)
        if sysid not in SYSTEM_IDS:
            raise UserError(
                f"{key}: {sysid}, its place on {vehicle.link}, is no system id of a vehicle, limit {SYSTEM_IDS[-1]};"
                " put some of its vehicles behind another link"
            )
        if at in first_with:
            raise UserError(
                f"{key}: {sysid} on {at[0]} is that of vehicles[{first_with[at]}] too; give each of a link its own"
            )
        first_with[at] = number
        by_id = is_crtp(vehicle.link) or isinstance(spec.positioning, PositioningSpec)
        if by_id and sysid != vehicle.id:
            raise UserError(
                f"{key}: {sysid}, and motion capture and gateways know vehicles by their id, {vehicle.id}; leave it"
                f" out, and number the vehicles from 1 to {SYSTEM_IDS[-1]}"
            )


def read_forward(spec: MissionSpec, addresses: Sequence[LinkAddress], source: str) -> LinkAddress | None:
    """Where another ground station watches along.

    Raises:
        UserError: no address of another program, or one at which this program or a vehicle listens: what vehicles tell
            would come back as if they had told it twice, and late.
    """
    if spec.forward is None:
        return None
    try:
        address = parse_address(spec.forward)
    except UserError:
        address = None
    if address is None or address.kind != "udpout" or address.through_mavsdk or not 0 < address.port < 1 << 16:
        raise UserError(
            f"{source}: forward: {spec.forward}: expected udpout://HOST:PORT, for example udpout://127.0.0.1:14550"
        )
    sysids = system_ids(spec.vehicles)
    if len(set(sysids)) < len(sysids):
        raise UserError(
            f"{source}: forward: {spec.forward}: it could not tell vehicles of one system id on different links apart;"
            " give each vehicle its own (sysid), or leave it out"
        )
    for other in addresses:
        listens = other.kind == "udpin" and other.port == address.port
        speaks = other.kind == "udpout" and (other.host, other.port) == (address.host, address.port)
        if listens or speaks:
            raise UserError(
                f"{source}: forward: {spec.forward}: port {address.port} is that of the vehicles' link {other.url}, and"
                " what they tell would come back to it; name another port, at which the other ground station listens"
            )
    return address


def room_link(spec: MissionSpec, addresses: Sequence[LinkAddress], source: str) -> LinkAddress | None:
    """By which link frames of a motion capture system come in; None where the mission has none.

    Raises:
        UserError: no link to listen on, one of the vehicles', or vehicles whose positions do not count from the room's
            origin.
    """
    given = spec.positioning
    if not isinstance(given, PositioningSpec):
        return None
    address = parse_address(given.link)
    if address.kind != "udpin" or address.through_mavsdk:
        raise UserError(f"{source}: positioning.link: {given.link}: expected udpin://HOST:PORT, as {LINK}")
    own = (spec.gateway or GatewaySpec()).link
    if any(other.port == address.port and (other.kind == "udpin" or other.url == own) for other in addresses):
        raise UserError(
            f"{source}: positioning.link: {given.link}: port {address.port} is that of the vehicles; name another one"
        )
    for number, vehicle in enumerate(spec.vehicles):
        if vehicle.origin != "team" or vehicle.position != "local":
            raise UserError(
                f"{source}: vehicles[{number}].origin: {vehicle.origin}: with positioning from motion capture everybody"
                " counts from the room's origin; write origin: team, and no position: global"
            )
        autopilot = AUTOPILOTS.get(vehicle.autopilot)
        if autopilot is not None and autopilot.needs_origin and not (spec.set_gps_origin and spec.anchor):
            raise UserError(
                f"{source}: vehicles[{number}].autopilot: {vehicle.autopilot} takes no position from motion capture"
                " before it has an origin on earth; write set_gps_origin: true, and an anchor"
            )
        if autopilot is not None and not autopilot.behind_a_gateway and spec.rate_hz < _POSES_MIN_HZ:
            raise UserError(
                f"{source}: rate_hz: {spec.rate_hz:g}: {vehicle.autopilot} is told its pose once a tick, and its"
                f" estimator wants {_POSES_MIN_HZ:g} to 50 a second; write rate_hz: 50"
            )
    names = [vehicle.body_name for vehicle in spec.vehicles]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None and given.bodies == "name":
        raise UserError(f"{source}: vehicles[].body: {twice} stands twice; every vehicle's body has a name of its own")
    for number, item in enumerate(given.obstacles):
        if item.body in names:
            raise UserError(
                f"{source}: positioning.obstacles[{number}].body: {item.body} is that of vehicle"
                f" {spec.vehicles[names.index(item.body)].id}; an obstacle's body has a name of its own"
            )
    return address


def fit_links(spec: MissionSpec, addresses: Sequence[LinkAddress], source: str) -> tuple[LinkRates, ...]:
    """Fits message rates to the links."""
    for link in spec.link_bytes_per_s:
        if link not in {address.url for address in addresses}:
            raise UserError(
                f"{source}: link_bytes_per_s: {link}: no vehicle uses this link; correct it or leave it out"
            )
    fitted = []
    for address in addresses:
        users = [vehicle for vehicle in spec.vehicles if mavlink_link(spec, vehicle) == address.url]
        limit = spec.link_bytes_per_s.get(address.url, address.bytes_per_s)
        position = max((_POSITION_MESSAGES[vehicle.position] for vehicle in users), key=frame_bytes)
        wanted_hz = min(spec.rate_hz, POSE_HZ)
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
                    gps=any(v.uses_gps for v in users),
                    signed=key_file_of(spec, address.url) is not None,
                )
            )
        except UserError as error:
            raise UserError(f"{source}: {error}") from None
    return tuple(fitted)


def key_file_of(spec: MissionSpec, link: str) -> str | None:
    """File with the signing key of a link, None for one that is not signed."""
    if spec.signing is None:
        return None
    own = spec.signing.links.get(link)
    return spec.signing.key_file if own is None else own.key_file


def check_signing(spec: MissionSpec, addresses: Sequence[LinkAddress], source: str) -> None:
    """Refuses signing that names no link, or no key.

    Raises:
        UserError: with key and remedy.
    """
    if spec.signing is None:
        return
    for link in spec.signing.links:
        if link not in {address.url for address in addresses}:
            raise UserError(f"{source}: signing.links: {link}: no vehicle uses this link; correct it or leave it out")
    signed = [address for address in addresses if key_file_of(spec, address.url) is not None]
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
