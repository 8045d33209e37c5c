"""Whom a link is told to put first: the vehicles, and what reads the motion capture."""

from __future__ import annotations

import numpy as np

from groundstation.mavlink.codec import Encoder
from groundstation.mavlink.mocap_frames import RoomEncoder
from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import Fleet
from groundstation.mocap.bodies import RoomConfig

MS = 1_000_000
ROOM = 1


class Heard:
    """A vehicle on one link and its room on another."""

    def __init__(self) -> None:
        config = RoomConfig(ROOM, "udpin://here", (1,), np.zeros((1, 3)), False, 2.0)
        self.fleet = Fleet([1], [0], config)
        self._station = Station(self.fleet, 0)
        self._encoder = RoomEncoder()

    def room(self, peer: str, t_ns: int) -> None:
        data = self._encoder.datagram(t_ns // 1_000, [1], np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))
        self._station.receive(ROOM, peer, data, t_ns)
        self._station.ingest()

    def vehicle(self, peer: str, t_ns: int) -> None:
        self._station.receive(0, peer, Encoder(1).encode("HEARTBEAT", type=2, autopilot=12), t_ns)
        self._station.ingest()


def test_the_room_is_known_as_vehicles_are() -> None:
    heard = Heard()
    assert heard.fleet.heard_at() == []
    heard.room("10.0.0.9:1", 10 * MS)
    heard.vehicle("10.0.0.1:5", 20 * MS)
    assert heard.fleet.heard_at() == [(0, "10.0.0.1:5"), (ROOM, "10.0.0.9:1")]


def test_in_flight_another_reader_of_the_same_host_is_known_once_the_first_is_silent() -> None:
    heard = Heard()
    heard.room("10.0.0.9:1", 10 * MS)
    heard.fleet.hold_addresses()
    heard.room("10.0.0.9:2", 1_000 * MS)
    assert heard.fleet.heard_at() == [(ROOM, "10.0.0.9:1")]
    heard.room("10.0.0.66:2", 1_600 * MS)
    assert heard.fleet.heard_at() == [(ROOM, "10.0.0.9:1")]
    heard.room("10.0.0.9:2", 1_700 * MS)
    assert heard.fleet.heard_at() == [(ROOM, "10.0.0.9:2")]
