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
    port: Annotated[int, typer.Option(help="Port to serve at.", min=1, max=65535)] = 8088,
) -> None:
    """Shows a flight that was begun with gs fly --console in a browser, and takes orders for it.

    Two addresses are printed: whoever has the operator's may give orders, whoever has the viewer's may look. The flight
    goes on whatever becomes of the console.
    """
    need("console", "gs console")
    from groundstation.app.console.serving import Served, serve

    out = Output(as_json=False)
    path, about = choose_flight(*flights(runtime_folder(os.environ, Path.home())), flight)
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise UserError(f"gs console: {host}:{port}: {error.strerror}; choose another with --port") from error
    names = _LOOPBACK if host in _LOOPBACK else (host, *_LOOPBACK)
    served = Served(host, port, names, path, int(about["pid"]))
    keys = served.keys()
    for role, secret in (("operator", keys.operator), ("viewer", keys.viewer)):
        out.console.print(Text(f"{role:8}  http://{host}:{port}/?token={secret}", no_wrap=True), soft_wrap=True)
    if host in _LOOPBACK:
        words = (
            f"from another machine: ssh -L {port}:127.0.0.1:{port} {socket.gethostname()}, then the same address there"
        )
    else:
        words = (
            f"anybody on the network of {host} can read what is sent, keys too: better leave --host out and tunnel,"
            f" ssh -L {port}:127.0.0.1:{port} {socket.gethostname()}"
        )
    out.console.print(Text(words))
    serve(served, keys)
