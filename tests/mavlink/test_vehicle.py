"""The fleet's state: only vehicles of the mission change it, unknown stays unknown, bad values are counted."""

from __future__ import annotations

import math

import numpy as np

from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter
from groundstation.mavlink.vehicle import NEVER, UNKNOWN, Fleet, ReceivedFrame


def _received(raw: bytes, t_rx_ns: int = 5, link: int = 0) -> ReceivedFrame:
    (frame,) = FrameSplitter().feed(raw)
    assert isinstance(frame, Frame)
    return ReceivedFrame(frame, link, "peer", t_rx_ns)


def _fleet() -> Fleet:
    return Fleet([3, 7], [0, 0])


def test_before_anything_is_heard_everything_is_unknown_and_nothing_is_zero() -> None:
    fleet = _fleet()
    assert np.isnan(fleet.pos_local_ned_m).all()
    assert np.isnan(fleet.quat_ned_from_frd).all()
    assert fleet.custom_mode.tolist() == [UNKNOWN, UNKNOWN]
    assert fleet.heartbeat_ns.tolist() == [NEVER, NEVER]
    assert fleet.peer == [None, None]


def test_the_newest_value_wins_and_only_of_its_own_vehicle() -> None:
    fleet = _fleet()
    seven = Encoder(7)
    fleet.ingest(
        [
            _received(seven.encode("LOCAL_POSITION_NED", x=1.0, y=2.0, z=-0.5, vx=0.1), 10),
            _received(seven.encode("LOCAL_POSITION_NED", x=1.5, y=2.0, z=-0.5, vx=0.2), 30),
        ]
    )
    assert fleet.pos_local_ned_m[1].tolist() == [1.5, 2.0, -0.5]
    assert fleet.pose_ns.tolist() == [NEVER, 30]
    assert np.isnan(fleet.pos_local_ned_m[0]).all()


def test_frames_of_strangers_change_nothing_and_are_counted() -> None:
    fleet = _fleet()
    fleet.ingest(
        [
            _received(Encoder(9).encode("LOCAL_POSITION_NED", x=1.0)),
            _received(Encoder(3, 191).encode("HEARTBEAT", type=2, base_mode=0x80)),
            _received(Encoder(3).encode("HEARTBEAT", type=2, base_mode=0x80), link=1),
            _received(Encoder(3).encode("HEARTBEAT", type=6, base_mode=0x80)),
        ]
    )
    assert not fleet.armed.any()
    assert fleet.heartbeat_ns.tolist() == [NEVER, NEVER]
    assert fleet.counts == {
        "unknown system": 1,
        "other component": 1,
        "wrong link": 1,
        "heartbeat of a ground station under a vehicle's id": 1,
    }


def test_a_position_or_attitude_that_is_not_a_number_is_not_taken() -> None:
    fleet = _fleet()
    three = Encoder(3)
    fleet.ingest(
        [
            _received(three.encode("LOCAL_POSITION_NED", x=1.0, y=1.0, z=-1.0), 10),
            _received(three.encode("ATTITUDE_QUATERNION", q1=1.0), 10),
            _received(three.encode("LOCAL_POSITION_NED", x=math.nan), 20),
            _received(three.encode("LOCAL_POSITION_NED", x=2.0, vy=math.inf), 21),
            _received(three.encode("ATTITUDE_QUATERNION"), 22),
        ]
    )
    assert fleet.pos_local_ned_m[0].tolist() == [1.0, 1.0, -1.0]
    assert fleet.pose_ns[0] == 10
    assert fleet.attitude_ns[0] == 10
    assert fleet.counts == {"position that is not a number": 2, "attitude that is no rotation": 1}


def test_quaternions_come_in_with_w_not_negative() -> None:
    fleet = _fleet()
    fleet.ingest([_received(Encoder(3).encode("ATTITUDE_QUATERNION", q1=-0.6, q2=0.0, q3=0.0, q4=-0.8))])
    np.testing.assert_allclose(fleet.quat_ned_from_frd[0], [0.6, 0.0, 0.0, 0.8], atol=1e-7)


def test_texts_acks_and_clock_questions_are_handed_out_once() -> None:
    fleet = _fleet()
    three = Encoder(3)
    fleet.ingest(
        [
            _received(three.encode("STATUSTEXT", severity=2, text="Failsafe activated\t"), 1),
            _received(three.encode("COMMAND_ACK", command=400, result=4), 2),
            _received(three.encode("TIMESYNC", tc1=0, ts1=1234), 3),
            _received(three.encode("TIMESYNC", tc1=99, ts1=1234), 4),
        ]
    )
    assert [(text.vehicle, text.severity, text.text) for text in fleet.take_texts()] == [(0, 2, "Failsafe activated")]
    assert [(ack.vehicle, ack.command, ack.result) for ack in fleet.take_acks()] == [(0, 400, 4)]
    assert [(request.vehicle, request.ts1_ns, request.t_rx_ns) for request in fleet.take_timesync_requests()] == [
        (0, 1234, 3)
    ]
    assert not fleet.take_texts()
    assert not fleet.take_acks()


def test_battery_is_unknown_rather_than_below_zero() -> None:
    fleet = _fleet()
    fleet.ingest([_received(Encoder(3).encode("SYS_STATUS", battery_remaining=-1))])
    assert np.isnan(fleet.battery_remaining[0])
    fleet.ingest([_received(Encoder(3).encode("SYS_STATUS", battery_remaining=55))])
    assert fleet.battery_remaining[0] == 0.55


def test_a_vehicles_words_cannot_move_the_terminals_cursor_or_feign_a_line() -> None:
    fleet = _fleet()
    fleet.ingest([_received(Encoder(3).encode("STATUSTEXT", severity=2, text="a\x1b[2Jb\nvehicle 7: fine\u202e!\n"))])
    assert [text.text for text in fleet.take_texts()] == ["a [2Jb vehicle 7: fine !"]
