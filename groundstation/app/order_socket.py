"""Orders from a second terminal: a local socket that only the owner of the flight can reach.

One line of JSON in, one line of JSON out: ``{"order": "hold"}`` is answered with what became of it, ``{"about": true}``
with which flight this is. ``"by"`` beside an order says who gives it, for the log. The socket lies in a folder of mode
0700, has mode 0600 itself, and the kernel's word on who is at the other end is asked for too. Nothing a client does can
hold up a tick: lines, clients, orders per tick and answers that wait are all bounded, and a client that sends too much
is not listened to until the next tick.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import stat
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from groundstation.app.order_client import ANSWERS_MAX, is_ours, one_line, remove_stale
from groundstation.app.session import Session
from groundstation.core.errors import UserError

LINE_MAX = 1024
_CLIENTS_MAX = 8
_LINES_MAX = 16  # that wait, of one client
_ORDERS_PER_TICK = 4
_BYTES_PER_TICK = 4096
_IDLE_NS = 10_000_000_000
_NAME_MAX = 60
_PATH_MAX = 100  # what a socket's address holds, less a little


def prepare_folder(folder: Path) -> None:
    """Makes the folder, for the owner alone.

    Raises:
        OSError: it cannot be made, is somebody else's, or is no folder.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    there = folder.lstat()
    if not stat.S_ISDIR(there.st_mode) or there.st_uid != os.geteuid():
        raise PermissionError(f"{folder} is not a folder of this user")
    if there.st_mode & 0o077:
        folder.chmod(0o700)


def printable(name: str) -> str:
    """A name that somebody gave, cut to one short line."""
    return "".join(letter if letter.isprintable() else "?" for letter in name[:_NAME_MAX])


@dataclass
class _Client:
    """One connection."""

    item: socket.socket
    heard_ns: int
    received: bytearray = field(default_factory=bytearray)
    lines: deque[bytes] = field(default_factory=deque)
    answers: bytearray = field(default_factory=bytearray)
    budget: int = _BYTES_PER_TICK
    ended: bool = False


class OrderSocket:
    """The listening end, one of the loop's controls, see ``loop.Control``.

    Args:
        folder: for the socket.
        about: what to tell of this flight: ``mission``, ``log``, ``pid``, ``vehicles``.

    Attributes:
        path: of the socket.
        refused: connections of other users.
    """

    def __init__(self, folder: Path, about: Mapping[str, Any]) -> None:
        self.path = folder / f"{os.getpid()}.sock"
        self.refused = 0
        self._folder = folder
        self._about = dict(about)
        self._listener: socket.socket | None = None
        self._clients: list[_Client] = []
        self._waiting: list[tuple[_Client, str]] = []
        self._now_ns = 0

    def __enter__(self) -> OrderSocket:
        """Begins to listen.

        Raises:
            UserError: the socket cannot be made.
        """
        try:
            prepare_folder(self._folder)
            remove_stale(self._folder)
            if len(str(self.path)) > _PATH_MAX:
                raise OSError(f"{self.path} is too long for a socket's name")
            self.path.unlink(missing_ok=True)
            self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            self._listener.setblocking(False)
            self._listener.bind(str(self.path))
            self.path.chmod(0o600)
            self._listener.listen(_CLIENTS_MAX)
        except OSError as error:
            self.close()
            raise UserError(f"no orders from a second terminal: {error.strerror or error}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Removes the socket."""
        self.close()

    def close(self) -> None:
        """Removes the socket and ends all connections."""
        for client in self._clients:
            client.item.close()
        self._clients.clear()
        if self._listener is not None:
            self._listener.close()
            self._listener = None
            with contextlib.suppress(OSError):
                self.path.unlink(missing_ok=True)

    def sources(self) -> tuple[int, ...]:
        """The listener, and those who may still speak in this tick."""
        listening = () if self._listener is None else (self._listener.fileno(),)
        return (*listening, *(client.item.fileno() for client in self._clients if self._listens_to(client)))

    @staticmethod
    def _listens_to(client: _Client) -> bool:
        return client.budget > 0 and len(client.lines) < _LINES_MAX and not client.ended

    def read(self) -> None:
        """Takes connections and lines, as far as there are any."""
        self._accept()
        for client in list(self._clients):
            if self._listens_to(client) and not self._receive(client):
                self._drop(client)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while self._listener is not None:
                item, _ = self._listener.accept()
                item.setblocking(False)
                if not is_ours(item):
                    item.close()
                    self.refused += 1
                    continue
                if len(self._clients) >= _CLIENTS_MAX:  # whoever was silent longest makes room
                    self._drop(min(self._clients, key=lambda client: client.heard_ns))
                self._clients.append(_Client(item, self._now_ns))

    def _receive(self, client: _Client) -> bool:
        """Takes what has arrived; returns False when the connection is to end."""
        try:
            data = client.item.recv(LINE_MAX)
        except BlockingIOError:
            return True
        except OSError:
            return False
        if not data:
            client.ended = True  # whoever has asked and hung up is not answered, but obeyed
            return bool(client.lines)
        client.budget -= len(data)
        client.heard_ns = self._now_ns
        *lines, rest = (client.received + data).split(b"\n")
        client.received = rest
        client.lines.extend(bytes(line) for line in lines if line.strip())
        return len(rest) <= LINE_MAX and all(len(line) <= LINE_MAX for line in lines)

    def _drop(self, client: _Client) -> None:
        client.item.close()
        self._clients.remove(client)
        self._waiting = [item for item in self._waiting if item[0] is not client]

    def apply(self, session: Session, now_ns: int) -> None:
        """Acts on the lines that have come in: a few in each tick."""
        self._now_ns = now_ns
        orders = 0
        for client in list(self._clients):
            client.budget = _BYTES_PER_TICK
            if now_ns - client.heard_ns > _IDLE_NS and not client.lines:
                self._drop(client)
                continue
            while client.lines and orders < _ORDERS_PER_TICK:
                orders += 1
                self._obey(client, client.lines.popleft(), session, now_ns)

    def _obey(self, client: _Client, line: bytes, session: Session, now_ns: int) -> None:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError):
            request = None
        order = request.get("order") if isinstance(request, dict) else None
        if isinstance(order, str):
            try:
                plain = session.operator(order, now_ns)
                if isinstance(by := request.get("by"), str):  # who pressed what is in the log
                    session.remark("info", f"order {plain}: given by {printable(by)}", now_ns)
            except ValueError as error:
                self._answer(client, {"ok": False, "order": order, "why": str(error)})
            else:
                self._waiting.append((client, plain))
        elif isinstance(request, dict) and request.get("about"):
            self._answer(client, {"ok": True, "phase": session.runner.phase.value, **self._about})
        else:
            self._answer(client, {"ok": False, "why": 'expected a line {"order": "hold"} or {"about": true}'})

    def answer(self, session: Session) -> None:
        """Tells, after the tick, what became of the orders, and sends what still waits to be sent."""
        waiting, self._waiting = self._waiting, []
        if waiting:
            said = [note.text for note in session.said if note.kind in ("alarm", "info", "phase")]
            phase = session.runner.phase.value
            for client, order in waiting:
                refusal = next((text for text in said if text.startswith(f"operator: {order} refused: ")), None)
                values = {"ok": refusal is None, "order": order, "phase": phase, "said": said}
                self._answer(
                    client, values if refusal is None else {**values, "why": refusal.partition("refused: ")[2]}
                )
        for client in list(self._clients):
            if (client.answers and not self._send(client)) or (client.ended and not client.lines):
                self._drop(client)

    @staticmethod
    def _answer(client: _Client, values: Mapping[str, Any]) -> None:
        client.answers += one_line(values)

    @staticmethod
    def _send(client: _Client) -> bool:
        """Sends what the other end takes now; returns False for one that is gone or never reads."""
        try:
            del client.answers[: client.item.send(client.answers)]
        except BlockingIOError:
            pass
        except OSError:
            return False
        return len(client.answers) <= ANSWERS_MAX
