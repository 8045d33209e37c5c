"""``gs sitl``: emulated vehicles on real sockets, until Ctrl-C.

Refuses to fly missions: it only answers, as the autopilots do.
"""

from __future__ import annotations

import signal
from pathlib import Path
from threading import Event
from typing import Annotated

import typer

from groundstation.app.output import Output
from groundstation.core.errors import UserError
from sitl.estimator import NOISES
from sitl.fleet import fleet
from sitl.profiles import PROFILES
from sitl.server import Server
from sitl.world import WorldConfig

AUTOPILOTS = ("px4", "arducopter")


def sitl(
    *,
    vehicles: Annotated[int, typer.Option("--vehicles", "-n", help="How many vehicles, 1 to 254.")] = 8,
    autopilot: Annotated[str, typer.Option(help="px4 or arducopter.")] = "px4",
    port: Annotated[int, typer.Option(help="UDP port of the ground station on 127.0.0.1.")] = 14540,
    seed: Annotated[int, typer.Option(help="Seed of every random number.")] = 1,
    faults: Annotated[Path | None, typer.Option(help="Timetable of faults (YAML).")] = None,
    port_per_vehicle: Annotated[
        bool, typer.Option("--port-per-vehicle", help="Vehicle i sends to port + i - 1.")
    ] = False,
    profile: Annotated[str | None, typer.Option(help=f"Dynamics: {', '.join(PROFILES)}.")] = None,
    noise: Annotated[str, typer.Option(help=f"Errors of the estimates: {', '.join(NOISES)}.")] = "mocap",
    spacing_m: Annotated[float, typer.Option("--spacing", help="Distance between pads, metres.")] = 1.0,
    tcp_port: Annotated[
        int | None, typer.Option("--tcp", help="Vehicle i also listens for TCP on this port + 10 (i - 1).")
    ] = None,
    mavlink: Annotated[int, typer.Option(help="MAVLink version: 1, 2, or 0 for 1 until spoken to in 2.")] = 2,
    real_boot: Annotated[bool, typer.Option("--real-boot", help="Start-up takes as long as a real one.")] = False,
) -> None:
    """Emulates vehicles with their autopilots and sends them to a UDP port of this machine."""
    out = Output(as_json=False)
    stop = Event()
    with _server(
        vehicles=vehicles, autopilot=autopilot, port=port, seed=seed, faults=faults, port_per_vehicle=port_per_vehicle,
        profile=profile, noise=noise, spacing_m=spacing_m, tcp_port=tcp_port, mavlink=mavlink, real_boot=real_boot,
    ) as server:  # fmt: skip
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
        where = f"udp 127.0.0.1:{port}" + (f" to {port + vehicles - 1}" if port_per_vehicle else "")
        if tcp_port is not None:
            where += f", tcp {tcp_port} and up by 10"
        out.console.print(f"{vehicles} vehicles, {autopilot}, seed {seed}: {where}. Ctrl-C ends.")
        server.run(stop)
        out.console.print(f"stopped; {server.datagrams_out} datagrams sent, {server.datagrams_in} received")


def _server(
    *,
    vehicles: int,
    autopilot: str,
    port: int,
    seed: int,
    faults: Path | None,
    port_per_vehicle: bool,
    profile: str | None,
    noise: str,
    spacing_m: float,
    tcp_port: int | None,
    mavlink: int,
    real_boot: bool,
) -> Server:
    """Checks the options and opens the sockets."""
    for name, value, allowed in (
        ("--autopilot", autopilot, AUTOPILOTS),
        ("--noise", noise, tuple(NOISES)),
        ("--profile", profile or "crazyflie", tuple(PROFILES)),
    ):
        if value not in allowed:
            raise UserError(f"{name}: {value!r} is unknown; choose one of {', '.join(allowed)}")
    if mavlink not in (0, 1, 2):
        raise UserError(f"--mavlink: {mavlink} is no version; choose 0, 1 or 2")
    last = port + (vehicles - 1 if port_per_vehicle else 0)
    if not 1 <= port <= last <= 65535:
        raise UserError(f"--port: {port} (up to {last}) is out of range, limits 1 and 65535")
    if faults is not None:
        raise UserError(f"--faults: {faults}: timetables of faults are not read yet; leave the option out")
    try:
        team = fleet(
            vehicles, autopilot=autopilot, profile=profile, spacing_m=spacing_m, noise=NOISES[noise],
            mavlink_version=mavlink,
        )  # fmt: skip
        config = WorldConfig(vehicles=team, real_boot=real_boot)
        return Server(config, seed, port=port, port_per_vehicle=port_per_vehicle, tcp_port=tcp_port)
    except ValueError as error:
        raise UserError(f"sitl: {error}") from error
    except OSError as error:
        raise UserError(f"sitl: a port cannot be opened: {error}; choose another with --port or --tcp") from error
