"""TCP links: one connection that is opened again when it breaks, or a listener that takes whoever comes.

Everything is non-blocking; a connection that cannot be made is tried again once a second. An other end that reads too
slowly loses whole datagrams, never halves of frames.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
from collections.abc import Collection

from groundstation.core.errors import UserError
from groundstation.links.link import RECEIVE_BYTES, RETRY_NS, STRANGERS_BYTES, Backlog
from groundstation.mavlink.addresses import LinkAddress

_CONNECT_NS = 5_000_000_000
_CONNECTIONS_MAX = 64


class _Connection:
    """One established connection with what waits to be sent over it."""

    def __init__(self, item: socket.socket, peer: str) -> None:
        item.setblocking(False)
        with contextlib.suppress(OSError):
            item.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket = item
        self.peer = peer
        self._backlog = Backlog()

    def receive(self, most: int) -> bytes | None:
        """What has arrived, b"" for nothing, None when the connection has ended."""
        try:
            return self.socket.recv(most) or None
        except BlockingIOError:
            return b""
        except OSError:
            return None

    def send(self, data: bytes) -> bool:
        """Sends or keeps; returns False when the piece had to be left out."""
        kept = self._backlog.add(data)
        self.flush()
        return kept

    def flush(self) -> None:
        """Sends what waits; errors show on the next ``receive``."""
        if self._backlog:
            with contextlib.suppress(OSError):
                self._backlog.taken(self.socket.send(self._backlog.head()))


class TcpClientLink:
    """``tcpout://HOST:PORT``: connects, and connects again; see ``Link``.

    Args:
        address: where to.
    """

    left_out = ""

    def __init__(self, address: LinkAddress) -> None:
        self.url = address.url
        self.errors = 0
        self.state = "not connected yet"
        self._peer = f"{address.host}:{address.port}"
        self._where = _resolve(address)
        self._pending: socket.socket | None = None
        self._connection: _Connection | None = None
        self._next_ns: int | None = None
        self._give_up_ns = 0

    def sources(self) -> tuple[int, ...]:
        """The connection, when there is one."""
        return () if self._connection is None else (self._connection.socket.fileno(),)

    def peers(self) -> tuple[str, ...]:
        """The other end."""
        return (self._peer,)

    def service(self, now_ns: int) -> None:
        """Begins, awaits and ends attempts to connect; sends what waits."""
        if self._connection is not None:
            self._connection.flush()
        elif self._pending is not None:
            self._await(self._pending, now_ns)
        elif self._next_ns is None or now_ns >= self._next_ns:
            self._begin(now_ns)

    def _begin(self, now_ns: int) -> None:
        family, where = self._where
        item = socket.socket(family, socket.SOCK_STREAM)
        item.setblocking(False)
        code = item.connect_ex(where)
        self._pending, self._give_up_ns = item, now_ns + _CONNECT_NS
        if code not in (0, errno.EINPROGRESS, errno.EWOULDBLOCK):
            self._fail(code, now_ns)
        else:
            self._await(item, now_ns)

    def _await(self, item: socket.socket, now_ns: int) -> None:
        code = item.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            self._fail(code, now_ns)
            return
        try:
            item.getpeername()
        except OSError:  # not yet
            if now_ns >= self._give_up_ns:
                self._fail(errno.ETIMEDOUT, now_ns)
            return
        self._pending, self.state = None, ""
        self._connection = _Connection(item, self._peer)

    def _fail(self, code: int, now_ns: int) -> None:
        self.state = f"cannot connect: {os.strerror(code)}"
        if self._pending is not None:
            self._pending.close()
        self._pending, self._next_ns = None, now_ns + RETRY_NS

    @property
    def behind(self) -> bool:
        """Nothing is kept."""
        return False

    def know(self, peers: Collection[str]) -> None:
        """There is nobody else."""

    def receive(self, most: int = RECEIVE_BYTES) -> list[tuple[str, bytes]]:
        """Takes what has arrived; notices the end of the connection."""
        connection = self._connection
        if connection is None:
            return []
        data = connection.receive(most)
        if data is None:
            connection.socket.close()
            self._connection, self.state = None, "the other end closed the connection"
            self.errors += 1
            return []
        return [(self._peer, data)] if data else []

    def send(self, peer: str, data: bytes) -> None:
        """Sends whole frames to the other end."""
        if self._connection is None or not self._connection.send(data):
            self.errors += 1

    def close(self) -> None:
        """Closes the connection."""
        for item in (self._pending, self._connection.socket if self._connection else None):
            if item is not None:
                item.close()
        self._pending = self._connection = None


class TcpServerLink:
    """``tcpin://HOST:PORT``: takes whoever connects; see ``Link``.

    Args:
        address: where to listen.
    """

    left_out = ""

    def __init__(self, address: LinkAddress) -> None:
        self.url = address.url
        self.errors = 0
        self._connections: dict[str, _Connection] = {}
        self._known: Collection[str] = ()
        family, where = _resolve(address)
        self.listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self.listener.setblocking(False)
            self.listener.bind(where)
            self.listener.listen()
        except OSError as error:
            self.listener.close()
            raise UserError(
                f"link {self.url}: cannot listen: {error.strerror or error}; is another program using the port?"
            ) from None

    @property
    def state(self) -> str:
        """Whether anybody has connected."""
        return "" if self._connections else "nobody has connected"

    def sources(self) -> tuple[int, ...]:
        """The listener and all connections."""
        return (self.listener.fileno(), *(item.socket.fileno() for item in self._connections.values()))

    def peers(self) -> tuple[str, ...]:
        """Whoever is connected."""
        return tuple(self._connections)

    def service(self, now_ns: int) -> None:
        """Sends what waits."""
        for connection in self._connections.values():
            connection.flush()

    @property
    def behind(self) -> bool:
        """Nothing is kept."""
        return False

    def know(self, peers: Collection[str]) -> None:
        """They come first, and may say more at a time."""
        self._known = frozenset(peers)

    def receive(self, most: int = RECEIVE_BYTES) -> list[tuple[str, bytes]]:
        """Takes new connections, what has arrived, and leave of those that have ended.

        Strangers share what those that are known leave; another one is first every time.
        """
        self._accept()
        arrived: list[tuple[str, bytes]] = []
        left = most
        for peer in [peer for peer in self._connections if peer in self._known]:
            left -= self._take(peer, most, arrived)
        left = min(left, STRANGERS_BYTES) if self._known else left
        for peer in [peer for peer in self._connections if peer not in self._known]:
            if left <= 0:
                break
            left -= self._take(peer, min(left, STRANGERS_BYTES), arrived)
            if peer in self._connections:
                self._connections[peer] = self._connections.pop(peer)
        return arrived

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            for _ in range(_CONNECTIONS_MAX):
                item, address = self.listener.accept()
                peer = f"{address[0]}:{address[1]}"
                if len(self._connections) >= _CONNECTIONS_MAX:
                    item.close()
                    self.errors += 1
                else:
                    self._connections[peer] = _Connection(item, peer)

    def _take(self, peer: str, most: int, arrived: list[tuple[str, bytes]]) -> int:
        """Takes bytes from one connection, or leave of it; returns how many came."""
        connection = self._connections[peer]
        data = connection.receive(most)
        if data is None:
            connection.socket.close()
            del self._connections[peer]
        elif data:
            arrived.append((peer, data))
        return len(data or b"")

    def send(self, peer: str, data: bytes) -> None:
        """Sends whole frames to one that is connected."""
        connection = self._connections.get(peer)
        if connection is None or not connection.send(data):
            self.errors += 1

    def close(self) -> None:
        """Closes everything."""
        for connection in self._connections.values():
            connection.socket.close()
        self._connections.clear()
        self.listener.close()


def _resolve(address: LinkAddress) -> tuple[int, tuple[str, int]]:
    try:
        family, _, _, _, where = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)[0]
    except (OSError, ValueError) as error:  # ValueError: what no name of a host can be
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"link {address.url}: no such host: {reason}; correct the address") from None
    return family, (str(where[0]), int(where[1]))
