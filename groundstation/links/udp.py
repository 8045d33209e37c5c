"""UDP links: sockets that never block, and never raise into a flight.

A listening link (``udpin://``) answers each peer at the address that it was last heard from. A peer that has gone
away makes the operating system report errors on later calls; they are counted and passed over.
"""

from __future__ import annotations

import socket
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from groundstation.core.errors import UserError

_DATAGRAM_MAX = 65_535
_BURST_MAX = 2_000  # datagrams taken in one call, so that a flood cannot keep the tick waiting
_BUFFER_BYTES = 4 << 20


@dataclass
class UdpLink:
    """One bound UDP socket.

    Attributes:
        url: as the mission writes it.
        socket: for a selector to wait on.
        errors: datagrams that the operating system did not take or deliver.
    """

    url: str
    socket: socket.socket
    errors: int = 0
    _addresses: dict[str, tuple[str, int]] = field(default_factory=dict)

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
            self._addresses[peer] = (address[0], address[1])
            arrived.append((peer, data))
        return arrived

    def send(self, peer: str, data: bytes) -> None:
        """Sends one datagram to a peer that was heard from; what cannot be sent is counted."""
        address = self._addresses.get(peer)
        if address is None:
            self.errors += 1
            return
        try:
            self.socket.sendto(data, address)
        except OSError:
            self.errors += 1

    def __enter__(self) -> UdpLink:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the socket."""
        self.socket.close()


def open_udp(url: str) -> UdpLink:
    """Opens ``udpin://HOST:PORT``.

    Raises:
        UserError: another form, or an address that cannot be listened on.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        parts, host, port = urlsplit(""), None, None
    if parts.scheme != "udpin" or host is None or port is None:
        raise UserError(f"link {url}: expected udpin://HOST:PORT, for example udpin://127.0.0.1:14540")
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0][0]
        listening = socket.socket(family, socket.SOCK_DGRAM)
        listening.setblocking(False)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        listening.bind((host, port))
    except OSError as error:
        raise UserError(
            f"link {url}: cannot listen: {error.strerror or error}; is another ground station using the port?"
        ) from None
    return UdpLink(url, listening)
