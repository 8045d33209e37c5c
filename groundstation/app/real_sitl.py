"""Which processes are a mission's team on the autopilots' own simulators, as lines for a shell.

Places, ids and ports are worked out from the mission; nothing is started and no file is looked at. What is put into
the lines is the personality's own knowledge (``sitl.simulator``).
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass

import numpy as np
import pymap3d

from groundstation.core.errors import UserError
from groundstation.mission.plan.plan import MissionPlan
from sitl.personalities import PERSONALITIES
from sitl.simulator import Simulator

HOME = (47.397742, 8.545594, 489.4)
"""Irchel in Zurich, where simulators start by default; degrees, metres above the sea."""


@dataclass(frozen=True)
class Start:
    """One simulated vehicle.

    Attributes:
        vehicle: position in the mission.
        instance: of its simulator.
        place: latitude, longitude (degrees), height above the sea (m).
        line: for a shell.
    """

    vehicle: int
    instance: int
    place: tuple[float, float, float]
    line: str


def starts(plan: MissionPlan, home: tuple[float, float, float], *, stock: bool = False) -> list[Start]:
    """The processes of a mission's team.

    Args:
        plan: pads, ids, links.
        home: place of the team frame's origin: latitude, longitude (degrees), height (m); the mission's anchor goes
            before it.
        stock: simulators as they come, without the parameters that cure their faults.

    Raises:
        UserError: a vehicle that the simulators cannot be: another id, link or port than theirs.
    """
    anchor = plan.spec.anchor
    where = home if anchor is None else (anchor.lat_deg, anchor.lon_deg, anchor.alt_m)
    return [_start(plan, vehicle, where, stock=stock) for vehicle in range(plan.size)]


def _start(plan: MissionPlan, vehicle: int, home: tuple[float, float, float], *, stock: bool) -> Start:
    spec, address = plan.spec.vehicles[vehicle], plan.addresses[plan.link_of_vehicle[vehicle]]
    sysid = plan.sysids[vehicle]
    lat, lon, alt = (float(value) for value in pymap3d.enu2geodetic(*spec.pad_m, *home))
    simulator = _simulator(plan, vehicle)
    try:
        instance = simulator.instance(sysid, vehicle, address.kind, address.port)
    except ValueError as error:
        raise UserError(f"{plan.source}: vehicles[{vehicle}].link: {address.url}: {error}") from None
    command = simulator.command(instance, sysid, (lat, lon, alt), stock=stock)
    # Simulators keep their parameters in their folder, and would not come as they are in one of cured ones.
    name = f"{plan.spec.name}-stock-{spec.id}" if stock else f"{plan.spec.name}-{spec.id}"
    folder, log = shlex.quote(name), f"{name}.txt"
    line = f"mkdir -p {folder} && (cd {folder} && {command} < /dev/null > {shlex.quote(f'../{log}')} 2>&1) &"
    return Start(vehicle, instance, (lat, lon, alt), line)


def _simulator(plan: MissionPlan, vehicle: int) -> Simulator:
    name = plan.spec.vehicles[vehicle].autopilot
    kind = PERSONALITIES.get(name)
    if kind is None or kind.simulator is None:
        known = ", ".join(item.name for item in PERSONALITIES.values() if item.simulator is not None)
        raise UserError(
            f"{plan.source}: vehicles[{vehicle}].autopilot: {name}: how its own simulator is started is not known;"
            f" it is of {known}"
        )
    return kind.simulator


def _off_m(simulator: Simulator, place: tuple[float, float, float]) -> float:
    """How far from its place a simulator puts a vehicle."""
    lat, lon, alt = simulator.kept(place)
    east, north, _ = pymap3d.geodetic2enu(lat, lon, alt, *place)
    return float(np.hypot(east, north))


def lines(plan: MissionPlan, home: tuple[float, float, float], *, stock: bool = False) -> list[str]:
    """A script that starts the team, with what has to be known about it as comments."""
    found = starts(plan, home, stock=stock)
    where = ", ".join(f"{value:.7g}" for value in found[0].place)
    script = [f"# The team of {plan.spec.name} on its own simulators; the first vehicle stands at {where} m"]
    for name, kind in PERSONALITIES.items():
        places = [start.place for start in found if plan.spec.vehicles[start.vehicle].autopilot == name]
        if kind.simulator is not None and places:
            off_m = max(_off_m(kind.simulator, place) for place in places)
            script += kind.simulator.remarks(off_m, stock=stock)
    script += [start.line for start in found]
    script.append("wait  # the simulators end with this script: stop it with Ctrl-C")
    return script
