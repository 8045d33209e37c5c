"""Reads a motion capture system by the package ``motioncapture`` and sends its frames on as MAVLink.

A process of its own: the package waits in the system's own library, and what that does to a process must not reach the
flight. Refuses to judge what it reads: the flight does, out of the same frames that are in its log.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import NoReturn, Protocol

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray
from groundstation.mavlink.mocap_frames import RoomEncoder
from groundstation.mocap.bodies import relay_port, turned

SYSTEMS = ("vicon", "optitrack", "optitrack_closed_source", "qualisys", "nokov", "vrpn", "motionanalysis", "mock")
"""As ``motioncapture`` names them."""
_SAY_NS = 2_000_000_000


class Quaternion(Protocol):
    """A rotation as the package has it."""

    @property
    def x(self) -> float:
        """Of i."""

    @property
    def y(self) -> float:
        """Of j."""

    @property
    def z(self) -> float:
        """Of k."""

    @property
    def w(self) -> float:
        """The real part."""


class Body(Protocol):
    """A body as the package has it."""

    @property
    def position(self) -> FloatArray:
        """Shape (3,)."""

    @property
    def rotation(self) -> Quaternion:
        """Takes the body's axes to the system's."""


class System(Protocol):
    """A connection as the package has it."""

    @property
    def rigidBodies(self) -> Mapping[str, Body]:  # noqa: N802 - the package's own name
        """Of the newest frame, by name."""

    def waitForNextFrame(self) -> None:  # noqa: N802 - the package's own name
        """Waits for a frame."""


class Wire:
    """Where frames are sent: to the flight, and to its gateway, which needs them when the flight is killed.

    Args:
        host, port: of the ground station.
    """

    def __init__(self, host: str, port: int) -> None:
        self._addresses = (host, port), (host, relay_port(port))
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(self, data: bytes) -> None:
        """Sends a datagram; one that nobody takes is gone."""
        for address in self._addresses:
            with suppress(OSError):
                self._socket.sendto(data, address)

    def close(self) -> None:
        """Gives the socket back."""
        self._socket.close()


def connect(system: str, host: str) -> System:
    """Connects to a system.

    Raises:
        UserError: it is not known, or cannot be connected to.
    """
    import motioncapture  # noqa: PLC0415 - an extra, and a native library

    if system not in SYSTEMS:
        raise UserError(f"positioning.system: {system}: not known; one of {', '.join(SYSTEMS)} is")
    try:
        found: System = motioncapture.connect(system, {"hostname": host})
    except Exception as error:  # the package raises whatever its libraries raise
        words = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise UserError(
            f"motion capture {system} at {host}: {words}; see that it streams rigid bodies to this machine"
        ) from None
    return found


class Reader:
    """Turns frames of a system into datagrams.

    Args:
        ids: system ids of the vehicles by the names of their bodies; of obstacles -1, -2 and so on.
        up, unit: as the mission says; see ``turned``.

    Attributes:
        strangers: names of bodies that belong to nobody.
        frames: how many there were.
    """

    def __init__(self, ids: Mapping[str, int], *, up: str, unit: str) -> None:
        self.strangers: set[str] = set()
        self.frames = 0
        self._ids, self._up, self._unit = dict(ids), up, unit
        self._encoder = RoomEncoder()

    def datagram(self, bodies: Mapping[str, Body], stamp_us: int) -> bytes:
        """One frame.

        Args:
            bodies: by name.
            stamp_us: when it came, by a clock of this process.
        """
        self.frames += 1
        names = list(bodies)
        self.strangers |= set(names) - self._ids.keys()
        if not names:
            return b""
        pos = np.array([bodies[name].position for name in names], dtype=np.float64).reshape(-1, 3)
        rotations = [bodies[name].rotation for name in names]
        quat = np.array([[turn.w, turn.x, turn.y, turn.z] for turn in rotations], dtype=np.float64)
        place, attitude = turned(pos, quat, up=self._up, unit=self._unit)
        return self._encoder.datagram(stamp_us, [self._ids.get(name) for name in names], place, attitude)

    def words(self) -> bytes:
        """Names of bodies that belong to nobody, for people; empty without."""
        if not self.strangers:
            return b""
        return self._encoder.words(f"bodies of nobody: {' '.join(sorted(self.strangers))}")


def read(system: System, reader: Reader, wire: Wire) -> NoReturn:
    """Reads until the process ends.

    Args:
        system: connected.
        reader: of its frames.
        wire: where they go.
    """
    say_ns = time.monotonic_ns()
    while True:
        system.waitForNextFrame()
        now_ns = time.monotonic_ns()
        if data := reader.datagram(system.rigidBodies, now_ns // 1000):
            wire.send(data)
        if now_ns >= say_ns:
            say_ns = now_ns + _SAY_NS
            if words := reader.words():
                wire.send(words)
