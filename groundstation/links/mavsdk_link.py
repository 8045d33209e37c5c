"""A link that MAVSDK (4 and later, in this process) holds: another way in for what MAVSDK supports.

All messages pass through MAVSDK's forwarding as they are, both ways, but for velocity setpoints: those go to its
Offboard plugin, **which repeats the last one at 20 Hz by itself**. If the controller hangs, the autopilot's own
time-out does not see it. As long as this program runs, repetition ends half a second after the last setpoint.

MAVSDK calls back from threads of its own; bytes wait in a queue, and a socket pair wakes whoever waits on the link.
"""

from __future__ import annotations

import contextlib
import math
import socket
from collections import deque
from collections.abc import Collection
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.enums import ForwardingOption
from mavsdk.logging import log_subscribe
from mavsdk.plugins.offboard import Offboard, OffboardError, VelocityNedYaw

from groundstation.core.errors import UserError
from groundstation.links.link import RECEIVE_BYTES
from groundstation.mavlink.addresses import LinkAddress
from groundstation.mavlink.codec import Frame, FrameSplitter, decode, message_id

_SETPOINT = message_id("SET_POSITION_TARGET_LOCAL_NED")
_REPEATS_NS = 500_000_000
_QUEUE_MAX = 20_000


class MavsdkLink:
    """``mavsdk://ADDRESS``; see ``Link``. Its only peer is MAVSDK.

    Args:
        address: what MAVSDK opens.

    Raises:
        UserError: MAVSDK cannot open it.
    """

    left_out = ""

    def __init__(self, address: LinkAddress) -> None:
        self.url = address.url
        self.errors = 0
        self._peer = address.peer
        self._arrived: deque[bytes] = deque(maxlen=_QUEUE_MAX)
        self._wake_in, self._wake_out = socket.socketpair()
        self._wake_in.setblocking(False)
        self._wake_out.setblocking(False)
        self._splitter = FrameSplitter()
        self._offboard: dict[int, Any] = {}
        self._setpoint_ns: dict[int, int] = {}
        self._now_ns = 0
        self._mavsdk: Any = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        log_subscribe(_keep_quiet)
        for url in ("raw://", address.url.removeprefix("mavsdk://")):
            result = self._mavsdk.add_any_connection_with_forwarding(url, ForwardingOption.ON)
            if int(result) != 0:
                self.close()
                raise UserError(
                    f"link {address.url}: MAVSDK cannot open it: {getattr(result, 'name', result)}; is another program"
                    " using it?"
                )
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._take)

    @property
    def state(self) -> str:
        """Whether MAVSDK has found anybody."""
        return "" if self._mavsdk is None or self._mavsdk.system_count() else "MAVSDK has found no system"

    def sources(self) -> tuple[int, ...]:
        """What wakes whoever waits."""
        return (self._wake_in.fileno(),)

    def peers(self) -> tuple[str, ...]:
        """MAVSDK."""
        return (self._peer,)

    def service(self, now_ns: int) -> None:
        """Ends the repetition of setpoints that we have stopped to send."""
        self._now_ns = now_ns
        for sysid, sent_ns in list(self._setpoint_ns.items()):
            if now_ns - sent_ns > _REPEATS_NS:
                del self._setpoint_ns[sysid]
                self._offboard.pop(sysid).destroy()

    def _take(self, data: bytes) -> None:
        """Called by MAVSDK, from a thread of its own."""
        self._arrived.append(data)
        with contextlib.suppress(OSError):  # full: whoever waits is awake anyway
            self._wake_out.send(b"\0")

    @property
    def behind(self) -> bool:
        """Whether the queue holds something: nothing wakes for it again."""
        return bool(self._arrived)

    def know(self, peers: Collection[str]) -> None:
        """There is nobody else."""

    def receive(self, most: int = RECEIVE_BYTES) -> list[tuple[str, bytes]]:
        """Takes what has arrived."""
        with contextlib.suppress(OSError):
            self._wake_in.recv(65536)
        arrived = []
        while self._arrived and most > 0:
            data = self._arrived.popleft()
            most -= len(data)
            arrived.append((self._peer, data))
        return arrived

    def send(self, peer: str, data: bytes) -> None:
        """Sends frames: setpoints by way of the Offboard plugin, all others as they are."""
        for piece in self._splitter.feed(data):
            if isinstance(piece, Frame) and piece.msgid == _SETPOINT:
                self._set_velocity(piece)
            elif isinstance(piece, Frame):
                self._mavsdk.pass_received_raw_bytes(piece.raw)

    def _set_velocity(self, frame: Frame) -> None:
        (batch,) = decode([frame])
        values = batch.values[0]
        sysid = int(values["target_system"])
        plugin = self._offboard.get(sysid)
        if plugin is None:
            system = next((item for item in self._mavsdk.get_systems() if item.get_system_id() == sysid), None)
            if system is None:
                self.errors += 1
                return
            plugin = self._offboard[sysid] = Offboard(system)
        try:
            plugin.set_velocity_ned(
                VelocityNedYaw(
                    float(values["vx"]), float(values["vy"]), float(values["vz"]), math.degrees(float(values["yaw"]))
                )
            )
        except OffboardError:
            self.errors += 1
        self._setpoint_ns[sysid] = self._now_ns

    def close(self) -> None:
        """Ends MAVSDK and its threads."""
        if self._mavsdk is not None:
            self._mavsdk.destroy()
            self._mavsdk = None
        self._wake_in.close()
        self._wake_out.close()


def _keep_quiet(_level: object, _message: str, _file: str | None, _line: int) -> bool:
    """Keeps MAVSDK from writing to the standard output, which belongs to the commands; True says: dealt with."""
    return True
