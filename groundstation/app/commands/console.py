"""``gs console``: the page of a flight that is under way, or of recorded ones; a process that may come and go."""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from groundstation.app.commands.command import choose_flight
from groundstation.app.completing import logs, packaged
from groundstation.app.options import StreamOption, check_stream
from groundstation.app.order_client import flights, runtime_folder
from groundstation.app.output import Output
from groundstation.core.errors import UserError
from groundstation.core.extras import need

if TYPE_CHECKING:
    from groundstation.app.console.map_view import Tiles
    from groundstation.app.console.serving import Place

_PORT = 8088
_LOOPBACK = ("127.0.0.1", "localhost")


def console(
    *,
    flight: Annotated[
        str | None, typer.Option(help="Mission, log or process id of the flight, where there are several.")
    ] = None,
    log: Annotated[
        list[Path] | None,
        typer.Option(help="Replay this log instead; twice for two side by side.", autocompletion=logs),
    ] = None,
    edit: Annotated[
        str | None,
        typer.Option(
            "--edit",
            help="Make a mission instead, beginning with this one; it is saved in the current folder.",
            autocompletion=packaged("missions"),
        ),
    ] = None,
    tiles: Annotated[
        Path | None,
        typer.Option("--tiles", help="Folder with tiles for the map, ZOOM/X/Y.png; without it the map is a grid."),
    ] = None,
    stream: StreamOption = None,
    host: Annotated[str, typer.Option(help="Address to serve at; this machine alone by default.")] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(
            help="Port to serve at; 0 for one that is free. 8088, for Foxglove 8765.",
            min=0,
            max=65535,
            show_default=False,
        ),
    ] = None,
) -> None:
    """Shows a flight that was begun with gs fly --console in a browser, and takes orders for it; replays logs; edits.

    Two addresses are printed: whoever has the operator's may give orders, whoever has the viewer's may look. The flight
    goes on whatever becomes of the console.
    """
    out = Output(as_json=False)
    if stream is not None:
        check_stream(stream)
        if log or edit is not None or tiles is not None:
            raise UserError("--stream shows what is under way; leave out --log, --edit and --tiles")
        _stream(out, stream, flight, host, port)
        return
    need("console", "gs console")
    port = _PORT if port is None else port
    if edit is not None:
        if log or flight is not None:
            raise UserError("--edit makes a mission, --log and --flight show what is flown; give one of them")
        _edit(out, edit, host, port)
        return
    if log:
        _replay(out, log, flight, host, port, tiles=tiles)
        return
    from groundstation.app.console.serving import serve_flight

    ground = _ground(tiles)
    path, about = choose_flight(*flights(runtime_folder(os.environ, Path.home())), flight)
    with _listening(host, port) as place:
        keys = place.keys()
        _tell(out, place, host, {"operator": keys.operator, "viewer": keys.viewer})
        serve_flight(place, keys, path, int(about["pid"]), ground)


def _stream(out: Output, to: str, flight: str | None, host: str, port: int | None) -> None:
    """Streams a flight that is under way until it is over; has no page, and takes no orders.

    Raises:
        UserError: the extra is missing, or it cannot listen there.
        CheckFailed: there is no such flight.
    """
    from groundstation.app.console.beside import HOST, PORT

    need(to, f"--stream {to}")
    if host not in _LOOPBACK:
        raise UserError(
            f"--stream {to} --host {host}: anybody there could look on, for Foxglove has no keys; leave --host out and"
            f" tunnel: ssh -L {port or PORT}:{HOST}:{port or PORT} {socket.gethostname()}"
        )
    from groundstation.app.console.feed import Feed, remove_dead
    from groundstation.app.console.streaming import Streamer, stream

    folder = runtime_folder(os.environ, Path.home())
    # Whoever gives a process id means that process, which may be about to begin.
    known = int(flight) if flight is not None and flight.isdecimal() else None
    pid = int(choose_flight(*flights(folder), flight)[1]["pid"]) if known is None else known
    remove_dead(folder)
    feed = Feed(folder, pid)
    try:
        streamer = Streamer(PORT if port is None else port)
        out.console.print(Text(f"Foxglove: open the connection ws://{HOST}:{streamer.port}"))
        sys.stdout.flush()  # gs fly waits for it
        out.console.print(Text(_from_afar(HOST, streamer.port)))
        out.console.print(Text(stream(feed, streamer, lambda: _is_there(pid), time.time_ns)))
        streamer.close()
    finally:
        feed.close()


def _is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    return True


def _ground(tiles: Path | None) -> Tiles | None:
    """What the map is drawn on.

    Raises:
        UserError: there are no tiles.
    """
    from groundstation.app.console.map_view import Tiles

    return None if tiles is None else Tiles(tiles)


def _replay(out: Output, logs: Sequence[Path], flight: str | None, host: str, port: int, *, tiles: Path | None) -> None:
    """Shows recorded flights.

    Raises:
        UserError: they cannot be read, or what is asked for does not go together.
        CheckFailed: there is nothing to be seen in them.
    """
    from groundstation.app.console.recorded import Recorded
    from groundstation.app.console.serving import serve_replay
    from groundstation.app.replaying import useful_flight
    from groundstation.app.resources import find_log

    if flight is not None:
        raise UserError("--log replays what was recorded, --flight shows what is under way; leave one of them out")
    if len(logs) > 2:
        raise UserError(f"--log: {len(logs)} logs, two go side by side at most; gs compare takes more")
    paths, ground = [find_log(log) for log in logs], _ground(tiles)
    shown = [Recorded(useful_flight(out, path, "there is nothing to replay"), path) for path in paths]
    with _listening(host, port) as place:
        keys = place.keys()
        _tell(out, place, host, {"replay": keys.viewer})
        serve_replay(place, keys, shown, ground)


def _edit(out: Output, mission: str, host: str, port: int) -> None:
    """Lets a mission be made.

    Raises:
        UserError: there is no such mission.
    """
    from groundstation.app.console.draft import Draft
    from groundstation.app.console.mission_page import MissionDesk
    from groundstation.app.console.serving import serve_missions
    from groundstation.app.resources import find_config

    Draft(find_config(Path(mission), "missions"))  # what is wrong with it is said here
    with _listening(host, port) as place:
        keys = place.keys()
        _tell(out, place, host, {"missions": keys.operator})
        serve_missions(place, keys, MissionDesk(Path.cwd(), Path(mission)))


@contextmanager
def _listening(host: str, port: int) -> Iterator[Place]:
    """A place that is found by whoever is given its address.

    Raises:
        UserError: it is taken, or not of this machine.
    """
    from groundstation.app.console.serving import Place

    with socket.socket() as item:
        item.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            item.bind((host, port))
            item.listen()
        except OSError as error:
            raise UserError(f"gs console: {host}:{port}: {error.strerror}; choose another with --port") from error
        yield Place(item, item.getsockname()[1], _LOOPBACK if host in _LOOPBACK else (host, *_LOOPBACK))


def _tell(out: Output, place: Place, host: str, secrets: Mapping[str, str]) -> None:
    from groundstation.app.console.serving import FLAT

    at = f"http://{host}:{place.port}"
    for role, secret in secrets.items():
        out.console.print(Text(f"{role:8}  {at}/?token={secret}", no_wrap=True), soft_wrap=True)
    out.console.print(Text(f"without the scene in 3D, for small machines: {at}{FLAT}?token=..."))
    out.console.print(Text(_from_afar(host, place.port)))


def _from_afar(host: str, port: int) -> str:
    tunnel = f"ssh -L {port}:127.0.0.1:{port} {socket.gethostname()}"
    if host in _LOOPBACK:
        return f"from another machine: {tunnel}, then the same address there"
    return (
        f"anybody on the network of {host} can read what is sent, keys too: better leave --host out and tunnel,"
        f" {tunnel}"
    )
