"""The gate between the links and the mission: what it lets in, what it counts, what it says."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter
from groundstation.mavlink.gate import Gate, Refused, SignedLink
from groundstation.mavlink.signing import MINUTE, SecretKey, Signing, Times, Verdict, timestamp_at, timestamp_of
from groundstation.mavlink.station import Outgoing

KEY = SecretKey(bytes(range(32)))
EPOCH_US = 1_750_000_000_000_000
NOW = timestamp_at(EPOCH_US)
SECOND_NS = 1_000_000_000


def _gate(*, store: list[Times] | None = None, streams: tuple[int, ...] = ()) -> Gate:
    """Two links: the first is signed, the second is not."""
    keep = None if store is None else lambda _number, times: store.append(Times(times.sent, times.newest))
    return Gate([SignedLink(Signing(KEY), 4), None], EPOCH_US, streams=streams, store=keep)


def _signed(sysid: int, stamp: int = NOW, key: SecretKey = KEY, name: str = "HEARTBEAT") -> bytes:
    return Signing(key).sign(Encoder(sysid).encode(name, **({"type": 2} if name == "HEARTBEAT" else {})), 0, stamp)


def _let_in(gate: Gate, link: int, data: bytes) -> list[int]:
    return [piece.sysid for piece in gate.receive(link, "p", data, 0) if isinstance(piece, Frame)]


def test_only_what_is_signed_comes_in_and_the_rest_is_counted_by_whom_it_claims_to_be() -> None:
    gate = _gate()
    foreign = SecretKey(bytes(32))
    data = _signed(1) + Encoder(2).encode("HEARTBEAT") + _signed(3, key=foreign) + _signed(4, NOW - MINUTE - 1)
    pieces = list(gate.receive(0, "p", b"noise" + data, 0))
    assert pieces[0] == b"noise"
    assert [item.sysid for item in pieces if isinstance(item, Frame)] == [1]
    refused = [(item.frame.sysid, item.verdict) for item in pieces if isinstance(item, Refused)]
    assert refused == [(2, Verdict.UNSIGNED), (3, Verdict.WRONG), (4, Verdict.OLD)]
    assert gate.totals() == {
        "frames without a signature": 1, "frames with a wrong signature": 1, "frames with an old time stamp": 1,
    }  # fmt: skip
    assert _let_in(gate, 1, Encoder(2).encode("HEARTBEAT")) == [2]  # the other link is not signed


def test_words_tell_what_to_do() -> None:
    gate = _gate()
    _let_in(gate, 0, Encoder(3).encode("HEARTBEAT") * 120)
    _let_in(gate, 0, Encoder(9).encode("HEARTBEAT"))
    assert gate.words(["udp", "tcp"], {(0, 3): 3}) == [
        "vehicle 3: 120 frames without a signature ignored; it does not sign: give it the key of this mission"
        " (gs signing setup)",
        "system 9 on udp: 1 frame without a signature ignored",
    ]
    _let_in(gate, 0, _signed(3))
    assert "1 good ones taken; somebody else speaks in its name" in gate.words(["udp", "tcp"], {(0, 3): 3})[0]


def test_radios_come_in_and_vehicles_in_their_clothes_do_not() -> None:
    gate = _gate()
    assert _let_in(gate, 0, Encoder(51, 68).encode("RADIO_STATUS", rssi=3)) == [51]
    assert _let_in(gate, 0, Encoder(3, 1).encode("RADIO_STATUS", rssi=3)) == []
    assert gate.radio_status == 1


def test_all_that_goes_out_over_a_signed_link_is_signed_and_nothing_else() -> None:
    gate = _gate()
    raw = Encoder(255, 190).encode("HEARTBEAT", type=6)
    first, second = gate.sign([Outgoing(0, "a", (raw, raw)), Outgoing(1, "b", (raw,))], 5 * SECOND_NS)
    assert second.frames == (raw,)
    frames = [piece for frame in first.frames for piece in FrameSplitter().feed(frame)]
    assert all(isinstance(frame, Frame) and frame.signed and frame.raw[-13] == 4 for frame in frames)
    stamps = [timestamp_of(frame) for frame in frames if isinstance(frame, Frame)]
    assert stamps == [NOW + 500_000, NOW + 500_001]


def test_times_are_stored_before_they_are_used_and_seldom() -> None:
    stored: list[Times] = []
    gate = _gate(store=stored)
    raw = Encoder(255, 190).encode("HEARTBEAT", type=6)
    for tick in range(100 * 50):  # 100 s at 50 Hz
        (item,) = gate.sign([Outgoing(0, "a", (raw,))], tick * SECOND_NS // 50)
        (frame,) = FrameSplitter().feed(item.frames[0])
        assert isinstance(frame, Frame)
        assert timestamp_of(frame) <= stored[-1].sent + MINUTE  # what is written: times and a minute ahead
    assert 3 <= len(stored) <= 5


def test_a_vehicle_without_a_clock_is_greeted_and_comes_in_once_it_has_our_time() -> None:
    """The link listens, the vehicle speaks first: pymavlink as the vehicle, its time at the beginning of time."""
    gate = _gate()
    vehicle = dialect.MAVLink(None, srcSystem=3, srcComponent=1)
    vehicle.signing.secret_key, vehicle.signing.sign_outgoing, vehicle.signing.timestamp = bytes(range(32)), True, 7
    vehicle.robust_parsing = True
    hello = dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    assert _let_in(gate, 0, bytes(hello.pack(vehicle))) == []
    (greeting,) = gate.greetings(SECOND_NS)
    assert (greeting.link, greeting.peer) == (0, "p")
    assert [m.get_type() for m in vehicle.parse_buffer(bytearray(b"".join(greeting.frames)))] == ["HEARTBEAT"]
    assert _let_in(gate, 0, bytes(hello.pack(vehicle))) == [3]
    assert gate.greetings(5 * SECOND_NS) == []


def test_nobody_without_the_key_is_greeted() -> None:
    gate = _gate()
    _let_in(gate, 0, Encoder(3).encode("HEARTBEAT") + _signed(3, key=SecretKey(bytes(32))))
    assert gate.greetings(SECOND_NS) == []


@given(noise=st.lists(st.binary(max_size=40), max_size=6), cut=st.integers(1, 60))
def test_on_a_stream_in_any_pieces_good_frames_come_in_in_order(noise: list[bytes], cut: int) -> None:
    gate = _gate(streams=(0,))
    noise = [re.sub(rb"[\xfd\xfe]", b"", item) for item in noise]
    stream = b"".join(item + _signed(1, NOW + k) for k, item in enumerate(noise))
    heard: list[Frame] = []
    for start in range(0, len(stream), cut):
        pieces = gate.receive(0, "p", stream[start : start + cut], 0)
        heard += [piece for piece in pieces if isinstance(piece, Frame)]
    assert [timestamp_of(frame) for frame in heard] == [NOW + k for k in range(len(noise))]
