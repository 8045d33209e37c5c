"""Frames of unknown systems, of other components, over other links and from other addresses change nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from groundstation.mavlink.codec import Encoder
from groundstation.mavlink.commands import Command
from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import Fleet

SECOND_NS = 1_000_000_000
SPOOFS: dict[str, dict[str, Any]] = {
    "HEARTBEAT": {"type": 2, "autopilot": 3, "base_mode": 128, "custom_mode": 9, "system_status": 5},
    "LOCAL_POSITION_NED": {"time_boot_ms": 9_000_000, "x": 50.0, "y": 50.0, "z": -50.0, "vx": 9.0},
    "GLOBAL_POSITION_INT": {"time_boot_ms": 9_000_000, "lat": 1, "lon": 1, "alt": 1},
    "GPS_GLOBAL_ORIGIN": {"latitude": 10**8, "longitude": 10**8, "altitude": 7},
    "ATTITUDE_QUATERNION": {"time_boot_ms": 9_000_000, "q2": 1.0},
    "ATTITUDE": {"time_boot_ms": 9_000_000, "roll": 1.0},
    "SYS_STATUS": {"battery_remaining": 1, "onboard_control_sensors_health": 0},
    "EXTENDED_SYS_STATE": {"landed_state": 2},
    "COMMAND_ACK": {"command": 400, "result": 0},
    "STATUSTEXT": {"severity": 0, "text": "Disarmed"},
    "TIMESYNC": {"tc1": 10**15, "ts1": SECOND_NS},
}


def _snapshot(station: Station) -> dict[str, Any]:
    """All that can steer: the fleet's arrays, addresses, clocks, outcomes, texts, questions."""
    fleet = station.fleet
    state: dict[str, Any] = {
        name: np.array(value) for name, value in vars(fleet).items() if isinstance(value, np.ndarray)
    }
    state |= {
        f"clocks.{name}": np.array(value) for name, value in vars(fleet.clocks).items() if isinstance(value, np.ndarray)
    }
    state["peer"] = np.array(fleet.peer, dtype=object)
    state["outcomes"] = np.array([item.words() for item in station.commands.take_outcomes()], dtype=object)
    state["texts"] = np.array([text.text for text in fleet.take_texts()], dtype=object)
    state["pending"] = np.array([station.commands.pending(i) for i in range(len(fleet))])
    return state


def _station() -> Station:
    """Two vehicles on two links, heard; vehicle 1 has a command and a question for its time under way."""
    station = Station(Fleet([1, 2], [0, 1]), 0)
    for sysid in (1, 2):
        station.receive(sysid - 1, f"10.0.0.{sysid}:14580", Encoder(sysid).encode("HEARTBEAT", type=2, autopilot=12), 0)
    station.ingest()
    station.commands.request(0, Command("arm", 400))
    station.transmit(SECOND_NS, np.zeros((2, 3)), np.zeros(2), np.zeros(2, dtype=bool))
    return station


@pytest.mark.parametrize("message", SPOOFS)
@pytest.mark.parametrize(
    ("sysid", "compid", "link", "peer"),
    [
        (9, 1, 0, "10.0.0.1:14580"),
        (1, 2, 0, "10.0.0.1:14580"),
        (1, 1, 1, "10.0.0.2:14580"),
        (1, 1, 0, "10.0.0.66:14580"),
        (1, 1, 0, "10.0.0.1:6666"),
    ],
    ids=["unknown system", "other component", "other link", "other host", "other port"],
)
def test_what_a_stranger_says_changes_nothing(message: str, sysid: int, compid: int, link: int, peer: str) -> None:
    station = _station()
    before = _snapshot(station)
    raw = Encoder(sysid, compid).encode(message, **SPOOFS[message])
    station.receive(link, peer, raw, SECOND_NS + 1000)
    station.ingest()
    after = _snapshot(station)
    for name, value in before.items():
        np.testing.assert_array_equal(after[name], value, err_msg=name)
    assert sum(station.fleet.counts.values()) == 1
    # The same from the vehicle itself does change something, so that the above is no accident.
    station.receive(0, "10.0.0.1:14580", Encoder(1).encode(message, **SPOOFS[message]), SECOND_NS + 2000)
    station.ingest()
    changed = _snapshot(station)
    assert any(
        not np.array_equal(changed[name], value, equal_nan=value.dtype.kind == "f") for name, value in before.items()
    )


def test_an_id_that_the_dialect_does_not_know_gives_nobody_an_address() -> None:
    """Its checksum cannot be known, so that noise may look like it."""
    station = Station(Fleet([1], [0]), 0)
    station.receive(0, "noise", b"\xfd\x01\x00\x00\x00\x01\x01\xff\xff\xff\x00\x00\x00", 0)
    station.ingest()
    assert station.fleet.peer == [None]
    assert station.fleet.counts == {"unknown message": 1}


def test_who_speaks_first_is_believed_on_the_ground_and_the_second_makes_it_known() -> None:
    station = Station(Fleet([1], [0]), 0)
    for t_s, peer in ((0.0, "evil:1"), (0.5, "10.0.0.1:1"), (1.0, "evil:1")):
        station.receive(0, peer, Encoder(1).encode("HEARTBEAT", type=2, autopilot=12), round(t_s * SECOND_NS))
        station.ingest()
    words = station.fleet.twin(0, SECOND_NS)  # preflight refuses with this
    assert words == "two vehicles say that they are 1, at evil:1 and 10.0.0.1:1"


@pytest.mark.parametrize(
    ("peer", "signed", "moves"),
    [("10.0.0.66:1", (), False), ("10.0.0.1:2", (), True), ("10.0.0.66:1", (0,), True), ("/dev/ttyUSB1", (), False)],
)
def test_in_the_air_nobody_takes_over_the_name_of_a_vehicle_that_fell_silent(
    peer: str, signed: tuple[int, ...], *, moves: bool
) -> None:
    station = Station(Fleet([1], [0]), 0)
    station.receive(0, "10.0.0.1:1", Encoder(1).encode("HEARTBEAT", type=2, autopilot=12), 0)
    station.ingest()
    station.fleet.hold_addresses(signed)
    station.receive(0, peer, Encoder(1).encode("LOCAL_POSITION_NED", x=50.0), 10 * SECOND_NS)
    station.ingest()
    assert (station.fleet.peer == [peer]) is moves
    assert bool(np.isfinite(station.fleet.pos_local_ned_m).all()) is moves


def test_on_the_ground_a_vehicle_may_come_back_from_another_address() -> None:
    station = Station(Fleet([1], [0]), 0)
    for t_s, peer in ((0, "10.0.0.1:1"), (2, "10.0.0.7:1")):
        station.receive(0, peer, Encoder(1).encode("HEARTBEAT", type=2, autopilot=12), t_s * SECOND_NS)
        station.ingest()
    assert station.fleet.peer == ["10.0.0.7:1"]
