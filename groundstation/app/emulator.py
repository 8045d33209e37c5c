"""Puts an emulator together for a mission, and measures the truth that only the emulator knows.

The truth is measured for the report alone; nothing of it reaches the runner.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

import numpy as np

from groundstation.app.gateway.emulated import BEHIND_A_GATEWAY, own_params
from groundstation.app.session import Session
from groundstation.app.signing import read_keys
from groundstation.core.errors import UserError
from groundstation.core.extras import need
from groundstation.core.metrics import min_clearance
from groundstation.core.regions import SafetyRegion
from groundstation.mission.ground.failsafe import make_failsafe
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.vehicle_spec import VehicleSpec
from groundstation.mission.runner import Phase
from sitl.estimator import GPS, MOCAP
from sitl.faults import Fault, FaultError, load_faults
from sitl.personalities import PERSONALITIES
from sitl.server import Server
from sitl.world import VehicleConfig, World, WorldConfig


def world_config(plan: MissionPlan, headings: int | None = None) -> WorldConfig:
    """The mission's vehicles on the mission's pads, with the positions and the parameters that the mission asks for.

    The parameters are those that ``gs check --fix`` would set; a firmware's own defaults are refused before arming.

    Args:
        plan: the mission.
        headings: seed of the directions in which the vehicles stand; None for all facing east.

    Raises:
        UserError: the mission asks for what the emulator does not do.
    """
    for number, vehicle in enumerate(plan.spec.vehicles):
        if vehicle.autopilot not in PERSONALITIES:
            raise UserError(
                f"{plan.source}: vehicles[{number}].autopilot: {vehicle.autopilot} is not emulated; for a dry run add"
                f" --set vehicles.{number}.autopilot= with one of {', '.join(PERSONALITIES)}"
            )
        if vehicle.autopilot in BEHIND_A_GATEWAY:
            if vehicle.origin != "team":
                raise UserError(
                    f"{plan.source}: vehicles[{number}].origin: {vehicle.origin}: a {vehicle.autopilot} tells where"
                    " it is in the room, which is the team's frame; write origin: team"
                )
        elif vehicle.origin in ("team", "declared") and plan.room_link is None:
            raise UserError(
                f"{plan.source}: vehicles[{number}].origin: {vehicle.origin}: emulated vehicles start their local frame"
                f" where they stand; for a dry run add --set vehicles.{number}.origin=pad"
            )
    yaws = (
        np.zeros(plan.size) if headings is None else np.random.default_rng(headings).uniform(-np.pi, np.pi, plan.size)
    )
    keys = read_keys(plan)
    if any(key is not None for key in keys):
        need("mavlink", "emulated vehicles that sign")
    key_of_vehicle = [keys[link] for link in plan.link_of_vehicle]
    wishes = make_failsafe(plan).wishes
    config = WorldConfig(
        vehicles=tuple(
            VehicleConfig(
                sysid=sysid,
                name=vehicle.id,
                link=link,
                autopilot=vehicle.autopilot,
                profile=_flown(plan, vehicle.profile),
                pad_enu_m=vehicle.pad_m,
                yaw_enu_rad=float(yaw),
                noise=GPS if plan.positioning == "gps" else MOCAP,
                streams=PERSONALITIES[vehicle.autopilot].streams,
                gps=plan.room_link is None,
                signing_key=None if key is None else key.setup_bytes(),
                params=_params(vehicle, autopilot.failsafes.settings(wish)),
            )
            for vehicle, sysid, link, yaw, key, autopilot, wish in zip(
                plan.spec.vehicles,
                plan.sysids,
                plan.link_of_vehicle,
                yaws,
                key_of_vehicle,
                plan.autopilots,
                wishes,
                strict=True,
            )
        )
    )
    anchor = plan.spec.anchor
    if anchor is not None:
        config = replace(config, home_lat_deg=anchor.lat_deg, home_lon_deg=anchor.lon_deg, home_alt_m=anchor.alt_m)
    return config


def _params(vehicle: VehicleSpec, settings: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    """Settings of a vehicle by the names that its firmware has; those of a gateway are not the vehicle's."""
    if vehicle.autopilot not in BEHIND_A_GATEWAY:
        return tuple(settings.items())
    return own_params(settings, PERSONALITIES[vehicle.autopilot].parameters(vehicle.id))


def _flown(plan: MissionPlan, profile: str) -> str:
    """The emulator's profile for one of the mission's: a mission's own figures do not change how vehicles fly."""
    own = plan.spec.profiles.get(profile)
    return profile if own is None or own.like is None else own.like


def read_faults(path: Path | None, plan: MissionPlan) -> tuple[Fault, ...]:
    """Reads a timetable of faults for a mission's vehicles; none without a file.

    Raises:
        UserError: the file is wrong, or names a vehicle that the mission does not have.
    """
    if path is None:
        return ()
    try:
        faults = load_faults(path)
        World(replace(world_config(plan), faults=faults), 0)
    except FaultError as error:
        raise UserError(str(error)) from None
    return faults


@contextmanager
def served_world(plan: MissionPlan, seed: int, faults: Sequence[Fault] = ()) -> Iterator[World]:
    """Runs an emulator behind sockets at the other end of the mission's links, in a thread, for ``--udp``.

    Raises:
        UserError: the links are of kinds, or on ports, that the emulator's sockets do not reach.
    """
    for number, vehicle in enumerate(plan.spec.vehicles):
        if vehicle.autopilot in BEHIND_A_GATEWAY:
            raise UserError(
                f"{plan.source}: vehicles[{number}].autopilot: {vehicle.autopilot} speaks no MAVLink over --udp; leave"
                " it out, or run gs sitl --autopilot and gs gateway in terminals of their own"
            )
    ports, tcp_port = _ports(plan)
    port_per_vehicle = len(set(ports)) > 1
    stop = Event()
    with Server(
        replace(world_config(plan, seed), faults=tuple(faults)),
        seed,
        port=ports[0],
        port_per_vehicle=port_per_vehicle,
        tcp_port=tcp_port,
    ) as server:
        thread = Thread(target=server.run, args=(stop,), name="emulator", daemon=True)
        thread.start()
        try:
            yield server.world
        finally:
            stop.set()
            thread.join()


def _ports(plan: MissionPlan) -> tuple[list[int], int | None]:
    """UDP port per vehicle, and the TCP port of the first vehicle, None without TCP.

    Vehicle i of the emulator sends to one UDP port, or to that of the first vehicle + i, and listens for TCP on a port
    + 10 i, as ArduPilot's SITL does.
    """
    addresses = [plan.addresses[link] for link in plan.link_of_vehicle]
    for number, address in enumerate(addresses):
        if address.kind not in ("udpin", "tcpout"):
            raise UserError(
                f"{plan.source}: vehicles[{number}].link: {address.url}: --udp emulates vehicles behind udpin:// and"
                f" tcpout:// only; add --set vehicles.{number}.link=udpin://127.0.0.1:14540"
            )
    udp = {number: address.port for number, address in enumerate(addresses) if address.kind == "udpin"}
    first = {address.port - 10 * number for number, address in enumerate(addresses) if address.kind == "tcpout"}
    if len(first) > 1:
        raise UserError(f"{plan.source}: vehicles: --udp emulates TCP ports that rise by 10 from vehicle to vehicle")
    tcp_port = next(iter(first), None)
    if len(set(udp.values())) <= 1:
        return [next(iter(udp.values()), 14540)] * plan.size, tcp_port
    bases = {port - number for number, port in udp.items()}
    if len(bases) > 1:
        raise UserError(
            f"{plan.source}: vehicles: ports {list(udp.values())}: --udp emulates one port for all vehicles, or"
            " consecutive ports"
        )
    return [next(iter(bases)) + number for number in range(plan.size)], tcp_port


class TruthMeter:
    """Measures the true formation error while the formation is held and moved, and how near to regions anybody came.

    Attributes:
        formation_error_m: largest true |d_ij - d*_ij| over all pairs and all ticks of all holds; NaN before.
        move_error_m: the same of all moves.
    """

    def __init__(self, world: World) -> None:
        self.formation_error_m = float("nan")
        self.move_error_m = float("nan")
        self._region: SafetyRegion | None = None
        self._upright_clearance = float("inf")
        self._world = world

    @property
    def min_clearance(self) -> float:
        """Smallest true clearance between two vehicles, one at least in the air, in the norm of the safety region.

        At any time for a sphere, at any tick for others; infinite before.
        """
        if self._region is None:
            return float("inf")
        if self._region.by_distance:  # known at every physics step
            return self._world.min_distance_airborne_m / self._region.radius_m
        return self._upright_clearance

    def figures(self) -> dict[str, float]:
        """The figures that replace what the vehicles reported."""
        return {
            "formation_error_m": self.formation_error_m,
            "min_distance_m": self._world.min_distance_airborne_m,
            "min_clearance": self.min_clearance,
        }

    def __call__(self, session: Session, _now_ns: int) -> None:
        """Looks at the world after a tick."""
        runner = session.runner
        region = self._region = runner.plan.region
        if not region.by_distance:  # else it is known at every physics step
            truth = self._world.truth
            self._upright_clearance = min(
                self._upright_clearance, min_clearance(truth.pos_enu_m, region, flying=truth.airborne)
            )
        if runner.phase is Phase.HOLD:
            error = runner.formation_error_m(self._world.truth.pos_enu_m)
            self.formation_error_m = float(np.fmax(self.formation_error_m, error))
        elif runner.phase in (Phase.MOVE, Phase.LEAD):
            error = runner.formation_error_m(self._world.truth.pos_enu_m)
            self.move_error_m = float(np.fmax(self.move_error_m, error))
