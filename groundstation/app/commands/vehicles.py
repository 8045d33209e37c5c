"""``gs vehicles``: what is there, and the block of a mission file that names it."""

from __future__ import annotations

from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from groundstation.app.options import JsonOption
from groundstation.app.output import Output
from groundstation.core.errors import MissionFailed, UserError

if TYPE_CHECKING:
    from groundstation.mavlink.station import Outgoing

_DEFAULT = ["udpin://0.0.0.0:14540"]


def vehicles(
    urls: Annotated[
        list[str] | None,
        typer.Argument(help="Links to look at; udpin://0.0.0.0:14540 by default. For Crazyflies radio://, or udp://."),
    ] = None,
    *,
    key: Annotated[
        Path | None, typer.Option("--key", help="Key file of vehicles that sign; the others are not heard then.")
    ] = None,
    seconds: Annotated[float, typer.Option(help="How long to look.", min=0.5, max=600)] = 4.0,
    as_json: JsonOption = False,
) -> None:
    """Finds the vehicles on links and prints a ``vehicles:`` block for a mission file. Arms nothing.

    Ends with 1 when nobody is heard, when a link does not work, or when two vehicles bear one system id: these are left
    out of the block.
    """
    from groundstation.app.discovery import Discovery, show_found
    from groundstation.app.loop import FlightClock, Interrupts, talk
    from groundstation.app.signing import gate_of
    from groundstation.links.opening import open_link
    from groundstation.mavlink.addresses import is_crtp, parse_address

    out = Output(as_json=as_json)
    given = list(dict.fromkeys(urls or _DEFAULT))
    crazyflies = [url for url in given if is_crtp(url)]
    if crazyflies:
        if len(crazyflies) < len(given):
            raise UserError(
                "gs vehicles: radio:// and udp:// are asked by cflib, other links by MAVLink; one at a time"
            )
        _find_crazyflies(out, crazyflies)
        return
    addresses = [parse_address(url) for url in given]
    discovery = Discovery(addresses)
    interrupts = Interrupts()
    with ExitStack() as stack:
        links = [stack.enter_context(closing(open_link(address.url))) for address in addresses]
        stack.enter_context(interrupts.listening())
        clock = FlightClock()
        gate = None
        if key is not None:
            streams = [number for number, address in enumerate(addresses) if address.is_stream]
            count = len(addresses)
            gate = gate_of([key] * count, range(count), clock.epoch_unix_us, streams=streams, keep_times=True)

        def receive(link: int, peer: str, data: bytes, now_ns: int) -> None:
            for piece in (data,) if gate is None else gate.let_in(link, peer, data, now_ns):
                discovery.receive(link, peer, piece, now_ns)

        def outgoing(now_ns: int) -> list[Outgoing]:
            sent = discovery.outgoing(now_ns)
            return sent if gate is None else gate.sign(sent, now_ns) + gate.greetings(now_ns)

        now_ns = talk(links, clock, seconds, receive=receive, outgoing=outgoing, interrupts=interrupts)
        broken = [f"link {link.url}: {link.state}" for link in links if link.state]
        troubles = broken + [f"link {link.url}: left out: {link.left_out}" for link in links if link.left_out]
        if gate is not None:
            gate.close()
            troubles += gate.words([address.url for address in addresses], {})
    found, doubles = discovery.vehicles(), discovery.doubles(now_ns)
    unflown = discovery.unflown()
    show_found(out, discovery, [*troubles, *doubles, *unflown], now_ns)
    failures = [*broken, *doubles]
    if not found:
        looked = ", ".join(address.url for address in addresses)
        failures = [f"no vehicle was heard in {seconds:g} s on {looked}; is it switched on, and the address right?"]
        failures += unflown
    failed = {"error": "; ".join(failures), "exit_code": MissionFailed.exit_code} if failures else {}
    out.result(
        {
            "vehicles": [
                {
                    "id": item.sysid,
                    "link": addresses[item.link].url,
                    "autopilot": item.autopilot.name if item.autopilot else None,
                    "type": item.type_name,
                    "why_not": item.why_not,
                    "version": item.version,
                    "mode": item.mode_name,
                    "armed": item.armed,
                    "place": item.place_deg_m,
                }
                for item in found
            ],
            "problems": [*troubles, *doubles, *unflown],
            "block": discovery.block(now_ns),
            **failed,
        }
    )
    if failures:
        raise MissionFailed("; ".join(failures))


def _find_crazyflies(out: Output, wishes: list[str]) -> None:
    """Asks by cflib who is there, and prints a block for a mission file.

    Raises:
        MissionFailed: nobody answers.
    """
    from groundstation.app.gateway.finding import block, found, radio_scan
    from groundstation.core.extras import need

    if any(wish.startswith("radio://") for wish in wishes):
        need("crazyflie", "gs vehicles radio://")
    uris = found(wishes, radio_scan)
    words = block(uris) if uris else ""
    if words:
        out.console.print(words, markup=False, highlight=False, soft_wrap=True)
    failed = f"no Crazyflie answers at {', '.join(wishes)}; is it switched on, and its address right?"
    failure = {} if uris else {"error": failed, "exit_code": MissionFailed.exit_code}
    out.result({"vehicles": [{"link": uri} for uri in uris], "problems": [], "block": words, **failure})
    if not uris:
        raise MissionFailed(failed)
