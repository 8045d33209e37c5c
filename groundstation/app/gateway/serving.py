"""The gateway as a process: vehicles by cflib on one side, a MAVLink link on the other, one loop that waits.

Ends when it is told to: whoever flies is landed first. Told twice, it leaves at once; then the firmware's own watchdog
acts, and vehicles that fly by setpoints fall. One that a flight has started waits for a word of that (``handover``)
before it opens anything, and ends when that has ended and nobody flies any more.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.app.gateway.broadcasting import Broadcast, broadcasts
from groundstation.app.gateway.cflib_edge import CflibVehicle, Heard, Inbox, start_drivers
from groundstation.app.loop import FlightClock, Interrupts, Waiting
from groundstation.core import frames
from groundstation.core.errors import UserError
from groundstation.gateway.bridge import Bridge
from groundstation.gateway.handover import Handover, RoomWord, read, read_room
from groundstation.gateway.orders import Order
from groundstation.gateway.relay import Relay
from groundstation.links.link import LONGEST_OF_A_ROOM, Link
from groundstation.links.opening import open_link
from groundstation.mavlink.codec import Frame, Splitters
from groundstation.mocap.bodies import RoomConfig

_TICK_NS = 10_000_000
_RETRY_NS = 3_000_000_000
_LATE_NS = 100_000_000
_SAY_AGAIN_NS = 5_000_000_000
_STUCK_NS = 10_000_000_000  # a connection that gets no further for so long is begun anew
_EARLY_NS = 15_000_000_000  # so long those that are said to fly are waited for


@dataclass
class _Served:
    """One vehicle and how its connection does."""

    sysid: int
    link: CflibVehicle
    bridge: Bridge
    connected: bool = False
    retry_ns: int | None = None
    late_said_ns: int = -_SAY_AGAIN_NS
    progress: int = -1
    moved_ns: int = 0
    said_ns: int = 0


class Gateway:
    """n vehicles.

    Args:
        uris: by system id.
        out: where ground stations are, open.
        clock: time.
        cache: folder for cflib's tables.
        pose_hz: poses a second that each logs.
        say: takes lines for people.
        handover: what is known of them, by system id, where another gateway served them before.
        since_ns: when the first gateway of this flight began, by the machine's monotonic clock; None for now. Vehicles
            whose time since start-up began anew would be taken for restarted.
        room: where frames of the motion capture come in, and who makes poses of them while the flight is silent.
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
        handover: Mapping[int, Handover] | None = None,
        since_ns: int | None = None,
        room: tuple[Link, Relay] | None = None,
    ) -> None:
        self._handover, self._room, self._relays = dict(handover or {}), room, False
        self._out, self._clock, self._say = out, clock, say
        self.inbox = Inbox()
        self._begun_ns = now_ns = clock.now_ns()
        boot_ns = None if since_ns is None else now_ns - (time.monotonic_ns() - since_ns)
        self._vehicles = [
            _Served(
                sysid, CflibVehicle(number, uri, self.inbox, cache, pose_hz), Bridge(sysid, now_ns, pose_hz, boot_ns)
            )
            for number, (sysid, uri) in enumerate(uris.items())
        ]
        self._broadcasts: Sequence[Broadcast] = ()
        self._splitters = Splitters()
        self._peers: dict[str, int] = {}
        self.frames_in = self.frames_out = 0

    def connect(self) -> None:
        """Begins to connect to all of them at once; who flies is told first of all to stay where it is."""
        start_drivers()
        stay = [item for item in self._vehicles if self._told(item.sysid).flies]
        for item in self._vehicles:
            told = self._told(item.sysid)
            if told.flies:
                now_ns = self._clock.now_ns()
                item.bridge.resume(told.home_enu_m, told.settings, now_ns, in_a_room=self._room is not None)
            self._connect(item, item.bridge.take_orders())
        if stay:
            self._say(f"vehicles {', '.join(str(item.sysid) for item in stay)} fly: they are told to stay")

    def _told(self, sysid: int) -> Handover:
        return self._handover.get(sysid, Handover())

    @property
    def flying(self) -> list[int]:
        """System ids of those that fly, by the last word heard of each, or by what was told before any was heard."""
        early = self._clock.now_ns() - self._begun_ns < _EARLY_NS
        return [
            item.sysid
            for item in self._vehicles
            if item.bridge.pilot.supervisor.flies
            or (early and not item.bridge.heard_ever and self._told(item.sysid).flies)
        ]

    @property
    def connected(self) -> list[int]:
        """System ids of those that are connected."""
        return [item.sysid for item in self._vehicles if item.connected]

    def send_together(self, broadcasts: Sequence[Broadcast]) -> None:
        """From now on poses from outside go out by these, of those vehicles that they reach."""
        self._broadcasts = broadcasts

    def land_all(self) -> None:
        """Lands whoever flies, where it is; nothing but a kill is obeyed any more."""
        for item in self._vehicles:
            item.bridge.end(self._clock.now_ns())

    def close(self) -> None:
        """Ends all connections."""
        for broadcast in self._broadcasts:
            broadcast.close()
        for item in self._vehicles:
            item.link.close(flies=item.bridge.pilot.supervisor.flies)
        self.inbox.close()

    def step(self, waiting: Waiting) -> Sequence[int]:
        """Waits for what comes, for a hundredth of a second at most, and does what is due; numbers of what came."""
        ready = waiting.wait(_TICK_NS / 1e9)
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
        self._relay(now_ns)
        for item in self._vehicles:
            if item.retry_ns is not None and now_ns >= item.retry_ns:
                item.retry_ns = None
                self._connect(item)
            elif item.retry_ns is None and not item.connected:
                self._look_at(item, now_ns)
            item.bridge.tick(now_ns)
        bridges = {item.sysid: item.bridge for item in self._vehicles}
        for broadcast in self._broadcasts:
            broadcast.send(
                {sysid: pose for sysid in broadcast.sysids if (pose := bridges[sysid].take_external_pose()) is not None}
            )
        for item in self._vehicles:
            for order in item.bridge.take_orders():
                item.link.obey(order)
            self._send(item.bridge.take_frames())
        return ready

    def _connect(self, item: _Served, first: Sequence[Order] = ()) -> None:
        item.progress, item.moved_ns, item.said_ns = -1, self._clock.now_ns(), self._clock.now_ns()
        item.link.connect(first)

    def _look_at(self, item: _Served, now_ns: int) -> None:
        """Tells how a connection gets on; one that gets no further is begun anew, unless the vehicle is heard."""
        progress, words = item.link.progress()
        if progress != item.progress:
            item.progress, item.moved_ns = progress, now_ns
        if now_ns - item.moved_ns >= _STUCK_NS and not item.bridge.pilot.fresh(now_ns):
            self._take(Heard(item.link.number, "lost", words=f"{words}, no further for {_STUCK_NS / 1e9:g} s"), now_ns)
        elif now_ns - item.said_ns >= _SAY_AGAIN_NS:
            item.said_ns = now_ns
            self._say(f"vehicle {item.sysid}: {item.link.uri}: {words} yet")

    def _relay(self, now_ns: int) -> None:
        """Tells vehicles where they are while the flight does not."""
        if self._room is None:
            return
        link, relay = self._room
        told = {item.sysid: word for item in self._vehicles if (word := item.bridge.told_by_flight) is not None}
        poses = relay.poses([data for _, data in link.receive()], told, now_ns)
        for item in self._vehicles:
            if item.sysid in poses:
                item.bridge.see(poses[item.sysid], now_ns)
        if bool(self._relays) != relay.speaks and (poses or not relay.speaks):
            self._relays = relay.speaks
            self._say(
                "the flight is silent: where vehicles are is told to them by the gateway, from the motion capture"
                if relay.speaks
                else "the flight tells vehicles where they are again"
            )

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
        elif heard.kind == "echo":
            item.bridge.echoed(heard.stamp_ms, now_ns)
        elif heard.kind == "answer":
            item.bridge.answered(heard.stamp_ms, int(heard.values["error"]))
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


class Keeper:
    """Whoever has started this gateway, by its standard input: one line to begin with, and its end.

    Attributes:
        gone: it has ended.
    """

    def __init__(self) -> None:
        self.gone = False

    def sources(self) -> Sequence[int]:
        """A descriptor that can be read when it has ended."""
        return () if self.gone else (sys.stdin.fileno(),)

    def handover(self) -> str | None:
        """Waits for its word, see ``handover``; None when it ends before that."""
        return sys.stdin.readline() or None

    def look(self) -> None:
        """Notices its end."""
        if not os.read(sys.stdin.fileno(), 4096):
            self.gone = True


def _room(
    stack: ExitStack,
    word: RoomWord | None,
    sysids: Sequence[int],
    vehicles: Mapping[int, Handover],
    say: Callable[[str], None],
) -> tuple[Link, Relay] | None:
    """The room of a flight, where it has one that can be heard."""
    if word is None:
        return None
    try:
        link = stack.enter_context(closing(open_link(word.link, LONGEST_OF_A_ROOM)))
    except UserError as error:
        say(f"{error}; where vehicles are is told to them by the flight alone")
        return None
    pads = np.array([vehicles.get(sysid, Handover()).home_enu_m or (0.0, 0.0, 0.0) for sysid in sysids])
    config = RoomConfig(0, word.link, tuple(sysids), frames.ned_from_enu(pads), word.by_place, word.speed_m_s)
    return link, Relay(config, word.hz)


def serve(
    uris: dict[int, str],
    out: str,
    *,
    cache: Path,
    pose_hz: float,
    say: Callable[[str], None],
    broadcast: bool = False,
    kept_since_ns: int | None = None,
    room: RoomWord | None = None,
) -> dict[str, int]:
    """Serves vehicles until it is told to end.

    Args:
        uris: cflib addresses by system id.
        out: link to ground stations.
        cache: folder for cflib's tables; made where it is not there.
        pose_hz: poses a second that each logs.
        say: takes lines for people.
        broadcast: poses from outside go to several vehicles in one packet, where they share a radio.
        kept_since_ns: a flight has started it, then, by the machine's monotonic clock, and speaks by standard input.
        room: by what the vehicles are told where they are while the ground station does not; a flight says its own.

    Returns:
        Counts for the answer.

    Raises:
        UserError: the link or the folder cannot be used.
    """
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{cache}: {error.strerror}; name another folder with --cache") from error
    keeper = None if kept_since_ns is None else Keeper()
    word = keeper.handover() if keeper is not None else "{}"
    counts = {"vehicles": len(uris), "connected": 0, "left_flying": 0, "frames_in": 0, "frames_out": 0}
    if word is None:
        return counts
    interrupts = Interrupts()
    with ExitStack() as stack:
        link = stack.enter_context(closing(open_link(out)))
        gateway = stack.enter_context(
            closing(
                Gateway(
                    uris,
                    link,
                    FlightClock(),
                    cache=cache,
                    pose_hz=pose_hz,
                    say=say,
                    handover=(handover := read(word)),
                    since_ns=kept_since_ns,
                    room=_room(stack, read_room(word) or room, list(uris), handover, say),
                )
            )
        )
        if broadcast:
            gateway.send_together(broadcasts(uris))
        waiting = stack.enter_context(Waiting([link, gateway.inbox, *(() if keeper is None else (keeper,))]))
        stack.enter_context(interrupts.listening())
        gateway.connect()
        landing = False
        while interrupts.count < 2:
            if 2 in gateway.step(waiting) and keeper is not None:
                keeper.look()
            if keeper is not None and keeper.gone and not gateway.flying:
                break
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
        return counts | {
            "connected": len(gateway.connected),
            "left_flying": len(left),
            "frames_in": gateway.frames_in,
            "frames_out": gateway.frames_out,
        }
