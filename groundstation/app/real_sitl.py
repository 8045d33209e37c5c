"""Which processes are a mission's team on the autopilots' own simulators, as lines for a shell.

Places, ids and ports are worked out from the mission; nothing is started and no file is looked at. What is put into
the lines was seen to be needed by PX4 1.16 with its built-in simulator (SIH) and by ArduCopter 4.7 (docs/vehicles.md).
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass

import numpy as np
import pymap3d

from groundstation.core.errors import UserError
from groundstation.mission.plan.plan import MissionPlan

HOME = (47.397742, 8.545594, 489.4)
"""Where PX4's simulators start by default, Irchel in Zurich; degrees, metres above the sea."""
_PX4_PORT, _PX4_LAST, _PX4_GCS = 14540, 14549, 14550
_TCP_PORT, _TCP_STEP = 5760, 10
_PARAMS = {"EKF2_GYR_NOISE": 0.1, "EKF2_ACC_NOISE": 1.0}
_PARAMS_WHY = "PX4's estimator is told how much its simulator shakes the sensors"
_COPTER_DEFAULTS = "Tools/autotest/default_params/copter.parm"


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
        stock: PX4 as it comes, without the parameters that cure its simulator's velocity.

    Raises:
        UserError: a vehicle that the simulators cannot be: another id, link or port than theirs.
    """
    anchor = plan.spec.anchor
    where = home if anchor is None else (anchor.lat_deg, anchor.lon_deg, anchor.alt_m)
    return [_start(plan, vehicle, where, stock=stock) for vehicle in range(plan.size)]


def _start(plan: MissionPlan, vehicle: int, home: tuple[float, float, float], *, stock: bool) -> Start:
    spec = plan.spec.vehicles[vehicle]
    lat, lon, alt = (float(value) for value in pymap3d.enu2geodetic(*spec.pad_m, *home))
    if spec.autopilot == "px4":
        instance = _px4_instance(plan, vehicle)
        settings = [
            "PX4_SIM_MODEL=sihsim_quadx", f"PX4_HOME_LAT={lat:.7f}", f"PX4_HOME_LON={lon:.7f}",
            f"PX4_HOME_ALT={alt:.2f}",
        ]  # fmt: skip
        if not stock:
            settings += [f"PX4_PARAM_{name}={value:g}" for name, value in _PARAMS.items()]
        command = f'exec env {" ".join(settings)} "$PX4/bin/px4" -i {instance} -d "$PX4/etc"'
    else:
        instance = _tcp_instance(plan, vehicle)
        place = f"{lat:.7f},{lon:.7f},{alt:.2f},0"
        command = (
            f'exec "$ARDUPILOT/build/sitl/bin/arducopter" -I {instance} --sysid {spec.id} --model quad --home {place}'
            f' --defaults "$ARDUPILOT/{_COPTER_DEFAULTS}"'
        )
    folder = shlex.quote(f"{plan.spec.name}-{spec.id}")
    log = f"{plan.spec.name}-{spec.id}.txt"
    line = f"mkdir -p {folder} && (cd {folder} && {command} < /dev/null > {shlex.quote(f'../{log}')} 2>&1) &"
    return Start(vehicle, instance, (lat, lon, alt), line)


def _px4_instance(plan: MissionPlan, vehicle: int) -> int:
    """Instance i of PX4 has system id i + 1 and sends to 14540 + i, all above 9 to 14549."""
    spec, address = plan.spec.vehicles[vehicle], plan.addresses[plan.link_of_vehicle[vehicle]]
    instance = spec.id - 1
    ports = (min(_PX4_PORT + instance, _PX4_LAST), _PX4_GCS)
    if address.kind != "udpin" or address.port not in ports:
        raise UserError(
            f"{plan.source}: vehicles[{vehicle}].link: {address.url}: PX4's simulator with system id {spec.id} is"
            f" instance {instance}, which sends to udp {ports[0]} (and to {_PX4_GCS}); set it to"
            f" udpin://0.0.0.0:{ports[0]}"
        )
    return instance


def _tcp_instance(plan: MissionPlan, vehicle: int) -> int:
    """Instance i of ArduPilot waits on tcp 5760 + 10 i."""
    address = plan.addresses[plan.link_of_vehicle[vehicle]]
    instance, odd = divmod(address.port - _TCP_PORT, _TCP_STEP)
    if address.kind != "tcpout" or odd or instance < 0:
        raise UserError(
            f"{plan.source}: vehicles[{vehicle}].link: {address.url}: ArduPilot's simulator waits on tcp 5760, 5770 and"
            f" so on; set it to tcpout://127.0.0.1:{_TCP_PORT + _TCP_STEP * vehicle}"
        )
    return instance


def off_grid_m(plan: MissionPlan, found: list[Start]) -> float:
    """How far from its pad PX4 puts the vehicle that is worst off: it keeps its home as floats of 32 bits."""
    worst = 0.0
    for start in found:
        if plan.spec.vehicles[start.vehicle].autopilot != "px4":
            continue
        kept = [float(np.float32(f"{value:.7f}")) for value in start.place[:2]]
        east, north, _ = pymap3d.geodetic2enu(kept[0], kept[1], start.place[2], *start.place)
        worst = max(worst, float(np.hypot(east, north)))
    return worst


def lines(plan: MissionPlan, home: tuple[float, float, float], *, stock: bool = False) -> list[str]:
    """A script that starts the team, with what has to be known about it as comments."""
    found = starts(plan, home, stock=stock)
    kinds = {vehicle.autopilot for vehicle in plan.spec.vehicles}
    where = ", ".join(f"{value:.7g}" for value in found[0].place)
    script = [f"# The team of {plan.spec.name} on its own simulators; the first vehicle stands at {where} m"]
    if "px4" in kinds:
        script += [
            "# PX4: the folder that `make px4_sitl_default` fills",
            ': "${PX4:=$HOME/PX4-Autopilot/build/px4_sitl_default}"',
        ]
        script.append(f"# pads are up to {off_grid_m(plan, found):.2f} m off: it keeps its home as a float of 32 bits")
        if not stock:
            names = " and ".join(_PARAMS)
            script.append(f"# {names}: {_PARAMS_WHY}")
    if "arducopter" in kinds:
        script += ["# ArduCopter: the folder in which `./waf copter` was run", ': "${ARDUPILOT:=$HOME/ardupilot}"']
        script.append('# without the default parameters it says "Check frame class and type" for ever')
    script += [start.line for start in found]
    script.append("wait  # the simulators end with this script: stop it with Ctrl-C")
    return script
