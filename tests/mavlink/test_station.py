"""The ground station's end of the conversation, read by pymavlink as the independent peer."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.mavlink.codec import Encoder
from groundstation.mavlink.commands import Command
from groundstation.mavlink.station import Outgoing, Station
from groundstation.mavlink.vehicle import Fleet

SECOND_NS = 1_000_000_000


def _station() -> Station:
    station = Station(Fleet([1, 2], [0, 0]), 0)
    for sysid in (1, 2):
        station.receive(0, f"p{sysid}", Encoder(sysid).encode("HEARTBEAT", type=2, autopilot=12), 0)
    station.ingest()
    return station


def _messages(outgoing: list[Outgoing], peer: str) -> list[dialect.MAVLink_message]:
    reader = dialect.MAVLink(None)
    raw = b"".join(frame for datagram in outgoing if datagram.peer == peer for frame in datagram.frames)
    return reader.parse_buffer(raw) or []


def _transmit(station: Station, now_ns: int, streaming: tuple[bool, bool] = (False, False)) -> list[Outgoing]:
    velocity = np.array([[0.1, 0.2, -0.3], [0.4, 0.5, 0.6]])
    return station.transmit(now_ns, velocity, np.array([0.5, -0.5]), np.array(streaming))


def test_setpoints_are_velocity_and_yaw_in_local_ned_for_the_right_vehicle() -> None:
    station = _station()
    _transmit(station, 0)
    outgoing = _transmit(station, 20_000_000, (False, True))
    assert _messages(outgoing, "p1") == []
    (message,) = _messages(outgoing, "p2")
    assert message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert (message.target_system, message.coordinate_frame, message.type_mask) == (2, 1, 0x09C7)
    assert (message.time_boot_ms, message.get_srcSystem(), message.get_srcComponent()) == (20, 255, 190)
    np.testing.assert_allclose([message.vx, message.vy, message.vz, message.yaw], [0.4, 0.5, 0.6, -0.5], atol=1e-7)
    assert station.setpoints_sent == 1


def test_heartbeat_once_a_second_and_only_to_who_was_heard() -> None:
    station = _station()
    station.fleet.peer[1] = None
    sent = {ms: _transmit(station, ms * 1_000_000) for ms in range(0, 3000, 20)}
    beats = [ms for ms, out in sent.items() for m in _messages(out, "p1") if m.get_type() == "HEARTBEAT"]
    assert beats == [0, 1000, 2000]
    assert {datagram.peer for datagram in _transmit(station, 3 * SECOND_NS)} == {"p1"}


def test_clock_question_is_answered_with_the_time_of_arrival() -> None:
    station = _station()
    _transmit(station, 0)
    station.receive(0, "p1", Encoder(1).encode("TIMESYNC", tc1=0, ts1=777), 123_000)
    station.ingest()
    (message,) = _messages(_transmit(station, 20_000_000), "p1")
    assert (message.get_type(), message.tc1, message.ts1) == ("TIMESYNC", 123_000, 777)


def test_commands_go_to_their_vehicle_with_all_parameters() -> None:
    station = _station()
    _transmit(station, 0)
    station.commands.request(1, Command("interval", 511, (32.0, 20000.0)))
    (message,) = _messages(_transmit(station, 20_000_000), "p2")
    assert (message.get_type(), message.target_system, message.target_component) == ("COMMAND_LONG", 2, 1)
    assert (message.command, message.param1, message.param2, message.param7) == (511, 32.0, 20000.0, 0.0)


def test_a_setpoint_that_is_not_a_number_is_never_encoded() -> None:
    station = _station()
    velocity = np.array([[0.1, 0.2, np.nan], [0.4, 0.5, 0.6]])
    with pytest.raises(ValueError, match="not a finite number"):
        station.transmit(0, velocity, np.zeros(2), np.array([True, True]))


def test_who_waits_to_be_spoken_to_is_greeted_until_somebody_is_heard_there() -> None:
    station = Station(Fleet([1, 2], [0, 1]), 0, greeted=[(1, "tcp")])
    (hello,) = _transmit(station, 0)
    assert (hello.link, hello.peer) == (1, "tcp")
    assert [message.get_type() for message in _messages([hello], "tcp")] == ["HEARTBEAT"]
    station.receive(1, "tcp", Encoder(2).encode("HEARTBEAT", type=2, autopilot=12), SECOND_NS)
    station.ingest()
    later = [datagram for ms in range(1000, 4000, 20) for datagram in _transmit(station, ms * 1_000_000)]
    beats = [message for message in _messages(later, "tcp") if message.get_type() == "HEARTBEAT"]
    assert len(beats) == 3


def test_clocks_are_asked_once_for_all_behind_an_address_and_answers_are_believed() -> None:
    station = Station(Fleet([1, 2], [0, 0]), 0)
    for sysid in (1, 2):
        station.receive(0, "radio", Encoder(sysid).encode("HEARTBEAT", type=2, autopilot=12), 0)
    station.ingest()
    now_ns = 10 * SECOND_NS
    (question,) = [m for m in _messages(_transmit(station, now_ns), "radio") if m.get_type() == "TIMESYNC"]
    assert (question.tc1, question.ts1) == (0, now_ns)
    for sysid in (1, 2):
        answer = Encoder(sysid).encode("TIMESYNC", tc1=sysid * SECOND_NS, ts1=question.ts1)
        station.receive(0, "radio", answer, now_ns + 40_000_000)
    station.ingest()
    np.testing.assert_allclose(station.fleet.clocks.round_trip_s, 0.04)
    assert station.fleet.clocks.offset_ns.tolist() == [s * SECOND_NS - now_ns - 20_000_000 for s in (1, 2)]
