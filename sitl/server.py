"""The emulator on real sockets in real time: the only place of ``sitl`` that waits, and that reads a clock.

Each vehicle has its own UDP socket, from which it sends to the ground station's port as PX4 does (from 14580 + i
where that port is free), and may have a TCP listener. It answers whoever has spoken to it lately, several ground
stations at once. With nobody listening it goes on quietly. Refuses to listen on anything but the loopback interface
unless it is told another one.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from threading import Event
from typing import TextIO

from sitl.config import SECOND
from sitl.faults import FaultError, parse_faults
from sitl.personalities import PERSONALITIES
from sitl.world import World, WorldConfig

_FIRST_SOURCE_PORT = 14580
_PEER_SILENCE_NS = 30 * SECOND
_LAG_MAX_NS = SECOND // 2
_READ_BYTES = 65535
_BACKLOG_BYTES = 1 << 20
_PEERS_MAX = 64

Address = tuple[str, int]


@dataclass
class _TcpPeer:
    connection: socket.socket
    name: str
    backlog: bytearray = field(default_factory=bytearray)


class OrderLines:
    """Faults that are ordered while the world runs, one a line.

    Args:
        world: to which they happen.
        stream: where they come from; None: from nowhere.

    Attributes:
        errors: what was wrong with some; they have changed nothing.
    """

    def __init__(self, world: World, stream: TextIO | None) -> None:
        self._world, self._stream = world, stream
        self._rest = b""
        self.errors: list[str] = []

    def read(self) -> bool:
        """Takes what has come. Returns False at the end of the stream."""
        data = b"" if self._stream is None else os.read(self._stream.fileno(), _READ_BYTES)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self.obey(line.decode(errors="replace").strip())
        return bool(data)

    def obey(self, line: str) -> None:
        """Obeys one line."""
        try:
            if line == "clear":
                self._world.clear_faults()
            elif line:
                self._world.inject(*parse_faults(f"[{line}]", "order"))
        except FaultError as error:
            self.errors.append(str(error))


class Server:
    """Sockets around one world.

    Args:
        config: the world; its clock and date are set to the machine's when it starts.
        seed: of the world.
        port: UDP port of the ground station; of kinds that listen on ports of their own, the first vehicle's.
        port_per_vehicle: vehicle i (from 0) sends to ``port + i``.
        host: address of the ground station, and of the vehicles.
        tcp_port: vehicle i listens for TCP on ``tcp_port + 10 * i``, as ArduPilot's SITL; None for no TCP.
        udp: whether vehicles send UDP at all.
        orders: a stream of lines, each a fault in YAML (``{kind: blackout, for_s: 2}``) or the word ``clear``;
            they act when they are read. None for no such stream.
        clock: monotonic time in ns.
        speed: how many times faster than the clock the world runs.

    Attributes:
        world: what is emulated.
        orders: what was ordered by lines, and what was wrong with it.
        late_ns: time that was skipped because the machine was too slow.
    """

    def __init__(
        self,
        config: WorldConfig,
        seed: int,
        *,
        port: int = 14540,
        port_per_vehicle: bool = False,
        host: str = "127.0.0.1",
        tcp_port: int | None = None,
        udp: bool = True,
        orders: TextIO | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
        speed: float = 1.0,
    ) -> None:
        started_ns = clock()
        self._speed = speed
        self._clock = clock if speed == 1.0 else lambda: started_ns + round((clock() - started_ns) * speed)
        self._offset_ns = 0
        self.late_ns = 0
        self.datagrams_in = self.datagrams_out = 0
        now_ns = self._clock()
        self.world = World(replace(config, start_ns=now_ns, unix_start_us=time.time_ns() // 1000), seed)
        self.orders = OrderLines(self.world, orders)
        n = len(config.vehicles)
        self._selector = selectors.DefaultSelector()
        self._sockets: list[socket.socket] = []
        self._targets: list[Address | None] = []
        self._peers: list[dict[Address, int]] = [{} for _ in range(n)]
        self._tcp: list[list[_TcpPeer]] = [[] for _ in range(n)]
        self._listeners: list[socket.socket] = []
        try:
            for i in range(n):
                own_port = PERSONALITIES[config.vehicles[i].autopilot].first_port
                self._sockets.append(
                    _udp_socket(host, _FIRST_SOURCE_PORT + i) if own_port is None else _listener(host, port + i)
                )
                self._selector.register(self._sockets[i], selectors.EVENT_READ, (i, None))
                sends = udp and own_port is None
                self._targets.append((host, port + i if port_per_vehicle else port) if sends else None)
                if tcp_port is not None:
                    listener = _tcp_listener(host, tcp_port + 10 * i)
                    self._listeners.append(listener)
                    self._selector.register(listener, selectors.EVENT_READ, (i, "accept"))
            if orders is not None:
                self._selector.register(orders, selectors.EVENT_READ, (0, "orders"))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes all sockets."""
        for peers in self._tcp:
            for peer in peers:
                peer.connection.close()
            peers.clear()
        for item in (*self._sockets, *self._listeners):
            item.close()
        self._selector.close()

    def run(self, stop: Event, status: Callable[[Server], None] | None = None, status_every_s: float = 0.25) -> None:
        """Runs in real time until ``stop`` is set.

        Args:
            stop: looked at after every physics step.
            status: called now and then, for a display.
            status_every_s: how often.
        """
        step_ns = self.world.config.physics_step_ns
        next_status_ns = self._clock()
        while not stop.is_set():
            due_ns = self.world.now_ns + step_ns - self._offset_ns
            self._wait(max(due_ns - self._clock(), 0) / SECOND / self._speed)
            now_ns = self._clock() + self._offset_ns
            if now_ns - self.world.now_ns > _LAG_MAX_NS:  # too slow, or suspended: time that is lost stays lost
                skipped = now_ns - self.world.now_ns - step_ns
                self.late_ns += skipped
                self._offset_ns -= skipped
                now_ns -= skipped
            for outgoing in self.world.advance(now_ns):
                self._send(outgoing.vehicle_index, outgoing.data)
            if status is not None and self._clock() >= next_status_ns:
                next_status_ns = self._clock() + round(status_every_s * SECOND)
                status(self)

    def _wait(self, timeout_s: float) -> None:
        """The one place where the emulator waits: for bytes, or for the next step."""
        for key, _ in self._selector.select(timeout_s):
            vehicle, what = key.data
            item = key.fileobj
            if what == "orders":
                if not self.orders.read():
                    self._selector.unregister(item)
                continue
            if not isinstance(item, socket.socket):
                continue
            if what is None:
                self._read_udp(vehicle, item)
            elif what == "accept":
                self._accept(vehicle, item)
            else:
                self._read_tcp(vehicle, what)

    @property
    def ground_stations(self) -> list[int]:
        """How many ground stations each vehicle has heard lately."""
        now_ns = self.world.now_ns
        return [
            sum(now_ns - heard < _PEER_SILENCE_NS for heard in udp.values()) + len(tcp)
            for udp, tcp in zip(self._peers, self._tcp, strict=True)
        ]

    def _read_udp(self, vehicle: int, item: socket.socket) -> None:
        while True:
            try:
                data, address = item.recvfrom(_READ_BYTES)
            except BlockingIOError:
                return
            except OSError:
                continue  # an earlier datagram was refused: nobody listens there now
            now_ns = self._clock() + self._offset_ns
            peers = self._peers[vehicle]
            peers.pop(address, None)
            if len(peers) >= _PEERS_MAX:
                del peers[next(iter(peers))]  # the one that was silent for longest
            peers[address] = now_ns
            self.datagrams_in += 1
            self.world.receive(vehicle, data, max(now_ns, self.world.now_ns), f"{address[0]}:{address[1]}")

    def _accept(self, vehicle: int, listener: socket.socket) -> None:
        with contextlib.suppress(OSError):
            connection, address = listener.accept()
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer = _TcpPeer(connection, f"tcp:{address[0]}:{address[1]}")
            self._tcp[vehicle].append(peer)
            self._selector.register(connection, selectors.EVENT_READ, (vehicle, peer))

    def _read_tcp(self, vehicle: int, peer: _TcpPeer) -> None:
        try:
            data = peer.connection.recv(_READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(vehicle, peer)
            return
        now_ns = max(self._clock() + self._offset_ns, self.world.now_ns)
        self.world.receive(vehicle, data, now_ns, peer.name, stream=True)

    def _drop(self, vehicle: int, peer: _TcpPeer) -> None:
        self._selector.unregister(peer.connection)
        peer.connection.close()
        self._tcp[vehicle].remove(peer)

    def _send(self, vehicle: int, data: bytes) -> None:
        now_ns = self.world.now_ns
        peers = self._peers[vehicle]
        target = self._targets[vehicle]
        for address in [target, *peers]:
            if address is None:
                continue
            if address in peers:
                if now_ns - peers[address] > _PEER_SILENCE_NS:
                    del peers[address]
                    if address != target:
                        continue
                elif address == target and peers and address is not target:
                    continue  # already sent as the default target
            with contextlib.suppress(OSError):
                self._sockets[vehicle].sendto(data, address)
                self.datagrams_out += 1
        for peer in list(self._tcp[vehicle]):
            self._send_tcp(vehicle, peer, data)

    def _send_tcp(self, vehicle: int, peer: _TcpPeer, data: bytes) -> None:
        """Sends what the connection takes now and keeps the rest; whoever never reads is dropped."""
        peer.backlog += data
        try:
            sent = peer.connection.send(peer.backlog)
            del peer.backlog[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(vehicle, peer)
            return
        if len(peer.backlog) > _BACKLOG_BYTES:
            self._drop(vehicle, peer)


def _udp_socket(host: str, preferred_port: int) -> socket.socket:
    """A non-blocking socket on the preferred port, or on any free one."""
    item = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    item.setblocking(False)
    try:
        item.bind((host, preferred_port))
    except OSError:
        item.bind((host, 0))
    return item


def _listener(host: str, port: int) -> socket.socket:
    """A non-blocking socket on this port: clients know no other (OSError where it is taken)."""
    item = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    item.setblocking(False)
    try:
        item.bind((host, port))
    except OSError as error:
        item.close()
        raise OSError(f"UDP port {port}: {error.strerror}") from error
    return item


def _tcp_listener(host: str, port: int) -> socket.socket:
    item = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    item.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    item.setblocking(False)
    item.bind((host, port))
    item.listen()
    return item
