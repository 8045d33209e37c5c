"""What ``gs sitl`` serves: emulated vehicles on real sockets, and a picture of how they are.

Refuses to fly missions: it only answers, as the autopilots do.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

from rich.console import Group
from rich.table import Table
from rich.text import Text

from groundstation.app.output import Output
from groundstation.core.choices import nearest
from groundstation.core.errors import UserError
from groundstation.core.extras import need
from groundstation.mavlink.keys import read_key
from sitl.faults import Fault, load_faults
from sitl.fleet import fleet
from sitl.own_frame import OwnFrameConfig
from sitl.personalities import NOISES, PERSONALITIES, PROFILES, RATES_HZ
from sitl.server import Server
from sitl.world import WindConfig, WorldConfig

_ROWS_SHOWN = 30
_GROUND_STATION_PORT = 14540


@dataclass(frozen=True)
class SitlOptions:
    """The options of ``gs sitl`` as they were typed, in the order of ``gs sitl --help``."""

    vehicles: int
    autopilot: str
    port: int | None
    seed: int
    faults: Path | None
    orders: bool
    port_per_vehicle: bool
    profile: str | None
    noise: str
    streams: str | None
    gps: bool
    spacing_m: float
    wind: float
    gusts: float
    downwash: bool
    heading_error_deg: float
    level_error_deg: float
    speed: float
    tcp_port: int | None
    mavlink: int
    real_boot: bool
    signing: Path | None


def first_port(options: SitlOptions) -> int:
    """The ground station's UDP port, or the first vehicle's of a kind that listens on ports of its own."""
    if options.port is not None:
        return options.port
    kind = PERSONALITIES.get(options.autopilot)
    return _GROUND_STATION_PORT if kind is None or kind.first_port is None else kind.first_port


def where(options: SitlOptions) -> str:
    """The ports that it is served on, in words."""
    port, last = first_port(options), first_port(options) + options.vehicles - 1
    if PERSONALITIES[options.autopilot].first_port is not None:
        return f"listening on udp 127.0.0.1:{port}" + (f" to {last}" if last > port else "")
    words = f"udp 127.0.0.1:{port}" + (f" to {last}" if options.port_per_vehicle else "")
    return words if options.tcp_port is None else f"{words}, tcp {options.tcp_port} and up by 10"


def _own_frames(options: SitlOptions) -> OwnFrameConfig | None:
    """How far the vehicles' own north and level are off; None where they are right."""
    if not options.heading_error_deg and not options.level_error_deg:
        return None
    return OwnFrameConfig(math.radians(options.heading_error_deg), math.radians(options.level_error_deg))


def open_server(options: SitlOptions) -> Server:
    """Checks the options and opens the sockets."""
    for name, value, allowed in (
        ("--autopilot", options.autopilot, tuple(PERSONALITIES)),
        ("--noise", options.noise, tuple(NOISES)),
        ("--profile", options.profile or next(iter(PROFILES)), tuple(PROFILES)),
        ("--mavlink", options.mavlink, (0, 1, 2)),
        ("--streams", options.streams or next(iter(RATES_HZ)), tuple(RATES_HZ)),
    ):
        if value not in allowed:
            near = nearest(str(value), map(str, allowed))
            meant = f", did you mean {near}?" if near else ";"
            raise UserError(f"{name}: {value!r} is unknown{meant} choose one of {', '.join(map(str, allowed))}")
    for name, number, low, high in (
        ("--spacing", options.spacing_m, 0.0, 1000.0),
        ("--wind", options.wind, -30.0, 30.0),
        ("--gusts", options.gusts, 0.0, 15.0),
        ("--heading-error", options.heading_error_deg, 0.0, 180.0),
        ("--level-error", options.level_error_deg, 0.0, 180.0),
        ("--speed", options.speed, 0.01, 50.0),
        ("--seed", options.seed, 0, 2**63),
    ):
        if not low <= number <= high:
            raise UserError(f"{name}: {number} is out of range, limits {low} and {high}")
    port, own_ports = first_port(options), PERSONALITIES[options.autopilot].first_port is not None
    last = port + (options.vehicles - 1 if options.port_per_vehicle or own_ports else 0)
    tcp_last = (options.tcp_port or 1) + 10 * (options.vehicles - 1)
    if not 1 <= port <= last <= 65535:
        raise UserError(f"--port: {port} (up to {last}) is out of range, limits 1 and 65535")
    if options.tcp_port is not None and not 1 <= options.tcp_port <= tcp_last <= 65535:
        raise UserError(f"--tcp: {options.tcp_port} (up to {tcp_last}) is out of range, limits 1 and 65535")
    if own_ports and options.tcp_port is not None:
        raise UserError(f"--tcp: {options.autopilot} listens on UDP alone; leave it out, --port chooses the UDP ports")
    if options.signing is not None:
        need("mavlink", "gs sitl --signing")
    key = None if options.signing is None else read_key(options.signing).setup_bytes()
    try:
        timetable: tuple[Fault, ...] = load_faults(options.faults) if options.faults else ()
        config = WorldConfig(
            vehicles=fleet(
                options.vehicles,
                autopilot=options.autopilot,
                profile=options.profile,
                spacing_m=options.spacing_m,
                noise=NOISES[options.noise],
                streams=options.streams,
                mavlink_version=options.mavlink,
                gps=options.gps,
                signing_key=key,
            ),
            real_boot=options.real_boot,
            faults=timetable,
            wind=WindConfig((options.wind, 0.0, 0.0), options.gusts) if options.wind or options.gusts else None,
            downwash=options.downwash,
            own_frames=_own_frames(options),
        )
        return Server(
            config,
            options.seed,
            port=port,
            port_per_vehicle=options.port_per_vehicle,
            tcp_port=options.tcp_port,
            orders=sys.stdin if options.orders else None,
            speed=options.speed,
        )
    except ValueError as error:
        raise UserError(f"sitl: {error}") from error
    except OSError as error:
        raise UserError(f"sitl: a port cannot be opened: {error}; choose another with --port or --tcp") from error


def tell_errors(out: Output, server: Server) -> None:
    """Prints what was wrong with orders, once."""
    while server.orders.errors:
        out.console.print(server.orders.errors.pop(0))


def server_picture(server: Server) -> Group:
    """The state of the vehicles as a table, what is wrong below it."""
    world = server.world
    truth = world.truth
    table = Table(box=None, pad_edge=False)
    for heading in ("id", "mode", "armed", "state", "battery", "east", "north", "up", "speed", "stations"):
        table.add_column(heading, justify="left" if heading in ("mode", "armed", "state") else "right")
    states = {1: "ground", 2: "air", 3: "takeoff", 4: "landing"}
    for i, pilot in enumerate(world.autopilots[:_ROWS_SHOWN]):
        speed = float((truth.vel_enu_m_s[i] ** 2).sum() ** 0.5)
        table.add_row(
            str(pilot.sysid),
            pilot.mode_name(),
            "armed" if pilot.armed else "",
            states[pilot.landed_state()],
            f"{pilot.battery.percent()} %",
            *(f"{value:.2f}" for value in truth.pos_enu_m[i]),
            f"{speed:.2f}",
            str(server.ground_stations[i]),
        )
    lines = [Text(f"late by {server.late_ns / 1e9:.1f} s: this machine is too slow")] if server.late_ns else []
    if errors := sum(world.frame_errors):
        lines.append(Text(f"{errors} frames could not be handled and were dropped"))
    if world.n > _ROWS_SHOWN:
        lines.append(Text(f"and {world.n - _ROWS_SHOWN} more"))
    for item in world.active_faults:
        whose = "all" if not item.vehicles else ", ".join(map(str, item.vehicles))
        numbers = "".join(f", {name} {value:g}" for name, value in item.numbers.items())
        lines.append(Text(f"fault: {item.kind} of {whose}{numbers}"))
    lines += [Text(message) for message in server.orders.errors[-3:]]
    return Group(table, *lines)
