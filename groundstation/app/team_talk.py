"""What every talk with a mission's vehicles beside a flight is made of: who they are, hearing them, greeting them.

Bytes and times in, bytes out: reads no clock, opens no link. Refuses to know what the talk is about.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from groundstation.mavlink.codec import Batch, Encoder, Frame, Splitters, decode
from groundstation.mavlink.kinds import kind_of
from groundstation.mavlink.station import (
    GROUND_STATION_COMPID,
    GROUND_STATION_SYSID,
    Outgoing,
    ground_station_heartbeat,
)
from groundstation.mavlink.vehicle import ARMED_FLAG, AUTOPILOT_COMPID
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

_HELLO_NS = SECOND_NS


@dataclass
class TalkedTo:
    """One vehicle of a talk.

    Attributes:
        id: by which the mission names it.
        sysid: its system id on its link.
        link: index of its link.
        peer: where its first heartbeat came from; empty before.
        armed: as it said last; None before it said anything.
    """

    id: int
    sysid: int
    link: int
    peer: str = ""
    armed: bool | None = None


Vehicle = TypeVar("Vehicle", bound=TalkedTo)


class TeamTalk(ABC, Generic[Vehicle]):
    """A talk with a mission's vehicles.

    Args:
        plan: its links.
        vehicles: with whom, in the order of the mission.
    """

    def __init__(self, plan: MissionPlan, vehicles: Sequence[Vehicle]) -> None:
        self._addresses = plan.addresses
        self._vehicles = vehicles
        self._number = {(item.link, item.sysid): number for number, item in enumerate(vehicles)}
        self._encoder = Encoder(GROUND_STATION_SYSID, GROUND_STATION_COMPID)
        self._splitters = Splitters()
        self._next_hello_ns = 0

    def receive(self, link: int, peer: str, data: bytes, now_ns: int) -> None:
        """Takes what came over a link: of the mission's autopilots, and of nobody else."""
        for piece in self._splitters.feed((link, peer), data, stream=self._addresses[link].is_stream):
            if not isinstance(piece, Frame) or piece.compid != AUTOPILOT_COMPID:
                continue
            number = self._number.get((link, piece.sysid))
            if number is None:
                continue
            item, sender = self._vehicles[number], kind_of(piece)
            for batch in decode([piece]):
                if sender is not None and sender.is_autopilot:
                    item.peer = item.peer or peer  # the first who speaks under an id stays: nobody takes it over
                    if peer == item.peer:
                        item.armed = bool(batch.values[0]["base_mode"] & ARMED_FLAG)
                elif peer == item.peer:
                    self._take(number, batch, now_ns)

    @abstractmethod
    def _take(self, number: int, batch: Batch, now_ns: int) -> None:
        """Takes one message of a vehicle that is no heartbeat."""

    def _greetings(self, now_ns: int) -> list[Outgoing]:
        """Heartbeats once a second, to whoever was heard and to whoever waits to be spoken to."""
        if now_ns < self._next_hello_ns:
            return []
        self._next_hello_ns = now_ns + _HELLO_NS
        hello = ground_station_heartbeat(self._encoder)
        places = {(link, address.peer) for link, address in enumerate(self._addresses) if address.peer}
        places |= {(item.link, item.peer) for item in self._vehicles if item.peer}
        return [Outgoing(link, peer, (hello,)) for link, peer in sorted(places)]

    def _to(self, item: Vehicle, frame: bytes) -> Outgoing:
        return Outgoing(item.link, item.peer, (frame,))
