"""The gateway as a process: vehicles by cflib on one side, a MAVLink link on the other, one loop that waits.

Ends when it is told to: whoever flies is landed first. Told twice, it leaves at once; then the firmware's own watchdog
acts, and vehicles that fly by setpoints fall.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

from groundstation.app.gateway.cflib_edge import CflibVehicle, Heard, Inbox, start_drivers
from groundstation.app.loop import FlightClock, Interrupts, Waiting
from groundstation.core.errors import UserError
from groundstation.gateway.bridge import Bridge
from groundstation.links.link import Link
from groundstation.links.opening import open_link
from groundstation.mavlink.codec import Frame, Splitters

_TICK_NS = 10_000_000
_RETRY_NS = 3_000_000_000
_LATE_NS = 100_000_000
_SAY_AGAIN_NS = 5_000_000_000


@dataclass
class _Served:
    """One vehicle and how its connection does."""

    sysid: int
    link: CflibVehicle
    bridge: Bridge
    connected: bool = False
    retry_ns: int | None = None
    late_said_ns: int = -_SAY_AGAIN_NS


class Gateway:
    """n vehicles.

    Args:
        uris: by system id.
        out: where ground stations are, open.
        clock: time.
        cache: folder for cflib's tables.
        pose_hz: poses a second that each logs.
        say: takes lines for people.
    """

    def __init__(
        self,
        uris: dict[int, str],
        out: Link,
        clock: FlightClock,
        *,
        cache: Path,
        pose_hz: float,
        say: Callable[[str], None],
    ) -> None:
        self._out, self._clock, self._say = out, clock, say
        self.inbox = Inbox()
        now_ns = clock.now_ns()
        self._vehicles = [
            _Served(sysid, CflibVehicle(number, uri, self.inbox, cache, pose_hz), Bridge(sysid, now_ns))
            for number, (sysid, uri) in enumerate(uris.items())
        ]
        self._splitters = Splitters()
        self._peers: dict[str, int] = {}
        self.frames_in = self.frames_out = 0

    def connect(self) -> None:
        """Begins to connect to all of them at once."""
        start_drivers()
        for item in self._vehicles:
            item.link.connect()

    @property
    def flying(self) -> list[int]:
        """System ids of those that fly, by the last word heard of each."""
        return [item.sysid for item in self._vehicles if item.bridge.pilot.supervisor.flies]

    @property
    def connected(self) -> list[int]:
        """System ids of those that are connected."""
        return [item.sysid for item in self._vehicles if item.connected]

    def land_all(self) -> None:
        """Lands whoever flies, where it is; nothing but a kill is obeyed any more."""
        for item in self._vehicles:
            item.bridge.end(self._clock.now_ns())

    def close(self) -> None:
        """Ends all connections."""
        for item in self._vehicles:
            item.link.close(flies=item.bridge.pilot.supervisor.flies)
        self.inbox.close()

    def step(self, waiting: Waiting) -> None:
        """Waits for what comes, for a hundredth of a second at most, and does what is due."""
        waiting.wait(_TICK_NS / 1e9)
        now_ns = self._clock.now_ns()
        for peer, data in self._out.receive():
            self._peers[peer] = now_ns
            for piece in self._splitters.feed((0, peer), data, stream=False):
                if isinstance(piece, Frame):
                    self.frames_in += 1
                    for item in self._vehicles:
                        item.bridge.take(piece, now_ns)
        for heard in self.inbox.take():
            self._take(heard, now_ns)
        self._out.service(now_ns)
        for item in self._vehicles:
            if item.retry_ns is not None and now_ns >= item.retry_ns:
                item.retry_ns = None
                item.link.connect()
            item.bridge.tick(now_ns)
            for order in item.bridge.take_orders():
                item.link.obey(order)
            self._send(item.bridge.take_frames())

    def _send(self, frames: Sequence[bytes]) -> None:
        if not frames:
            return
        self.frames_out += len(frames)
        data = b"".join(frames)
        for peer in dict.fromkeys((*self._out.peers(), *self._peers)):
            self._out.send(peer, data)

    def _take(self, heard: Heard, now_ns: int) -> None:
        item = self._vehicles[heard.vehicle]
        if heard.kind == "log":
            item.bridge.logged(heard.values, heard.stamp_ms, now_ns)
            late_ns = item.bridge.lateness_ns
            if late_ns > _LATE_NS and now_ns - item.late_said_ns > _SAY_AGAIN_NS:
                item.late_said_ns = now_ns
                self._say(f"vehicle {item.sysid}: its poses come {late_ns / 1e9:.2f} s late; lower the rates")
        elif heard.kind == "param":
            for name, value in heard.values.items():
                item.bridge.param_told(name, value)
        elif heard.kind == "connected":
            item.connected = True
            item.bridge.connected(heard.protocol, heard.params)
            missing = len(self._vehicles) - len(self.connected)
            rest = f"; {missing} to come" if missing else "; all are there"
            self._say(
                f"vehicle {item.sysid}: {item.link.uri}: connected, CRTP version {heard.protocol},"
                f" {len(heard.params)} parameters{rest}"
            )
        elif item.retry_ns is None:
            was, item.connected = item.connected, False
            item.retry_ns = now_ns + _RETRY_NS
            self._say(
                f"vehicle {item.sysid}: {item.link.uri}: {'connection lost' if was else 'no connection'}:"
                f" {heard.words or 'no reason given'}; tried again in {_RETRY_NS / 1e9:g} s"
            )


def serve(uris: dict[int, str], out: str, *, cache: Path, pose_hz: float, say: Callable[[str], None]) -> dict[str, int]:
    """Serves vehicles until it is told to end.

    Args:
        uris: cflib addresses by system id.
        out: link to ground stations.
        cache: folder for cflib's tables; made where it is not there.
        pose_hz: poses a second that each logs.
        say: takes lines for people.

    Returns:
        Counts for the answer.

    Raises:
        UserError: the link or the folder cannot be used.
    """
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{cache}: {error.strerror}; name another folder with --cache") from error
    interrupts = Interrupts()
    with ExitStack() as stack:
        link = stack.enter_context(closing(open_link(out)))
        gateway = stack.enter_context(
            closing(Gateway(uris, link, FlightClock(), cache=cache, pose_hz=pose_hz, say=say))
        )
        waiting = stack.enter_context(Waiting([link, gateway.inbox]))
        stack.enter_context(interrupts.listening())
        gateway.connect()
        landing = False
        while interrupts.count < 2:
            gateway.step(waiting)
            if interrupts.count or interrupts.hung_up:
                if not gateway.flying:
                    break
                if not landing:
                    landing = True
                    say(
                        f"vehicles {', '.join(map(str, gateway.flying))} fly: they land; Ctrl-C again leaves them alone"
                    )
                    gateway.land_all()
        left = gateway.flying
        if left:
            say(f"vehicles {', '.join(map(str, left))} are left in the air: without setpoints they fall after 2 s")
        return {
            "vehicles": len(uris),
            "connected": len(gateway.connected),
            "left_flying": len(left),
            "frames_in": gateway.frames_in,
            "frames_out": gateway.frames_out,
        }
