"""Signing held against pymavlink's own: each accepts the other's frames and refuses what was tampered with."""

from __future__ import annotations

import itertools
import pickle
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, flagged
from groundstation.mavlink.signing import (
    EPOCH_UNIX_US,
    LATEST,
    MINUTE,
    SecretKey,
    Signing,
    Times,
    Verdict,
    is_radio_status,
    timestamp_at,
    timestamp_of,
)

SECRET = bytes(range(32))
NOW = timestamp_at(1_750_000_000_000_000)


def _peer(secret: bytes = SECRET, sysid: int = 3, timestamp: int = NOW) -> dialect.MAVLink:
    """pymavlink at the other end, in its own words."""
    mav = dialect.MAVLink(None, srcSystem=sysid, srcComponent=1)
    mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = secret, True, timestamp
    return mav


def _said(mav: dialect.MAVLink, **fields: Any) -> Frame:
    """A heartbeat that pymavlink encodes and signs."""
    message = dialect.MAVLink_heartbeat_message(2, 12, 0, fields.get("mode", 0), 4, 3)
    return _frame(bytes(message.pack(mav)))


def _frame(raw: bytes) -> Frame:
    (piece,) = FrameSplitter().feed(raw)
    assert isinstance(piece, Frame)
    return piece


def _heard(mav: dialect.MAVLink, raw: bytes) -> list[str]:
    """Types of the messages that pymavlink takes; one that it refuses comes as BAD_DATA, or raises."""
    mav.robust_parsing = True
    return [message.get_type() for message in mav.parse_buffer(bytearray(raw)) or []]


def test_units_are_ten_microseconds_since_2015() -> None:
    assert timestamp_at(EPOCH_UNIX_US) == 0
    assert timestamp_at(EPOCH_UNIX_US + 1_000_000) == 100_000
    assert timestamp_at(0) == 0


@given(
    speed=st.floats(-10, 10, width=32),
    link_id=st.integers(0, 255),
    clock=st.integers(1, LATEST - 10),
    secret=st.binary(min_size=32, max_size=32),
)
@settings(max_examples=100, deadline=None)
def test_pymavlink_accepts_our_frames(speed: float, link_id: int, clock: int, secret: bytes) -> None:
    encoder = Encoder(255, 190)
    signing, peer = Signing(SecretKey(secret)), _peer(secret, timestamp=clock)
    raws = [
        encoder.encode("SET_POSITION_TARGET_LOCAL_NED", vx=speed, target_system=1),
        encoder.encode("HEARTBEAT", type=6),
        encoder.encode("COMMAND_LONG", command=400),
    ]
    signed = b"".join(signing.sign(raw, link_id, clock) for raw in raws)
    assert _heard(peer, signed) == ["SET_POSITION_TARGET_LOCAL_NED", "HEARTBEAT", "COMMAND_LONG"]
    assert [f.raw[-13] for f in FrameSplitter().feed(signed) if isinstance(f, Frame)] == [link_id] * 3


def test_we_accept_pymavlinks_frames_each_once() -> None:
    signing, peer = Signing(SecretKey(SECRET)), _peer()
    frames = [_said(peer, mode=number) for number in range(50)]
    assert [signing.check(frame, NOW) for frame in frames] == [Verdict.GOOD] * 50
    assert [signing.check(frame, NOW) for frame in frames] == [Verdict.OLD] * 50


@given(bit=st.integers(0, 8 * 34 - 1))
@settings(max_examples=300, deadline=None)
def test_any_bit_that_is_changed_is_refused_by_both(bit: int) -> None:
    """The checksum is mended, as whoever tampers would do: the signature alone has to notice."""
    theirs = _said(_peer()).raw
    ours = Signing(SecretKey(SECRET)).sign(Encoder(255, 190).encode("HEARTBEAT", type=6, mavlink_version=3), 0, NOW)
    assert len(theirs) == len(ours) == 34
    for raw, judge in ((theirs, "ours"), (ours, "theirs")):
        tampered = bytearray(raw)
        tampered[bit // 8] ^= 1 << bit % 8
        if 1 <= bit // 8 < 19:
            body = bytes(tampered[1:19])
            crc = dialect.x25crc(body)
            crc.accumulate(bytes([dialect.MAVLink_heartbeat_message.crc_extra]))
            tampered[19:21] = crc.crc.to_bytes(2, "little")
        pieces = FrameSplitter().feed(bytes(tampered))
        if judge == "ours":
            frames = [piece for piece in pieces if isinstance(piece, Frame) and piece.msgid == 0]
            verdicts = {Signing(SecretKey(SECRET)).check(frame, 0) for frame in frames}
            assert Verdict.GOOD not in verdicts
        else:
            assert "HEARTBEAT" not in _heard(_peer(timestamp=0), bytes(tampered))


def test_a_foreign_key_is_refused_by_both() -> None:
    other = bytes(32)
    assert Signing(SecretKey(SECRET)).check(_said(_peer(other)), NOW) is Verdict.WRONG
    raw = Signing(SecretKey(other)).sign(Encoder(255, 190).encode("HEARTBEAT"), 0, NOW)
    assert "HEARTBEAT" not in _heard(_peer(), raw)


def test_a_wrong_signature_leaves_no_trace_in_the_order_of_time_stamps() -> None:
    """A forged frame from the future must not lock the vehicle out."""
    signing = Signing(SecretKey(SECRET))
    assert signing.check(_said(_peer(bytes(32), timestamp=NOW + 10**9)), NOW) is Verdict.WRONG
    assert signing.check(_said(_peer()), NOW) is Verdict.GOOD


def test_unsigned_and_mavlink_1_frames_are_refused() -> None:
    signing = Signing(SecretKey(SECRET))
    assert signing.check(_frame(Encoder(3).encode("HEARTBEAT")), NOW) is Verdict.UNSIGNED
    assert signing.check(_frame(Encoder(3, version=1).encode("HEARTBEAT")), NOW) is Verdict.UNSIGNED
    with pytest.raises(ValueError, match="MAVLink 1"):
        signing.sign(Encoder(3, version=1).encode("HEARTBEAT"), 0, NOW)


@pytest.mark.parametrize(("behind", "verdict"), [(MINUTE, Verdict.GOOD), (MINUTE + 1, Verdict.OLD)])
def test_a_new_stream_may_be_a_minute_behind_the_clock_and_no_more(behind: int, verdict: Verdict) -> None:
    assert Signing(SecretKey(SECRET)).check(_said(_peer(timestamp=NOW - behind)), NOW) is verdict


def test_a_new_stream_is_judged_by_the_newest_frame_where_the_clock_is_behind() -> None:
    signing = Signing(SecretKey(SECRET))
    assert signing.check(_said(_peer(sysid=1)), 0) is Verdict.GOOD
    assert signing.check(_said(_peer(sysid=2, timestamp=NOW - MINUTE - 10)), 0) is Verdict.OLD


def test_a_vehicle_whose_time_jumps_ahead_does_not_silence_the_others() -> None:
    signing = Signing(SecretKey(SECRET))
    slow, quick = _peer(sysid=1), _peer(sysid=2)
    assert signing.check(_said(slow), NOW) is Verdict.GOOD
    quick.signing.timestamp += 60 * MINUTE
    assert signing.check(_said(quick), NOW) is Verdict.GOOD
    assert signing.check(_said(slow), NOW) is Verdict.GOOD


def test_streams_are_kept_apart_by_system_component_link_id_and_link() -> None:
    signing, peer = Signing(SecretKey(SECRET)), _peer()
    frame = _said(peer)
    assert [signing.check(frame, NOW, link) for link in (0, 1, 0)] == [Verdict.GOOD, Verdict.GOOD, Verdict.OLD]
    again = _peer()
    again.signing.link_id = 7
    assert signing.check(_said(again), NOW) is Verdict.GOOD
    again.srcComponent = 2
    again.signing.timestamp = NOW
    assert signing.check(_said(again), NOW) is Verdict.GOOD


@given(clocks=st.lists(st.integers(0, LATEST - 100), min_size=2, max_size=30))
def test_time_stamps_only_rise_whatever_the_clock_does_and_over_restarts(clocks: list[int]) -> None:
    """Each clock reading is a start of the program: it goes on from the times that the one before left."""
    times, stamps = Times(), []
    for clock in clocks:
        signing = Signing(SecretKey(SECRET), Times(times.sent, times.newest, dict(times.streams)))
        raw = Encoder(255, 190).encode("HEARTBEAT")
        stamps += [timestamp_of(_frame(signing.sign(raw, 0, clock))) for _ in range(2)]
        times = signing.times
    assert all(a < b for a, b in itertools.pairwise(stamps))


def test_frames_of_an_earlier_flight_are_refused_after_a_restart_even_if_the_clock_went_back() -> None:
    signing, peer = Signing(SecretKey(SECRET)), _peer()
    frame = _said(peer)
    assert signing.check(frame, NOW) is Verdict.GOOD
    later = Signing(SecretKey(SECRET), signing.times)
    assert later.check(frame, NOW - 60 * MINUTE) is Verdict.OLD
    assert later.check(_said(peer), NOW - 60 * MINUTE) is Verdict.GOOD


def test_after_hearing_a_vehicle_that_is_ahead_our_frames_are_new_to_it() -> None:
    signing, ahead = Signing(SecretKey(SECRET)), _peer(timestamp=NOW + 60 * MINUTE)
    raw = Encoder(255, 190).encode("HEARTBEAT")
    assert "HEARTBEAT" not in _heard(ahead, signing.sign(raw, 0, NOW))
    assert signing.check(_said(ahead), NOW) is Verdict.GOOD
    assert _heard(ahead, signing.sign(raw, 0, NOW)) == ["HEARTBEAT"]


def test_a_vehicle_at_the_end_of_time_does_not_take_us_there() -> None:
    signing = Signing(SecretKey(SECRET))
    assert signing.check(_said(_peer(timestamp=LATEST - 5)), NOW) is Verdict.GOOD
    assert timestamp_of(_frame(signing.sign(Encoder(255).encode("HEARTBEAT"), 0, NOW))) == NOW


def test_the_end_of_time_is_an_error_and_not_a_time_stamp_of_zero() -> None:
    with pytest.raises(ValueError, match="beyond the last one"):
        Signing(SecretKey(SECRET), Times(sent=LATEST)).sign(Encoder(255).encode("HEARTBEAT"), 0, NOW)


@given(name=st.sampled_from(["HEARTBEAT", "COMMAND_LONG", "STATUSTEXT", "SET_POSITION_TARGET_LOCAL_NED"]))
def test_without_its_signature_a_frame_is_what_it_was(name: str) -> None:
    raw = Encoder(255, 190).encode(name)
    assert flagged(Signing(SecretKey(SECRET)).sign(raw, 3, NOW), signed=False) == raw
    assert flagged(raw, signed=False) == raw


def test_only_what_radios_say_of_themselves_may_come_unsigned() -> None:
    def frame(compid: int, name: str) -> Frame:
        return _frame(Encoder(51, compid).encode(name))

    assert is_radio_status(frame(68, "RADIO_STATUS"))
    assert not is_radio_status(frame(1, "RADIO_STATUS"))
    assert not is_radio_status(frame(68, "HEARTBEAT"))


def test_a_key_is_shown_and_written_nowhere() -> None:
    key = SecretKey(SECRET)
    assert SECRET.hex() not in repr(key).encode().hex()
    assert repr(Signing(key)).find("\\x") == -1
    with pytest.raises(TypeError, match="not written"):
        pickle.dumps(key)
    with pytest.raises(ValueError, match="32 bytes, not 31") as error:
        SecretKey(SECRET[:31])
    assert SECRET[:4].hex() not in str(error.value)
