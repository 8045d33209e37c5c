"""A VRPN server of trackers, so that a fake room is read as real ones are: through ``motioncapture`` and VRPN's client.

The wire as VRPN's sources have it (github.com/vrpn/vrpn, vrpn_Connection and vrpn_Tracker, version 7): a client asks by
UDP to be called back by TCP, or calls by TCP itself; both tell a cookie; then messages, of which senders and types are
described by name first. Pose messages go by TCP. Refuses to wait: whoever does not read is dropped.
"""

from __future__ import annotations

import contextlib
import math
import re
import socket
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from groundstation.core import frames
from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray
from groundstation.gateway.measured import enu_from_flu
from groundstation.mavlink.codec import Frame, FrameSplitter, decode
from groundstation.mavlink.mocap_frames import BODY_SYSID, OTHER_SYSID

PORT = 3883
_COOKIE = b"vrpn: ver. 07.38  0".ljust(24, b"\0")
_VERSION = re.compile(rb"vrpn: ver\. 07\.")
_HEADER = struct.Struct("!iiiiii")  # length, seconds, microseconds, sender, type, number
_SENDER, _TYPE = -1, -2
_POSE, _PONG, _PING = "vrpn_Tracker Pos_Quat", "vrpn_Base pong_message", "vrpn_Base ping_message"
_BACKLOG_BYTES = 1 << 16


@dataclass
class _Client:
    """One that is connected.

    Attributes:
        heard: of it, not read yet.
        said: to it, not taken yet.
        greeted: its cookie has come.
        names: of its own senders and types, by (kind, number).
        known: our numbers that were described to it, by (kind, name).
    """

    wire: socket.socket
    heard: bytearray = field(default_factory=bytearray)
    said: bytearray = field(default_factory=lambda: bytearray(_COOKIE))
    greeted: bool = False
    names: dict[tuple[int, int], str] = field(default_factory=dict)
    known: dict[tuple[int, str], int] = field(default_factory=dict)
    count: int = 0

    def message(self, sender: int, kind: int, payload: bytes, stamp_us: int) -> None:
        """Says something."""
        self.count += 1
        header = _HEADER.pack(_HEADER.size + len(payload), *divmod(stamp_us, 1_000_000), sender, kind, self.count)
        self.said += header + payload + bytes(-len(payload) % 8)

    def number(self, kind: int, name: str) -> int:
        """Our number of a sender or type, described before it is used."""
        found = self.known.get((kind, name))
        if found is None:
            found = self.known[kind, name] = sum(other == kind for other, _ in self.known)
            data = name.encode() + b"\0"
            self.message(found, kind, struct.pack("!i", len(data)) + data, 0)
        return found


class VrpnServer:
    """Serves bodies to any number of clients.

    Args:
        host, port: where.

    Raises:
        UserError: the port is taken.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = PORT) -> None:
        self._calls = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._listens = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listens.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            for item in (self._calls, self._listens):
                item.setblocking(False)
                item.bind((host, port))
            self._listens.listen()
        except OSError as error:
            self.close()
            raise UserError(f"VRPN on port {port}: {error.strerror}; is another server of VRPN running?") from error
        self._clients: list[_Client] = []

    def close(self) -> None:
        """Closes all sockets."""
        for item in (self._calls, self._listens, *(client.wire for client in getattr(self, "_clients", ()))):
            item.close()

    def send(self, stamp_us: int, bodies: Mapping[str, tuple[FloatArray, FloatArray]]) -> None:
        """Tells all clients of an instant.

        Args:
            stamp_us: its time.
            bodies: place, m, shape (3,), and quaternion x y z w, shape (4,), by name, in the system's axes.
        """
        self._answer()
        for client in list(self._clients):
            try:
                self._hear(client, stamp_us)
                if client.greeted:
                    for name, (place, quat) in bodies.items():
                        payload = struct.pack("!ii7d", 0, 0, *place, *quat)
                        sender, kind = client.number(_SENDER, name), client.number(_TYPE, _POSE)
                        client.message(sender, kind, payload, stamp_us)
                with contextlib.suppress(BlockingIOError):
                    del client.said[: client.wire.send(client.said)]
                if len(client.said) > _BACKLOG_BYTES:
                    raise ConnectionError
            except OSError:
                client.wire.close()
                self._clients.remove(client)

    def _answer(self) -> None:
        """Takes new clients: those that call, and those that want to be called."""
        with contextlib.suppress(OSError):
            while True:
                wire, _ = self._listens.accept()
                self._join(wire)
        with contextlib.suppress(OSError):
            while True:
                words = self._calls.recv(1024).split(b"\0")[0].decode("ascii", "replace").split()
                if len(words) == 2 and words[1].isdecimal():
                    wire = socket.create_connection((words[0], int(words[1])), timeout=1.0)
                    self._join(wire)

    def _join(self, wire: socket.socket) -> None:
        wire.setblocking(False)
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients.append(_Client(wire))

    @staticmethod
    def _hear(client: _Client, stamp_us: int) -> None:
        """Reads what it says: its cookie, its names, and whether we are still there.

        Raises:
            OSError: it has gone, or is no client of this version.
        """
        with contextlib.suppress(BlockingIOError):
            while data := client.wire.recv(65536):
                client.heard += data
            raise ConnectionError
        if not client.greeted:
            if len(client.heard) < len(_COOKIE):
                return
            if not _VERSION.match(client.heard):
                raise ConnectionError
            client.greeted = True
            del client.heard[: len(_COOKIE)]
        while len(client.heard) >= _HEADER.size:
            length, _, _, sender, kind, _ = _HEADER.unpack_from(client.heard)
            whole = length + (-length % 8)
            if not _HEADER.size <= length <= _BACKLOG_BYTES:
                raise ConnectionError
            if len(client.heard) < whole:
                return
            payload = bytes(client.heard[_HEADER.size : length])
            del client.heard[:whole]
            if kind in (_SENDER, _TYPE):
                client.names[kind, sender] = payload[4:].split(b"\0")[0].decode("ascii", "replace")
            elif client.names.get((_TYPE, kind)) == _PING and (name := client.names.get((_SENDER, sender))):
                client.message(client.number(_SENDER, name), client.number(_TYPE, _PONG), b"", stamp_us)


def bodies_of(data: bytes, names: Mapping[int, str]) -> tuple[int, dict[str, tuple[FloatArray, FloatArray]]]:
    """The bodies of a datagram of the room, as a system with z up would tell them.

    Args:
        data: as ``mavlink.mocap_frames`` makes it.
        names: of bodies, by system id; of obstacles by -1, -2 and so on.

    Returns:
        Time stamp, us, and place (x east, y north, z up) and quaternion x y z w by name; a body without an attitude
        lies as the axes do.
    """
    stamp_us, found = 0, {}
    pieces = [piece for piece in FrameSplitter().feed(data) if isinstance(piece, Frame)]
    for batch in decode(pieces):
        for sysid, compid, values in zip(batch.sysid.tolist(), batch.compid.tolist(), batch.values, strict=True):
            number = -compid if sysid == OTHER_SYSID else compid
            own = names.get(number) if sysid in (BODY_SYSID, OTHER_SYSID) else f"marker{number}"
            quat = [float(value) for value in values["q"]]
            turn = enu_from_flu(*quat) if all(map(math.isfinite, quat)) else (0.0, 0.0, 0.0, 1.0)
            place = frames.ned_from_enu(np.array([float(values[axis]) for axis in "xyz"]))
            stamp_us = int(values["time_usec"])
            found[own or f"body{number}"] = place, np.array(turn)
    return stamp_us, found
