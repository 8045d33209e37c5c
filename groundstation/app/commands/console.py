"""``gs console``: the page of a flight that is under way; a process of its own, which may come and go."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from groundstation.app.commands.command import choose_flight
from groundstation.app.order_client import flights, runtime_folder
from groundstation.app.output import Output
from groundstation.core.errors import UserError
from groundstation.core.extras import need

_LOOPBACK = ("127.0.0.1", "localhost")


def console(
    *,
    flight: Annotated[
        str | None, typer.Option(help="Mission, log or process id of the flight, where there are several.")
    ] = None,
    host: Annotated[str, typer.Option(help="Address to serve at; this machine alone by default.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to serve at; 0 for one that is free.", min=0, max=65535)] = 8088,
) -> None:
    """Shows a flight that was begun with gs fly --console in a browser, and takes orders for it.

    Two addresses are printed: whoever has the operator's may give orders, whoever has the viewer's may look. The flight
    goes on whatever becomes of the console.
    """
    need("console", "gs console")
    from groundstation.app.console.serving import FLAT, Place, serve_flight

    out = Output(as_json=False)
    path, about = choose_flight(*flights(runtime_folder(os.environ, Path.home())), flight)
    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((host, port))
            listening.listen()
        except OSError as error:
            raise UserError(f"gs console: {host}:{port}: {error.strerror}; choose another with --port") from error
        port = listening.getsockname()[1]
        place = Place(listening, port, _LOOPBACK if host in _LOOPBACK else (host, *_LOOPBACK))
        keys = place.keys()
        for role, secret in (("operator", keys.operator), ("viewer", keys.viewer)):
            out.console.print(Text(f"{role:8}  http://{host}:{port}/?token={secret}", no_wrap=True), soft_wrap=True)
        out.console.print(Text(f"without the scene in 3D, for small machines: http://{host}:{port}{FLAT}?token=..."))
        out.console.print(Text(_from_afar(host, port)))
        serve_flight(place, keys, path, int(about["pid"]))


def _from_afar(host: str, port: int) -> str:
    tunnel = f"ssh -L {port}:127.0.0.1:{port} {socket.gethostname()}"
    if host in _LOOPBACK:
        return f"from another machine: {tunnel}, then the same address there"
    return (
        f"anybody on the network of {host} can read what is sent, keys too: better leave --host out and tunnel,"
        f" {tunnel}"
    )
