"""``gs sitl``: emulated vehicles on real sockets, until Ctrl-C.

Refuses to fly missions: it only answers, as the autopilots do.
"""

from __future__ import annotations

import signal
import sys
from importlib.util import find_spec
from pathlib import Path
from threading import Event
from typing import Annotated

import typer

from groundstation.app.completing import choice
from groundstation.app.options import JsonOption
from groundstation.app.output import Output

_LISTED = "a wrong name lists all that there are"


def personality_names() -> list[str]:
    """Names of the autopilots that can be emulated, read off their folders: nothing is loaded for it."""
    spec = find_spec("sitl")
    folders = [Path(place) / "personalities" for place in (spec and spec.submodule_search_locations) or ()]
    return sorted(path.parent.name for folder in folders for path in folder.glob("*/__init__.py"))


def sitl(
    *,
    vehicles: Annotated[int, typer.Option("--vehicles", "-n", help="How many vehicles, 1 to 254.")] = 8,
    autopilot: Annotated[
        str,
        typer.Option(
            help=f"Who flies them: {', '.join(personality_names())}.", autocompletion=choice(*personality_names())
        ),
    ] = "px4",
    port: Annotated[
        int | None,
        typer.Option(
            help="UDP port of the ground station on 127.0.0.1, 14540 if not given; of crazyflie the port on which the"
            " first vehicle listens (19850), the others on those that follow."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of every random number.")] = 1,
    faults: Annotated[Path | None, typer.Option(help="Timetable of faults (YAML).")] = None,
    orders: Annotated[
        bool, typer.Option("--orders", help="Read faults from standard input too, one {kind: ...} a line, or clear.")
    ] = False,
    port_per_vehicle: Annotated[
        bool, typer.Option("--port-per-vehicle", help="Vehicle i sends to port + i - 1.")
    ] = False,
    profile: Annotated[str | None, typer.Option(help=f"Dynamics: crazyflie, px4_quad, ...; {_LISTED}.")] = None,
    noise: Annotated[str, typer.Option(help=f"Errors of the estimates: none, mocap, gps, ...; {_LISTED}.")] = "mocap",
    streams: Annotated[
        str | None,
        typer.Option(help=f"Sent unasked: the autopilot's own if not given; quiet, onboard, ...; {_LISTED}."),
    ] = None,
    gps: Annotated[bool, typer.Option("--gps/--no-gps", help="Whether the vehicles have GPS.")] = True,
    spacing_m: Annotated[float, typer.Option("--spacing", help="Distance between pads, metres.")] = 1.0,
    wind: Annotated[float, typer.Option(help="Mean wind towards the east, m/s.")] = 0.0,
    gusts: Annotated[float, typer.Option(help="Standard deviation of the gusts, m/s.")] = 0.0,
    downwash: Annotated[bool, typer.Option("--downwash", help="Rotors push on whoever flies below.")] = False,
    heading_error: Annotated[
        float, typer.Option(help="Degrees by which each vehicle's own north is off, to a side that is drawn.")
    ] = 0.0,
    level_error: Annotated[
        float, typer.Option(help="Degrees by which each vehicle's own level is off, about an axis that is drawn.")
    ] = 0.0,
    speed: Annotated[float, typer.Option(help="How many times faster than real time.")] = 1.0,
    tcp_port: Annotated[
        int | None, typer.Option("--tcp", help="Vehicle i also listens for TCP on this port + 10 (i - 1).")
    ] = None,
    mavlink: Annotated[int, typer.Option(help="MAVLink version: 1, 2, or 0 for 1 until spoken to in 2.")] = 2,
    real_boot: Annotated[bool, typer.Option("--real-boot", help="Start-up takes as long as a real one.")] = False,
    signing: Annotated[
        Path | None, typer.Option("--signing", help="Key file: the vehicles sign, and obey signed frames only.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Emulates vehicles with their autopilots and sends them to a UDP port of this machine."""
    from rich.live import Live

    from groundstation.app.serving import SitlOptions, open_server, server_picture, tell_errors, where

    options = SitlOptions(
        vehicles, autopilot, port, seed, faults, orders, port_per_vehicle, profile, noise, streams, gps, spacing_m,
        wind, gusts, downwash, heading_error, level_error, speed, tcp_port, mavlink, real_boot, signing,
    )  # fmt: skip
    out = Output(as_json=as_json)
    stop = Event()
    with open_server(options) as server:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
        out.console.print(f"{vehicles} vehicles, {autopilot}, seed {seed}: {where(options)}. Ctrl-C ends.")
        sys.stdout.flush()
        if out.console.is_terminal:
            with Live(server_picture(server), console=out.console, refresh_per_second=4, transient=True) as live:
                server.run(stop, lambda running: live.update(server_picture(running)))
        else:
            server.run(stop, lambda running: tell_errors(out, running))
        out.console.print(f"stopped; {server.datagrams_out} datagrams sent, {server.datagrams_in} received")
        out.result(
            {
                "vehicles": vehicles,
                "autopilot": autopilot,
                "seed": seed,
                "datagrams_sent": server.datagrams_out,
                "datagrams_received": server.datagrams_in,
            }
        )
