"""Serves the page: one process, one flight; its own port on this machine."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from nicegui import app, context, ui

from groundstation.app.console.feed import Feed, remove_dead
from groundstation.app.console.guard import Guard, Keys
from groundstation.app.console.helm import HelmSeat
from groundstation.app.console.page import Desk, Page
from groundstation.app.order_client import ask

_ANSWER_S = 5.0
_READ_S = 0.05


@dataclass(frozen=True)
class Served:
    """What is served and where.

    Attributes:
        host, port: where it listens.
        names: by which it may be called.
        orders: the flight's order socket.
        pid: the flight's process.
    """

    host: str
    port: int
    names: tuple[str, ...]
    orders: Path
    pid: int

    def keys(self) -> Keys:
        """New secrets."""
        hosts = frozenset(f"{name}:{self.port}" for name in self.names)
        return Keys(secrets.token_urlsafe(24), secrets.token_urlsafe(24), hosts, f"gs_console_{self.port}")


def serve(served: Served, keys: Keys) -> None:
    """Serves until it is ended."""
    remove_dead(served.orders.parent)
    feed = Feed(served.orders.parent, served.pid)

    def tell(order: str, by: str) -> Mapping[str, object]:
        try:
            return ask(served.orders, {"order": order, "by": by}, _ANSWER_S)
        except (OSError, ValueError) as error:
            return {"ok": False, "why": f"the flight did not answer: {error}; whether it was obeyed is not known"}

    desk = Desk(feed, HelmSeat(), tell)

    @ui.page("/")
    def page() -> None:
        client = context.client
        request = client.request
        role = None if request is None else keys.role_of_cookies(request.headers.get("cookie", ""))
        if role is None:  # the guard has seen to it
            return
        address = request.client.host if request is not None and request.client is not None else "?"
        Page(desk, role, client.id, f"console {role.value} {client.id[:4]} at {address}")
        client.on_delete(lambda: desk.helm.leave(client.id))

    app.add_middleware(Guard, keys=keys)
    app.on_shutdown(feed.close)
    app.timer(_READ_S, feed.read)
    ui.run(
        host=served.host,
        port=served.port,
        title="gs console",
        dark=None,
        reload=False,
        show=False,
        show_welcome_message=False,
        uvicorn_logging_level="warning",
    )
