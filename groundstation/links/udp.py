"""UDP links: sockets that never block, and never raise into a flight.

A listening link (``udpin://``) answers each peer at the address that it was last heard from; a speaking one
(``udpout://``) knows its peer from the start and takes answers from anybody. A peer that has gone away makes the
operating system report errors on later calls; they are counted and passed over.

Those that vehicles were heard from come before strangers. On Linux they have a socket of their own on the same port
(``steering``), so that a flood of others fills another queue than theirs. Elsewhere all is taken out of one queue, and
what strangers sent waits, or is left out when it is too much. Long datagrams of strangers are left out at once.

What one sender said never comes in another order than he said it in. Whoever becomes known may have old datagrams in
the strangers' socket: what is quickly had of them comes first, and what is found there when newer ones have come
already is left out.
"""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field

from groundstation.core.errors import UserError
from groundstation.links.link import LONGEST_OF_STRANGERS, RECEIVE_BYTES, STRANGERS_BYTES
from groundstation.links.steering import open_pair, steer
from groundstation.mavlink.addresses import parse_address

_DATAGRAM_MAX = 65_535
_BURST_MAX = 512  # datagrams taken in one call, whatever their size
_BUFFER_BYTES = 4 << 20
_ALL_BYTES = 4 * _BUFFER_BYTES  # more than lies in a buffer: Linux makes it twice as large as it is told to
_SORTED_MAX = 1_024  # datagrams looked through when somebody becomes known, in one tick
_LEFT_OUT_BYTES = 64  # what leaving out a datagram costs, in bytes that are looked into
_PEERS_MAX = 1_000
_Socket = socket.socket  # the link has an attribute of that name
_STRANGERS_BYTES = 262_144  # of strangers, kept where they share a queue with the vehicles


@dataclass
class UdpLink:
    """One bound UDP port; see ``Link``.

    Attributes:
        socket: strangers' socket, or everybody's.
        own: the socket of those that are known, where the system can tell them apart.
        longest: bytes of a datagram of a stranger that is taken.
        too_long: datagrams of strangers that were longer.
        too_late: datagrams that were older than what their sender had said already.
    """

    url: str
    socket: _Socket
    own: _Socket | None = None
    longest: int = LONGEST_OF_STRANGERS
    too_long: int = 0
    too_late: int = 0
    errors: int = 0
    state: str = ""
    _addresses: dict[str, tuple[str, int]] = field(default_factory=dict)
    _peers: tuple[str, ...] = ()
    _spoken_to: dict[str, None] = field(default_factory=dict)
    _known: frozenset[str] = frozenset()
    _own_names: frozenset[str] = frozenset()
    _sorted: set[str] = field(default_factory=set)  # whose newer words may be in ``own``, or were
    _settled: set[str] = field(default_factory=set)  # none of whose old words can lie in ``socket`` any more
    _earlier: deque[tuple[str, bytes]] = field(default_factory=deque)
    _strangers: deque[tuple[str, bytes]] = field(default_factory=deque)
    _strangers_bytes: int = 0

    def sources(self) -> tuple[int, ...]:
        """The sockets."""
        return (self.socket.fileno(),) if self.own is None else (self.own.fileno(), self.socket.fileno())

    def service(self, now_ns: int) -> None:
        """Nothing is ever due."""

    def peers(self) -> tuple[str, ...]:
        """The other end of ``udpout://``."""
        return self._peers

    @property
    def behind(self) -> bool:
        """Whether something waits here."""
        return bool(self._strangers or self._earlier)

    @property
    def left_out(self) -> str:
        """What was too long; what came too late is counted and no more, for it is a matter of one moment."""
        if not self.too_long:
            return ""
        return f"{self.too_long} datagrams of unknown senders, longer than {self.longest} bytes"

    def know(self, peers: Collection[str]) -> None:
        """Those come first from now on; what they sent before comes before all that they send now."""
        known = self._own_names.union(peers)
        news, gone, self._known = known - self._known, self._known - known, known
        if self.own is not None:
            self._sorted |= gone
            self._settled -= news | gone
            steer(self.socket, [self._addresses[peer] for peer in known if peer in self._addresses])
        if not news:
            return
        waiting = list(self._strangers)
        if self.own is not None:
            self._take(self.socket, _ALL_BYTES, waiting, _SORTED_MAX)
        self._strangers.clear()
        self._strangers_bytes = 0
        for item in waiting:
            self._put_aside(item)
        self._leave_out()

    def receive(self, most: int = RECEIVE_BYTES) -> list[tuple[str, bytes]]:
        """Takes what has arrived: (peer as ``host:port``, datagram) each; whoever is known first."""
        arrived: list[tuple[str, bytes]] = []
        left = self._hand_out(self._earlier, most, arrived)
        if self._earlier:
            return arrived
        if self.own is None:
            taken: list[tuple[str, bytes]] = []
            self._take(self.socket, _ALL_BYTES, taken)
            for item in taken:
                self._put_aside(item)
            left = self._hand_out(self._earlier, left, arrived)
            if not self._earlier:
                self._hand_out(self._strangers, self._share(left), arrived)
            self._leave_out()
            return arrived
        before = len(arrived)
        left, empty = self._take(self.own, left, arrived)
        self._sorted.update(peer for peer, _ in arrived[before:] if peer not in self._settled)
        if not empty:
            return arrived
        self._sorted &= self._known
        left = self._hand_out(self._strangers, self._share(left), arrived)
        if not self._strangers and self._take(self.socket, left, arrived)[1]:
            # What the kernel puts there from now on is new, whoever sends it.
            self._settled |= self._known
            self._sorted -= self._settled
        return arrived

    def _share(self, left: int) -> int:
        """What strangers get of the bytes that are left."""
        return min(left, STRANGERS_BYTES) if self._known else left

    def _put_aside(self, item: tuple[str, bytes]) -> None:
        """Keeps a datagram for later."""
        if item[0] in self._sorted:
            self._count_late()
        elif item[0] in self._known:
            self._earlier.append(item)
        else:
            self._strangers.append(item)
            self._strangers_bytes += len(item[1])

    def _hand_out(self, kept: deque[tuple[str, bytes]], most: int, arrived: list[tuple[str, bytes]]) -> int:
        """Moves what was kept to what has arrived while bytes are left; returns how many are left then."""
        while kept and most > 0:
            arrived.append(kept.popleft())
            most -= len(arrived[-1][1])
            if kept is self._strangers:
                self._strangers_bytes -= len(arrived[-1][1])
        return most

    def _leave_out(self) -> None:
        """Leaves out what strangers sent and there is no room for, the oldest first."""
        room = _STRANGERS_BYTES if self.own is None else _BUFFER_BYTES
        while self._strangers_bytes > room:
            self._strangers_bytes -= len(self._strangers.popleft()[1])
            self.errors += 1

    def _count_late(self) -> None:
        self.too_late += 1
        self.errors += 1

    def _take(
        self, item: _Socket, most: int, arrived: list[tuple[str, bytes]], burst: int = _BURST_MAX
    ) -> tuple[int, bool]:
        """Takes datagrams from a socket while bytes are left; returns how many are left then, and whether it is empty.

        What nobody need look into is left out.
        """
        for _ in range(burst):
            if most <= 0:
                break
            try:
                data, address = item.recvfrom(_DATAGRAM_MAX)
            except BlockingIOError:
                return most, True
            except OSError:  # an ICMP error of an earlier send
                self.errors += 1
                continue
            peer = f"{address[0]}:{address[1]}"
            if peer in self._sorted and item is self.socket:
                self._count_late()
                most -= _LEFT_OUT_BYTES
                continue
            if len(data) > self.longest and item is self.socket and peer not in self._known:
                self.too_long += 1
                self.errors += 1
                most -= _LEFT_OUT_BYTES
                continue
            if peer not in self._addresses:
                if len(self._addresses) >= _PEERS_MAX:
                    self._forget_one()
                self._addresses[peer] = (address[0], address[1])
            arrived.append((peer, data))
            most -= len(data)
        return most, False

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
        """Closes the sockets."""
        self.socket.close()
        if self.own is not None:
            self.own.close()

    def __enter__(self) -> UdpLink:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the sockets."""
        self.close()


def open_udp(url: str, longest: int = LONGEST_OF_STRANGERS) -> UdpLink:
    """Opens ``udpin://HOST:PORT`` or ``udpout://HOST:PORT``.

    Args:
        url: one of these.
        longest: bytes of a datagram of a stranger that is taken.

    Raises:
        UserError: another form, or an address that cannot be had.
    """
    address = parse_address(url)
    if address.kind not in ("udpin", "udpout"):
        raise UserError(f"link {url}: expected udpin://HOST:PORT or udpout://HOST:PORT")
    listens = address.kind == "udpin"
    try:
        family, _, _, _, there = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
        item, own = open_pair(family, (address.host, address.port) if listens else ("", 0))
    except (OSError, ValueError) as error:  # ValueError: what no name of a host can be
        what = "cannot listen" if listens else "cannot be reached"
        remedy = "is another ground station using the port?" if listens else "correct the address"
        raise UserError(f"link {url}: {what}: {getattr(error, 'strerror', None) or error}; {remedy}") from None
    for each in (item, own):
        if each is not None:
            each.setblocking(False)
            each.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    link = UdpLink(url, item, own, longest)
    if not listens:
        host, port = str(there[0]), int(there[1])
        for name in (address.peer, f"{host}:{port}"):  # as written, and as answers will come
            link._addresses[name] = (host, port)
        link._peers = (address.peer,)
        link._own_names = frozenset(link._addresses)  # whom the operator has named is no stranger, heard or not
        link.know(())
    return link
