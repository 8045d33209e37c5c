"""Serves pages: one process, one flight; its own port on this machine."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from nicegui import app, context, ui

from groundstation.app.console.feed import Feed, remove_dead
from groundstation.app.console.guard import Guard, Keys, Role
from groundstation.app.console.helm import HelmSeat
from groundstation.app.console.map_view import Tiles
from groundstation.app.console.mission_page import MissionDesk, MissionPage
from groundstation.app.console.page import Desk, Page
from groundstation.app.console.recorded import Recorded
from groundstation.app.console.replay_page import ReplayPage
from groundstation.app.order_client import ask

_ANSWER_S = 5.0
_READ_S = 0.05
_OUT_OF_TOUCH_S = 30.0  # a page that is slow or far away stays what it is, and keeps the helm, for so long
_CLOSE_S = 1  # to pages that are open when it is ended
SOLID, FLAT, DRY = "/", "/flat", "/dry"
"""Pages with the scene in three dimensions and without it, and the last dry run of a mission desk."""

PageMaker = Callable[[Role, str, str, bool], Callable[[], None]]
"""Builds a page for a role, its own name, its name for people, and whether with the scene; returns what to do when it
is closed."""


@dataclass(frozen=True)
class Place:
    """Where pages are served.

    Attributes:
        socket: bound and listening, so that whoever is given the address finds somebody there.
        port: where it listens.
        names: by which it may be called.
    """

    socket: socket.socket
    port: int
    names: tuple[str, ...]

    def keys(self) -> Keys:
        """New secrets."""
        hosts = frozenset(f"{name}:{self.port}" for name in self.names)
        return Keys(
            secrets.token_urlsafe(24), secrets.token_urlsafe(24), hosts, f"gs_console_{self.port}", frozenset({FLAT})
        )


def serve_flight(place: Place, keys: Keys, orders: Path, pid: int, tiles: Tiles | None) -> None:
    """Shows a flight that is under way until the console is ended.

    Args:
        place: where.
        keys: who is let in.
        orders: the flight's order socket.
        pid: the flight's process.
        tiles: for the map of a mission by GPS; None for a plain grid.
    """
    remove_dead(orders.parent)
    feed = Feed(orders.parent, pid)

    def tell(order: str, by: str) -> Mapping[str, object]:
        try:
            return ask(orders, {"order": order, "by": by}, _ANSWER_S)
        except (OSError, ValueError) as error:
            return {"ok": False, "why": f"the flight did not answer: {error}; whether it was obeyed is not known"}

    desk = Desk(feed, HelmSeat(), tell, _served(tiles))

    def make(role: Role, page: str, name: str, solid: bool) -> Callable[[], None]:
        Page(desk, role, page, name, solid=solid)
        return lambda: desk.helm.leave(page)

    app.on_shutdown(feed.close)
    app.timer(_READ_S, feed.read)
    serve(place, keys, make)


def serve_replay(place: Place, keys: Keys, flights: Sequence[Recorded], tiles: Tiles | None) -> None:
    """Shows recorded flights, one or two, until the console is ended; ``tiles`` as in ``serve_flight``."""
    ground = _served(tiles)

    def make(_role: Role, _page: str, _name: str, solid: bool) -> Callable[[], None]:
        return ReplayPage(flights, solid=solid, tiles=ground).closed

    serve(place, keys, make)


def serve_missions(place: Place, keys: Keys, desk: MissionDesk) -> None:
    """Lets missions be made until the console is ended."""

    def make(_role: Role, _page: str, _name: str, solid: bool) -> Callable[[], None]:
        return MissionPage(desk, solid=solid).closed

    @ui.page(DRY)
    def watch() -> None:
        if desk.flown is None:
            ui.label("no dry run yet")
        else:
            ReplayPage([desk.flown], solid=True)

    serve(place, keys, make)


def _served(tiles: Tiles | None) -> tuple[str, int] | None:
    """Where pages find tiles, and the finest zoom."""
    return None if tiles is None else (tiles.serve(), tiles.zoom_max)


def serve(place: Place, keys: Keys, make: PageMaker) -> None:
    """Serves pages until it is ended."""

    def page(*, solid: bool) -> None:
        client = context.client
        request = client.request
        role = None if request is None else keys.role_of_cookies(request.headers.get("cookie", ""))
        if request is None or role is None:  # the guard has seen to it
            return
        address = request.client.host if request.client is not None else "?"
        client.on_delete(make(role, client.id, f"console {role.value} {client.id[:4]} at {address}", solid))

    for path in (SOLID, FLAT):
        ui.page(path)(lambda path=path: page(solid=path == SOLID))
    outer = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    ui.run_with(outer, title="gs console", dark=None, show_welcome_message=False, reconnect_timeout=_OUT_OF_TOUCH_S)
    config = uvicorn.Config(Guard(outer, keys), ws="wsproto", log_level="warning", timeout_graceful_shutdown=_CLOSE_S)
    uvicorn.Server(config).run(sockets=[place.socket])
