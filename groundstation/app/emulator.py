"""Puts an emulator together for a mission, and measures the truth that only the emulator knows.

The truth is measured for the report alone; nothing of it reaches the runner.
"""

from __future__ import annotations

from collections import deque
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

_LAST_NS = 1_000_000_000  # of a hold, over which it is judged how still the team stands


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
    """Measures what is true of a flight: how large errors are, how still it is held, how near to regions anybody came.

    Attributes:
        formation_error_m: largest true |d_ij - d*_ij| over all pairs and all ticks of all holds; NaN before.
        move_error_m: the same of all moves.
    """

    def __init__(self, world: World) -> None:
        self.formation_error_m = float("nan")
        self.move_error_m = float("nan")
        self._hold_speed = HoldSpeed()
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

    def further(self) -> dict[str, float]:
        """The figures that stand beside these in a manifest."""
        return {"move_error_m": self.move_error_m, "hold_speed_m_s": self.hold_speed_m_s}

    @property
    def hold_speed_m_s(self) -> float:
        """How still the team was held, see ``HoldSpeed``; NaN where no hold has lasted a second."""
        return self._hold_speed.m_s

    def figures(self) -> dict[str, float]:
        """The figures that replace what the vehicles reported."""
        return {
            "formation_error_m": self.formation_error_m,
            "min_distance_m": self._world.min_distance_airborne_m,
            "min_clearance": self.min_clearance,
        }

    def __call__(self, session: Session, now_ns: int) -> None:
        """Looks at the world after a tick."""
        runner = session.runner
        region = self._region = runner.plan.region
        if not region.by_distance:  # else it is known at every physics step
            truth = self._world.truth
            self._upright_clearance = min(
                self._upright_clearance, min_clearance(truth.pos_enu_m, region, flying=truth.airborne)
            )
        if runner.phase is not Phase.HOLD:
            self._hold_speed.end()
        else:
            truth = self._world.truth
            self._hold_speed.take(now_ns, truth.vel_enu_m_s)
            error = runner.formation_error_m(truth.pos_enu_m)
            self.formation_error_m = float(np.fmax(self.formation_error_m, error))
        if runner.phase in (Phase.MOVE, Phase.LEAD):
            error = runner.formation_error_m(self._world.truth.pos_enu_m)
            self.move_error_m = float(np.fmax(self.move_error_m, error))


class HoldSpeed:
    """Root mean square of a vehicle's true speed over the last second of a hold, largest of all vehicles and holds.

    Shorter holds do not count. A team that circles its places without end is formed and completes: only this shows it.
    """

    def __init__(self) -> None:
        self._largest_m_s = float("nan")
        self._squares: deque[tuple[int, np.ndarray]] = deque()  # of the hold under way: when, and (n,) speeds squared
        self._since_ns = 0

    def take(self, now_ns: int, vel_enu_m_s: np.ndarray) -> None:
        """Takes the velocities of a tick of a hold, shape (n, 3)."""
        if not self._squares:
            self._since_ns = now_ns
        self._squares.append((now_ns, (vel_enu_m_s**2).sum(axis=1)))
        while now_ns - self._squares[0][0] > _LAST_NS:
            self._squares.popleft()

    def end(self) -> None:
        """The hold is over, or none is under way."""
        self._largest_m_s = self.m_s
        self._squares.clear()

    @property
    def m_s(self) -> float:
        """The figure so far; NaN before."""
        if not self._squares or self._squares[-1][0] - self._since_ns < _LAST_NS:
            return self._largest_m_s
        latest = float(np.sqrt(np.mean([squares for _, squares in self._squares], axis=0).max()))
        return float(np.fmax(self._largest_m_s, latest))
