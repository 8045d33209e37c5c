"""Frames against pymavlink as the independent peer, exact bytes, and noise that must not cost a good frame."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.mavlink.codec import (
    Encoder,
    Frame,
    FrameSplitter,
    Splitters,
    blank,
    decode,
    encode_batch,
    layout,
    message_id,
    message_name,
)


def _pymavlink(sysid: int, *, version: int = 2) -> dialect.MAVLink:
    link = dialect.MAVLink(None, srcSystem=sysid, srcComponent=1)
    link.robust_parsing = True
    if version == 1:
        link.WIRE_PROTOCOL_VERSION = "1.0"
    return link


def _frames(pieces: list[Frame | bytes]) -> list[Frame]:
    return [piece for piece in pieces if isinstance(piece, Frame)]


def test_heartbeat_of_a_ground_station_to_the_byte() -> None:
    """Bytes put together by hand from the MAVLink serialisation guide; checksum by a bitwise X.25 of this test."""
    raw = Encoder(255, 190).encode("HEARTBEAT", type=6, autopilot=8, system_status=4, mavlink_version=3)
    body = bytes([9, 0, 0, 0, 255, 190, 0, 0, 0]) + struct.pack("<IBBBBB", 0, 6, 8, 0, 4, 3)
    assert raw == b"\xfd" + body + struct.pack("<H", _x25(body + bytes([50])))


def _x25(data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


def test_pymavlink_reads_our_setpoint_and_we_read_its_telemetry() -> None:
    raw = Encoder(255, 190).encode(
        "SET_POSITION_TARGET_LOCAL_NED",
        target_system=3,
        coordinate_frame=1,
        type_mask=0x09C7,
        vx=0.25,
        vz=-0.5,
        yaw=1.5,
    )
    (message,) = _pymavlink(1).parse_buffer(raw)
    assert (message.target_system, message.type_mask, message.vx, message.vz, message.yaw) == (
        3,
        0x09C7,
        0.25,
        -0.5,
        1.5,
    )

    theirs = _pymavlink(7)
    packed = dialect.MAVLink_local_position_ned_message(1234, 1.0, 2.0, -3.0, 0.0, 0.5, 0.0).pack(theirs)
    (batch,) = decode(_frames(FrameSplitter().feed(packed)))
    assert batch.name == "LOCAL_POSITION_NED"
    assert batch.sysid.tolist() == [7]
    assert batch.values["z"].tolist() == [-3.0]
    assert batch.values["vz"].tolist() == [0.0]  # cut off on the wire
    assert batch.values["time_boot_ms"].tolist() == [1234]


def test_every_message_type_of_the_dialect_survives_the_way_through_pymavlink() -> None:
    rng = np.random.default_rng(1)
    reader = _pymavlink(1)
    for name in {message_name(msgid) for msgid in dialect.mavlink_map}:
        assert name is not None
        shape = layout(name)
        values = np.frombuffer(rng.integers(1, 100, shape.size, dtype=np.uint8).tobytes(), dtype=shape.dtype)
        (raw,) = encode_batch(name, values, [Encoder(9)])
        (message,) = reader.parse_buffer(raw)
        assert message.get_msgId() == shape.msgid == message_id(name)
        for field in shape.field_names:
            theirs = getattr(message, field)
            ours = values[field][0]
            if isinstance(theirs, str):
                assert theirs.encode("latin-1").rstrip(b"\0") == bytes(ours), (name, field)
            else:
                np.testing.assert_array_equal(
                    np.asarray(theirs, dtype=shape.dtype[field].base), ours, err_msg=f"{name}.{field}"
                )


@pytest.mark.parametrize("name", ["HEARTBEAT", "STATUSTEXT", "COMMAND_ACK", "SYS_STATUS", "BATTERY_STATUS"])
def test_mavlink_1_carries_the_base_fields_only_and_pymavlink_reads_it(name: str) -> None:
    (raw,) = encode_batch(name, blank(name, 1), [Encoder(5, version=1)])
    assert raw[0] == 0xFE
    (message,) = _pymavlink(1, version=1).parse_buffer(raw)
    assert message.get_type() == name
    (frame,) = _frames(FrameSplitter().feed(raw))
    assert frame.version == 1
    expected = dialect.mavlink_map[message_id(name)]
    assert (
        len(frame.payload)
        == {"HEARTBEAT": 9, "STATUSTEXT": 51, "COMMAND_ACK": 3, "SYS_STATUS": 31, "BATTERY_STATUS": 36}[name]
    )
    assert expected.crc_extra == layout(name).crc_extra


def test_batches_keep_order_and_count_each_sender_for_itself() -> None:
    one, two = Encoder(1), Encoder(2)
    values = blank("LOCAL_POSITION_NED", 3)
    values["x"] = [10.0, 20.0, 30.0]
    frames = _frames(FrameSplitter().feed(b"".join(encode_batch("LOCAL_POSITION_NED", values, [one, two, one]))))
    assert [(frame.sysid, frame.seq) for frame in frames] == [(1, 0), (2, 0), (1, 1)]
    frames.insert(1, _frames(FrameSplitter().feed(two.encode("HEARTBEAT", type=2)))[0])
    position, heartbeat = decode(frames)
    assert position.values["x"].tolist() == [10.0, 20.0, 30.0]
    assert position.index.tolist() == [0, 2, 3]
    assert heartbeat.index.tolist() == [1]


def test_frame_of_an_unknown_id_is_passed_over_by_its_length() -> None:
    known = Encoder(1).encode("HEARTBEAT", type=2)
    unknown = bytes([0xFD, 3, 0, 0, 9, 1, 1, 0xFF, 0xFF, 0xFF, 0xFD, 2, 3, 0xAA, 0xBB])
    pieces = FrameSplitter().feed(unknown + known)
    assert [piece.msgid for piece in pieces if isinstance(piece, Frame)] == [0xFFFFFF, 0]
    assert [batch.name for batch in decode(_frames(pieces))] == ["HEARTBEAT"]


def test_frame_with_an_unknown_incompatibility_flag_is_not_understood() -> None:
    raw = bytearray(Encoder(1).encode("HEARTBEAT", type=2))
    raw[2] = 0x02
    body = bytes(raw[1:-2])
    raw[-2:] = struct.pack("<H", _x25(body + bytes([50])))
    assert not _frames(FrameSplitter().feed(bytes(raw)))


@given(
    st.lists(
        st.one_of(st.binary(max_size=40).map(lambda b: b.replace(b"\xfd", b"").replace(b"\xfe", b"")), st.none()),
        max_size=8,
    )
)
def test_noise_between_frames_costs_none_of_them_and_no_byte_is_lost(parts: list[bytes | None]) -> None:
    encoder = Encoder(4)
    sent = [
        encoder.encode("ATTITUDE", time_boot_ms=k, roll=0.1) if part is None else part for k, part in enumerate(parts)
    ]
    pieces = FrameSplitter().feed(b"".join(sent))
    good = [piece.raw for piece in pieces if isinstance(piece, Frame)]
    assert good == [raw for raw, part in zip(sent, parts, strict=True) if part is None]
    assert b"".join(piece.raw if isinstance(piece, Frame) else piece for piece in pieces) == b"".join(sent)


@given(st.binary(max_size=600))
def test_arbitrary_bytes_never_raise_and_come_out_again(data: bytes) -> None:
    pieces = FrameSplitter().feed(data)
    decode(_frames(pieces))
    assert b"".join(piece.raw if isinstance(piece, Frame) else piece for piece in pieces) == data


@given(st.lists(st.integers(1, 30), min_size=1, max_size=12), st.binary(max_size=5))
def test_a_stream_cut_anywhere_gives_the_same_frames(cuts: list[int], noise: bytes) -> None:
    encoder = Encoder(4)
    noise = noise.replace(b"\xfd", b"").replace(b"\xfe", b"")
    data = b"".join(encoder.encode("ATTITUDE", time_boot_ms=k, roll=0.1) + noise for k in range(5))
    splitter = FrameSplitter(datagrams=False)
    got: list[Frame] = []
    position = 0
    for cut in [*cuts, len(data)]:
        got += _frames(splitter.feed(data[position : position + cut]))
        position += cut
    assert [frame.seq for frame in got] == [0, 1, 2, 3, 4]


def test_truncated_and_flipped_frames_are_noise() -> None:
    raw = Encoder(1).encode("HEARTBEAT", type=2)
    assert FrameSplitter().feed(raw[:-1]) == [raw[:-1]]
    for position in range(1, len(raw)):
        flipped = bytearray(raw)
        flipped[position] ^= 0x10
        good = _frames(FrameSplitter().feed(bytes(flipped)))
        assert not [frame for frame in good if frame.msgid == 0]


def test_values_that_do_not_fit_are_refused() -> None:
    encoder = Encoder(1)
    with pytest.raises(KeyError, match="no field sped"):
        encoder.encode("HEARTBEAT", sped=1)
    with pytest.raises(ValueError, match="does not fit"):
        encoder.encode("HEARTBEAT", type=256)
    with pytest.raises(ValueError, match="limit 50"):
        encoder.encode("STATUSTEXT", text="x" * 51)
    assert encoder.seq == 0


@pytest.mark.parametrize("datagrams", [True, False])
@pytest.mark.parametrize("rest", [b"", b"\xfd", b"\x00\xfe\x07"])
def test_noise_that_looks_like_an_unknown_message_takes_no_good_frame_with_it(rest: bytes, *, datagrams: bool) -> None:
    """Random bytes behind a magic byte are nearly always an id that nobody knows, without a checksum to test."""
    good = Encoder(1).encode("HEARTBEAT", type=2)
    noise = bytes((0xFD, len(good) + len(rest) - 2, 0, 0, 0, 1, 1, 0xFF, 0xFF, 0xFF)) + rest
    splitter = FrameSplitter(datagrams=datagrams)
    pieces = splitter.feed(noise + good) + splitter.feed(good + bytes(300))
    assert [piece.raw for piece in pieces if isinstance(piece, Frame)] == [good, good]


def test_a_real_unknown_message_is_taken_whole() -> None:
    unknown = b"\xfd\x05\x00\x00\x00\x01\x01\xff\xff\xff\xfehello"[:15] + b"\x12\x34"
    good = Encoder(1).encode("HEARTBEAT", type=2)
    first, second = FrameSplitter().feed(unknown + good)
    assert isinstance(first, Frame)
    assert isinstance(second, Frame)
    assert (first.raw, second.raw) == (unknown, good)


def test_streams_are_kept_apart_and_bounded() -> None:
    splitters, good = Splitters(most=3), Encoder(1).encode("HEARTBEAT", type=2)
    assert splitters.feed("a", good[:9], stream=True) == []
    for number in range(100):
        splitters.feed(number, good[:5], stream=True)
        splitters.feed("a", b"", stream=True)  # the one that is heard is kept
    assert len(splitters._streams) == 3
    (frame,) = splitters.feed("a", good[9:], stream=True)
    assert isinstance(frame, Frame)
