"""``gs gateway``: vehicles that speak no MAVLink, as MAVLink systems for any ground station, until Ctrl-C."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from groundstation.app.completing import choice
from groundstation.app.options import JsonOption
from groundstation.app.output import Output
from groundstation.core.errors import UserError
from groundstation.core.extras import need

_IDS = range(1, 255)
_FASTEST_M_S = 3.0  # no Crazyflie is faster, for telling bodies apart


def gateway(
    kind: Annotated[str, typer.Argument(help="What they are: crazyflie.", autocompletion=choice("crazyflie"))],
    *,
    vehicle: Annotated[
        list[str] | None,
        typer.Option("--vehicle", "-v", help="System id and cflib address, ID=radio://0/80/2M/E7E7E7E701; once each."),
    ] = None,
    out: Annotated[
        str, typer.Option(help="Link to the ground station, as missions write links.")
    ] = "udpout://127.0.0.1:14540",
    log_hz: Annotated[float, typer.Option(help="Poses a second that each vehicle logs.", min=5, max=100)] = 50.0,
    setpoint_hz: Annotated[
        float, typer.Option(help="Setpoints a second of the mission, for the budget.", min=5, max=100)
    ] = 25.0,
    pose_hz: Annotated[
        float, typer.Option(help="Poses a second that another program sends to each by these radios.", min=0, max=200)
    ] = 0.0,
    broadcast: Annotated[
        bool, typer.Option("--broadcast", help="Those poses are packed, two to a packet, for all behind one radio.")
    ] = False,
    room: Annotated[
        str | None,
        typer.Option(
            help="Where frames of the motion capture come in while the ground station is silent, udpin://HOST:PORT; a"
            " flight that is at udpin://HOST:14595 has them sent to port 15595 as well."
        ),
    ] = None,
    radio_packets: Annotated[
        float | None, typer.Option(help="Packets a second that one radio makes, where it was measured.", min=10)
    ] = None,
    cache: Annotated[Path, typer.Option(help="Folder for the vehicles' tables.")] = Path(".crazyflie_cache"),
    kept_since: Annotated[int | None, typer.Option(hidden=True, help="Started and told by a flight, then.")] = None,
    budget: Annotated[bool, typer.Option("--budget", help="Only print the radios' budget.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Serves vehicles that speak no MAVLink as MAVLink systems. Ctrl-C lands whoever flies, and ends."""
    from groundstation.gateway.budget import Rates, check, table

    if kind != "crazyflie":
        raise UserError(f"gs gateway {kind}: not known; crazyflie is")
    uris = read_vehicles(vehicle or [])
    console = Output(as_json=as_json)
    radios, slowest = radios_of(uris, radio_packets)
    rates = Rates(setpoint_hz, log_hz, pose_hz, broadcast)
    lines = table(len(uris), rates, slowest) if kept_since is None and (budget or radios) else []
    for line in lines:
        console.console.print(Text(line))
    for line in check(radios, rates):
        if kept_since is None:  # the flight has said it
            console.console.print(Text(line))
    if budget:
        console.result({"vehicles": len(uris), "radios": len(radios), "budget": lines})
        return
    need("crazyflie", "gs gateway crazyflie")
    from groundstation.app.gateway.serving import serve
    from groundstation.gateway.handover import RoomWord

    def say(line: str) -> None:
        console.console.print(Text(line))
        sys.stdout.flush()

    if kept_since is None:
        say(f"{len(uris)} Crazyflies to {out}: {', '.join(map(str, uris))}. Ctrl-C lands whoever flies, and ends.")
    heard = None if room is None else RoomWord(room, False, _FASTEST_M_S, setpoint_hz)
    counts = serve(
        uris, out, cache=cache, pose_hz=log_hz, say=say, broadcast=broadcast, kept_since_ns=kept_since, room=heard
    )
    if kept_since is None:
        console.result({**counts})


def read_vehicles(words: list[str]) -> dict[int, str]:
    """Addresses by system id.

    Raises:
        UserError: none at all, another form, an id or an address twice.
    """
    uris: dict[int, str] = {}
    for word in words:
        sysid, equals, uri = word.partition("=")
        if not equals or not sysid.isdecimal() or int(sysid) not in _IDS or "://" not in uri:
            raise UserError(
                f"--vehicle {word}: expected ID=ADDRESS with an id of 1 to 254, for example"
                " 1=radio://0/80/2M/E7E7E7E701 or 1=udp://127.0.0.1:19850"
            )
        if int(sysid) in uris or uri in uris.values():
            raise UserError(f"--vehicle {word}: its id or its address stands twice; each vehicle has its own")
        uris[int(sysid)] = uri
    if not uris:
        raise UserError("--vehicle: none given; write --vehicle 1=radio://0/80/2M/E7E7E7E701 for each")
    return uris


def radios_of(uris: dict[int, str], packets_s: float | None) -> tuple[dict[str, tuple[int, float]], float]:
    """Vehicles and packets a second of each radio, and of the slowest one."""
    from groundstation.gateway.budget import capacity
    from groundstation.mavlink.addresses import radio_of

    found = [radio for uri in uris.values() if (radio := radio_of(uri)) is not None]
    count = Counter(number for number, _ in found)
    radios = {
        number: (
            count[number],
            packets_s or min(capacity(rate) for other, rate in found if other == number),
        )
        for number in count
    }
    return radios, min((each for _, each in radios.values()), default=packets_s or capacity("2M"))
