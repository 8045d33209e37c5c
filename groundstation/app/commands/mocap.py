"""``gs mocap``: frames of a motion capture system for flights: read, faked, or played from a log; until Ctrl-C."""

from __future__ import annotations

import signal
import sys
from contextlib import ExitStack, closing
from pathlib import Path
from threading import Event
from typing import Annotated

import typer
from rich.text import Text

from groundstation.app.completing import choice, packaged
from groundstation.app.options import JsonOption
from groundstation.app.output import Output
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError
from groundstation.core.extras import need

_KINDS = ("read", "fake", "play")
_LINK = "udpin://127.0.0.1:14595"  # mocap.bodies.LINK, which would load numpy for --help


def mocap(
    kind: Annotated[
        str,
        typer.Argument(
            help="read: a system. fake: an emulated team and what a system would see of it. play: a recorded flight's.",
            autocompletion=choice(*_KINDS),
        ),
    ],
    log: Annotated[Path | None, typer.Argument(help="With play: the log (.tlog).")] = None,
    *,
    mission: Annotated[
        Path | None,
        typer.Option(help="Its names, link and axes; with fake its team.", autocompletion=packaged("missions")),
    ] = None,
    system: Annotated[str | None, typer.Option(help="Kind of system: vicon, optitrack, qualisys, vrpn, ...")] = None,
    host: Annotated[str | None, typer.Option(help="Where it streams from.")] = None,
    body: Annotated[list[str] | None, typer.Option(help="Name of a body and its vehicle, NAME=ID; once each.")] = None,
    obstacle: Annotated[
        list[str] | None, typer.Option(help="Name of a body that is an obstacle, in the mission's order; once each.")
    ] = None,
    link: Annotated[str | None, typer.Option(help=f"Where the flight listens, as in the mission; {_LINK}.")] = None,
    up: Annotated[str, typer.Option(help="Axis of the system that points up: z or y.")] = "z",
    unit: Annotated[str, typer.Option(help="Its unit: m or mm.")] = "m",
    hz: Annotated[float, typer.Option(help="Frames a second, with fake.", min=1, max=500)] = 100.0,
    noise: Annotated[float, typer.Option(help="Error of places on one axis, m, with fake.", min=0)] = 0.0005,
    fault: Annotated[
        list[str] | None,
        typer.Option(help="With fake: KIND:FROM:UNTIL:IDS, as occlude:20:23:3 (occlude, swap, jump, freeze, gone)."),
    ] = None,
    port: Annotated[
        int | None, typer.Option(help="UDP port of the emulated team, with fake, as for gs sitl.", min=1, max=65535)
    ] = None,
    seed: Annotated[int, typer.Option(help="Of its noise, with fake.", min=0)] = 0,
    vrpn: Annotated[
        int | None,
        typer.Option(help="With fake: serve bodies by VRPN on this port (3883), to be read as a real system.", min=1),
    ] = None,
    kept: Annotated[bool, typer.Option("--kept", hidden=True, help="Ends with its standard input.")] = False,
    begins_by: Annotated[int | None, typer.Option(hidden=True, help="Waits for a word at this descriptor.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Sends frames of a motion capture system to flights. Ctrl-C ends."""
    from groundstation.app.loop import wall_clock_pace
    from groundstation.app.mocap.reading import Reader, Wire, connect, read
    from groundstation.app.resources import find_config
    from groundstation.mavlink.addresses import parse_address
    from groundstation.mission.plan.reading import load_mission

    out = Output(as_json=as_json)
    if kind not in _KINDS:
        raise UserError(f"gs mocap {kind}: {unknown(kind, _KINDS)}")
    plan = None if mission is None else load_mission(find_config(mission, "missions"))
    given = None if plan is None else plan.spec.positioning
    if plan is not None and (given is None or isinstance(given, str)):
        raise UserError(f"{plan.source}: positioning: no motion capture; write positioning: {{source: mocap}}")
    at = parse_address(link or (_LINK if given is None or isinstance(given, str) else given.link))
    host_of_flight = "127.0.0.1" if at.host in ("", "0.0.0.0") else at.host  # noqa: S104 - compared, not bound
    wire = Wire(host_of_flight, at.port)
    stop = Event()

    def say(line: str) -> None:
        out.console.print(Text(line))
        sys.stdout.flush()

    if kind == "play":
        from groundstation.app.mocap.playing import play
        from groundstation.app.resources import find_log

        if log is None:
            raise UserError("gs mocap play: name the log that is to be played")
        say(f"plays {log} to udp {host_of_flight}:{at.port}")
        out.result({"datagrams": play(find_log(log), wire.send, wall_clock_pace())})
        return
    if kind == "fake":
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
        from groundstation.app.mocap.serving import fake_server, read_faults

        if plan is None:
            raise UserError("gs mocap fake: name the mission whose team is emulated, with --mission")
        server, room = fake_server(plan, seed, port, hz=hz, noise_m=noise, faults=read_faults(fault or [], plan))
        with ExitStack() as stack:
            stack.enter_context(server)
            send, where = wire.send, f"to udp {host_of_flight}:{at.port}"
            if vrpn is not None:
                from groundstation.app.mocap.vrpn import VrpnServer, bodies_of

                served = stack.enter_context(closing(VrpnServer(port=vrpn)))
                names = {vehicle.id: vehicle.body_name for vehicle in plan.spec.vehicles}
                names |= {-number: item.body for number, item in enumerate(plan.moving_bodies, start=1)}
                where = f"by VRPN on 127.0.0.1:{vrpn}"

                def send(data: bytes) -> None:
                    served.send(*bodies_of(data, names))

            say(f"emulates the team of {plan.spec.name}, and its motion capture {where}")
            server.run(stop, room.status(send), status_every_s=1.0 / hz)
        out.result({"frames": room.sent})
        return
    need("mocap", "gs mocap read")
    if given is not None and not isinstance(given, str):
        system, host, up, unit = system or given.system, host or given.host, given.up, given.unit
    if system is None or host is None:
        raise UserError("gs mocap read: --system and --host, or a mission that has them under positioning, are needed")
    ids = {} if plan is None else {vehicle.body_name: vehicle.id for vehicle in plan.spec.vehicles}
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # a system that is silent keeps the process in its own library
    if kept:
        from groundstation.app.mocap.process import end_with_stdin

        end_with_stdin()
    named = obstacle or ([] if plan is None else [item.body for item in plan.moving_bodies])
    others = {name: -number for number, name in enumerate(named, start=1)}
    reader = Reader(others | ids | _bodies(body or []), up=up, unit=unit)
    if begins_by is not None:
        import motioncapture  # noqa: F401 - loaded before it waits

        from groundstation.app.mocap.process import begins_by as begins

        if not begins(begins_by):
            return
    say(f"reads {system} at {host}, sends to udp {host_of_flight}:{at.port}")
    read(connect(system, host), reader, wire)


def _bodies(words: list[str]) -> dict[str, int]:
    """Vehicles by the names of their bodies.

    Raises:
        UserError: another form.
    """
    found = {}
    for word in words:
        name, equals, sysid = word.rpartition("=")
        if not equals or not name or not sysid.isdecimal() or not 1 <= int(sysid) <= 250:
            raise UserError(f"--body {word}: expected NAME=ID, for example cf1=1")
        found[name] = int(sysid)
    return found
