"""UDP links: sockets that never block, and never raise into a flight.

A listening link (``udpin://``) answers each peer at the address that it was last heard from; a speaking one
(``udpout://``) knows its peer from the start and takes answers from anybody. A peer that has gone away makes the
operating system report errors on later calls; they are counted and passed over.
"""

from __future__ import annotations

import socket
from dataclasses import dataclass, field

from groundstation.core.errors import UserError
from groundstation.mavlink.addresses import parse_address

_DATAGRAM_MAX = 65_535
_BURST_MAX = 2_000  # datagrams taken in one call, so that a flood cannot keep the tick waiting
_BUFFER_BYTES = 4 << 20
_PEERS_MAX = 1_000


@dataclass
class UdpLink:
    """One bound UDP socket; see ``Link``."""

    url: str
    socket: socket.socket
    errors: int = 0
    state: str = ""
    _addresses: dict[str, tuple[str, int]] = field(default_factory=dict)
    _peers: tuple[str, ...] = ()
    _spoken_to: dict[str, None] = field(default_factory=dict)

    def sources(self) -> tuple[int, ...]:
        """The socket."""
        return (self.socket.fileno(),)

    def service(self, now_ns: int) -> None:
        """Nothing is ever due."""

    def peers(self) -> tuple[str, ...]:
        """The other end of ``udpout://``."""
        return self._peers

    def receive(self) -> list[tuple[str, bytes]]:
        """Takes what has arrived: (peer as ``host:port``, datagram) each, in order of arrival."""
        arrived = []
        for _ in range(_BURST_MAX):
            try:
                data, address = self.socket.recvfrom(_DATAGRAM_MAX)
            except BlockingIOError:
                break
            except OSError:  # an ICMP error of an earlier send
                self.errors += 1
                continue
            peer = f"{address[0]}:{address[1]}"
            if peer not in self._addresses and len(self._addresses) >= _PEERS_MAX:
                self._forget_one()
            self._addresses[peer] = (address[0], address[1])
            arrived.append((peer, data))
        return arrived

    def _forget_one(self) -> None:
        """Makes room for a new address: the oldest to which nothing was ever sent goes, if there is one."""
        oldest = next((peer for peer in self._addresses if peer not in self._spoken_to), next(iter(self._addresses)))
        del self._addresses[oldest]
        self._spoken_to.pop(oldest, None)

    def send(self, peer: str, data: bytes) -> None:
        """Sends one datagram to a peer that was heard from; what cannot be sent is counted."""
        address = self._addresses.get(peer)
        if address is None:
            self.errors += 1
            return
        self._spoken_to[peer] = None
        try:
            self.socket.sendto(data, address)
        except OSError:
            self.errors += 1

    def close(self) -> None:
        """Closes the socket."""
        self.socket.close()

    def __enter__(self) -> UdpLink:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the socket."""
        self.close()


def open_udp(url: str) -> UdpLink:
    """Opens ``udpin://HOST:PORT`` or ``udpout://HOST:PORT``.

    Raises:
        UserError: another form, or an address that cannot be had.
    """
    address = parse_address(url)
    if address.kind not in ("udpin", "udpout"):
        raise UserError(f"link {url}: expected udpin://HOST:PORT or udpout://HOST:PORT")
    listens = address.kind == "udpin"
    item: socket.socket | None = None
    try:
        family, _, _, _, there = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
        item = socket.socket(family, socket.SOCK_DGRAM)
        item.setblocking(False)
        item.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        item.bind((address.host, address.port) if listens else ("", 0))
    except (OSError, ValueError) as error:  # ValueError: what no name of a host can be
        if item is not None:
            item.close()
        what = "cannot listen" if listens else "cannot be reached"
        remedy = "is another ground station using the port?" if listens else "correct the address"
        raise UserError(f"link {url}: {what}: {getattr(error, 'strerror', None) or error}; {remedy}") from None
    link = UdpLink(url, item)
    if not listens:
        host, port = str(there[0]), int(there[1])
        for name in (address.peer, f"{host}:{port}"):  # as written, and as answers will come
            link._addresses[name] = (host, port)
        link._peers = (address.peer,)
    return link
