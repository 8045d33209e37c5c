"""Gives a signing key to the vehicles of a mission and believes it when they sign with it. Sans-IO.

The key travels readable, as the MAVLink protocol has it: whoever hears the link has it too. It is sent to vehicles that
are disarmed, to the address that their heartbeats come from, and to nobody else. Nothing of it is recorded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from groundstation.mavlink.codec import Encoder, Frame, Splitters, decode
from groundstation.mavlink.kinds import kind_of
from groundstation.mavlink.signing import SecretKey, Signing, Verdict, timestamp_at
from groundstation.mavlink.station import (
    GROUND_STATION_COMPID,
    GROUND_STATION_SYSID,
    Outgoing,
    ground_station_heartbeat,
)
from groundstation.mavlink.vehicle import ARMED_FLAG, AUTOPILOT_COMPID
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

_AGAIN_NS = SECOND_NS


@dataclass
class VehicleSetup:
    """How far one vehicle is.

    Attributes:
        id: by which the mission names it.
        sysid: its system id on its link.
        link: index of its link.
        signing: its key in use.
        peer: where its heartbeats come from; None before.
        armed: it may not be given a key then.
        sent: times that it was sent the key.
        signs: it signs with the key.
    """

    id: int
    sysid: int
    link: int
    signing: Signing
    peer: str | None = None
    armed: bool = False
    sent: int = 0
    signs: bool = False

    @property
    def state(self) -> str:
        """For people."""
        if self.signs:
            return "signs with the key"
        if self.peer is None:
            return "not heard; switch it on, or correct its id or link"
        if self.armed:
            return "is armed; disarm it first"
        return f"was sent the key {self.sent} times, does not sign with it; has it another one? Then use USB"


class KeySetup:
    """One round of handing out keys.

    Args:
        plan: vehicles and links.
        keys: by link; None for links that are not signed.
        epoch_unix_us: date of time 0.
    """

    def __init__(self, plan: MissionPlan, keys: list[SecretKey | None], epoch_unix_us: int) -> None:
        self._plan, self._keys, self._epoch_unix_us = plan, keys, epoch_unix_us
        self._encoder = Encoder(GROUND_STATION_SYSID, GROUND_STATION_COMPID)
        self._splitters = Splitters()
        self._next_ns = 0
        signings = [None if key is None else Signing(key) for key in keys]
        self.vehicles = [
            VehicleSetup(vehicle.id, sysid, link, signing)
            for vehicle, sysid, link in zip(plan.spec.vehicles, plan.sysids, plan.link_of_vehicle, strict=True)
            if (signing := signings[link]) is not None
        ]

    @property
    def done(self) -> bool:
        """Whether all vehicles sign."""
        return all(vehicle.signs for vehicle in self.vehicles)

    def receive(self, link: int, peer: str, data: bytes, now_ns: int) -> None:
        """Takes what came over a link."""
        for piece in self._splitters.feed((link, peer), data, stream=link in self._plan.stream_links):
            if isinstance(piece, Frame) and piece.compid == AUTOPILOT_COMPID:
                for vehicle in self.vehicles:
                    if (vehicle.sysid, vehicle.link) == (piece.sysid, link):
                        self._take(vehicle, peer, piece, now_ns)

    def _take(self, vehicle: VehicleSetup, peer: str, frame: Frame, now_ns: int) -> None:
        clock = timestamp_at(self._epoch_unix_us + now_ns // 1_000)
        vehicle.signs |= vehicle.signing.check(frame, clock, vehicle.link) is Verdict.GOOD
        for batch in decode([frame]):
            kind = kind_of(frame)
            if kind is not None and kind.is_autopilot:
                vehicle.peer = peer if vehicle.peer is None else vehicle.peer
                if peer == vehicle.peer:
                    vehicle.armed = bool(batch.values[0]["base_mode"] & ARMED_FLAG)

    def outgoing(self, now_ns: int) -> list[Outgoing]:
        """What is to be sent now: heartbeats, and the key to those who are known, disarmed and do not sign yet."""
        if now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + _AGAIN_NS
        hello = ground_station_heartbeat(self._encoder)
        sent = [
            Outgoing(link, address.peer, (hello,)) for link, address in enumerate(self._plan.addresses) if address.peer
        ]
        clock = timestamp_at(self._epoch_unix_us + now_ns // 1_000)
        for vehicle in self.vehicles:
            key = self._keys[vehicle.link]
            if vehicle.peer is None or vehicle.armed or vehicle.signs or key is None:
                continue
            vehicle.sent += 1
            fields: dict[str, Any] = {"secret_key": key.setup_bytes(), "initial_timestamp": clock}
            give = self._encoder.encode(
                "SETUP_SIGNING", target_system=vehicle.sysid, target_component=AUTOPILOT_COMPID, **fields
            )
            signed = vehicle.signing.sign(hello, self._plan.link_id(vehicle.link), clock)
            sent.append(Outgoing(vehicle.link, vehicle.peer, (give, signed)))
        return sent
