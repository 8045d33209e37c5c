"""Datagrams read together are what they are one by one, and what pymavlink reads and writes, for every message type."""

from __future__ import annotations

import inspect
import io
import math
import sys
from collections.abc import Sequence
from types import FrameType
from typing import Any
from unittest import mock

import numpy as np
import pytest
from fastcrc import crc16
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect
from pymavlink.dialects.v20 import common

from groundstation.mavlink import blocks
from groundstation.mavlink.blocks import Arrivals, Block, merge
from groundstation.mavlink.checksums import ROW, Sums, rows_checksum, stretches_checksum
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, blank, decode, encode_batch, encode_rows, layout
from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import Fleet
from groundstation.records.tlog import TlogWriter
from tests.mavlink.test_splitting import GOOD, GOOD_V1, UNKNOWN, WINDOWS, _bits

COMMON = sorted(int(number) for number in common.mavlink_map)
SECOND_NS = 1_000_000_000
PLAIN = (GOOD, Encoder(7).encode("ATTITUDE", roll=1.0), Encoder(8, compid=0xFD).encode("STATUSTEXT", text="\xfd"))
KEY = bytes(range(32))


def block_of(datagrams: Sequence[bytes], peers: Sequence[str] = ("p",), link: int = 0) -> Block:
    arrivals = Arrivals()
    for number, data in enumerate(datagrams):
        arrivals.add(link, peers[number % len(peers)], data, number * 1_000_000)
    return arrivals.block()


@settings(deadline=None, max_examples=100)
@given(st.lists(st.lists(_bits(), max_size=14).map(b"".join), min_size=1, max_size=5), st.integers(1, 5))
@example([bytes((0xFE, 0, 1, 1, 1, UNKNOWN[-1], 0, 0))], 1)  # nothing has a checksum that could be tested
def test_a_block_is_what_its_datagrams_are_one_by_one(datagrams: list[bytes], cut: int) -> None:
    whole = block_of(datagrams, ("a", "b"))
    expected = [FrameSplitter().feed(data) for data in datagrams]
    assert [pieces for _, _, pieces, _ in whole.pieces()] == expected
    assert whole.noise == sum(len(piece) for pieces in expected for piece in pieces if isinstance(piece, bytes))
    parts = [datagrams[:cut], datagrams[cut:]]
    joined = merge([block_of(part, ("a", "b")) for part in parts if part])
    assert [pieces for _, _, pieces, _ in joined.pieces()] == expected


@settings(deadline=None, max_examples=50)
@given(st.lists(st.lists(st.sampled_from(PLAIN), max_size=9).map(b"".join), min_size=1, max_size=5), st.data())
def test_frames_without_anything_else_are_found_alike_in_all_ways(datagrams: list[bytes], draw: st.DataObject) -> None:
    """One by one, one behind the other, and by whatever may begin one; with one byte wrong as well."""
    data = bytearray(b"".join(datagrams))
    offsets = np.cumsum([0, *map(len, datagrams)])
    if data and draw.draw(st.booleans()):
        data[draw.draw(st.integers(0, len(data) - 1))] ^= draw.draw(st.integers(1, 255))
    none = np.zeros(len(datagrams), dtype=np.int64)
    where = blocks.Datagrams(offsets, none, none, none, ((0, "p"),))
    with mock.patch.object(blocks, "_FEW_BYTES", -1):
        chains = blocks.split(bytes(data), where)
    expected = blocks._search(bytes(data), where)
    for block in (blocks.split(bytes(data), where), chains):
        assert [item[2] for item in block.pieces()] == [item[2] for item in expected.pieces()]
        assert [column.tolist() for column in _columns(block)] == [column.tolist() for column in _columns(expected)]


def _columns(block: Block) -> list[Any]:
    names = "start stop payload payload_size msgid known seq sysid compid signed datagram"
    return [getattr(block, name) for name in names.split()]


@settings(deadline=None)
@given(st.binary(min_size=2, max_size=1500), st.data())
def test_checksums_are_those_of_an_independent_implementation(data: bytes, draw: st.DataObject) -> None:
    padded = np.frombuffer(data + bytes(2 * ROW + -len(data) % ROW), dtype=np.uint8)
    starts = draw.draw(st.lists(st.integers(1, len(data) - 1), min_size=1, max_size=8))
    stops = [min(start + draw.draw(st.integers(0, 265)), len(data)) for start in starts]
    extra = np.array([draw.draw(st.integers(0, 255)) for _ in starts], dtype=np.uint16)
    made = Sums(padded).checksums(np.array(starts), np.array(stops), extra)
    expected = [
        crc16.mcrf4xx(data[start:stop] + bytes([byte]))
        for start, stop, byte in zip(starts, stops, extra.tolist(), strict=True)
    ]
    assert made.tolist() == expected
    for times in (1, 16):  # as many of one length as are taken together
        columns = (np.repeat(column, times) for column in (starts, stops, extra))
        assert stretches_checksum(padded.tobytes(), *columns).tolist() == np.repeat(expected, times).tolist()
    width = min(len(data), 265)
    rows = np.array([list(data[:width]), [0] * width], dtype=np.uint8)
    rows[0, width // 2 :] = 0
    lengths = np.array([width // 2, width // 3])
    both = [crc16.mcrf4xx(bytes(row[:length]) + b"\x32") for row, length in zip(rows, lengths.tolist(), strict=True)]
    assert rows_checksum(rows, lengths, 0x32).tolist() == both


def _message(msgid: int, random: np.random.Generator) -> Any:
    """One of pymavlink's messages, its fields drawn from the bytes that they take."""
    kind = dialect.mavlink_map[msgid]
    shape = layout(kind.msgname)
    raw = random.integers(0, 256, shape.size, dtype=np.uint8)
    raw[random.integers(0, shape.size + 1) :] = 0  # what stands last is cut off on the wire
    values = np.frombuffer(raw.tobytes(), dtype=shape.dtype)[0]
    given: dict[str, Any] = {}
    for name in kind.fieldnames:
        value = values[name]
        if shape.dtype[name].kind == "S":
            given[name] = bytes(b & 0x7F for b in bytes(value)).split(b"\0")[0]
        elif np.ndim(value):
            given[name] = [_plain(item) for item in value]
        else:
            given[name] = _plain(value)
    return kind(**given)


def _plain(value: Any) -> float | int:
    number = value.item()
    return 0.5 if isinstance(number, float) and math.isnan(number) else number  # NaN would lose its bits on the way


def _assert_values(theirs: Any, ours: np.void, shape: Any) -> None:
    for name in shape.field_names:
        value = getattr(theirs, name)
        if isinstance(value, str):
            assert value.encode("latin-1").rstrip(b"\0") == bytes(ours[name]), (shape.name, name)
        else:
            np.testing.assert_array_equal(np.asarray(value, dtype=shape.dtype[name].base), ours[name], err_msg=name)


@settings(deadline=None, max_examples=5)
@given(seed=st.integers(0, 2**32 - 1), garbage=st.binary(max_size=8), together=st.integers(1, 9))
def test_every_message_of_common_is_read_as_pymavlink_reads_it(seed: int, garbage: bytes, together: int) -> None:
    """Cut off, signed and not, MAVLink 1 and 2, several in a datagram, with garbage between."""
    random = np.random.default_rng(seed)
    garbage = garbage.replace(b"\xfd", b"").replace(b"\xfe", b"")
    plain, signing, first = (dialect.MAVLink(None, srcSystem=9, srcComponent=k) for k in (1, 2, 3))
    signing.signing.secret_key, signing.signing.link_id, signing.signing.timestamp = KEY, 1, 77
    signing.signing.sign_outgoing = True
    sent: list[tuple[bytes, bool]] = []
    for msgid in COMMON:
        if msgid not in dialect.mavlink_map:
            continue
        message = _message(msgid, random)
        sent.append((bytes(message.pack(plain)), False))
        sent.append((bytes(message.pack(signing)), True))
        if msgid < 256:
            sent.append((bytes(message.pack(first, force_mavlink1=True)), False))
    raws = [raw for raw, _ in sent]
    datagrams = [garbage.join([b"", *raws[k : k + together], b""]) for k in range(0, len(raws), together)]
    block = block_of(datagrams)
    assert [block.data[a:b] for a, b in zip(block.start.tolist(), block.stop.tolist(), strict=True)] == raws
    assert block.signed.tolist() == [signed for _, signed in sent]
    reader = dialect.MAVLink(None)
    reader.robust_parsing = True
    read = 0
    for batch in block.decode():
        shape = layout(batch.name)
        for row, number in enumerate(batch.index.tolist()):
            (theirs,) = reader.parse_buffer(raws[number])
            assert (theirs.get_msgId(), theirs.get_srcSystem()) == (shape.msgid, int(batch.sysid[row]))
            assert theirs.get_srcComponent() == int(batch.compid[row])
            _assert_values(theirs, batch.values[row], shape)
            read += 1
    assert read == len(raws)


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 300))
def test_every_message_of_common_is_written_as_pymavlink_writes_it(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    for msgid in random.choice(COMMON, 12).tolist():
        if msgid not in dialect.mavlink_map:
            continue
        theirs, encoder = dialect.MAVLink(None, srcSystem=9, srcComponent=4), Encoder(9, 4)
        raws = [bytes(_message(msgid, random).pack(theirs)) for _ in range(min(count, 40))]
        frames = [piece for raw in raws for piece in FrameSplitter().feed(raw) if isinstance(piece, Frame)]
        shape = layout(dialect.mavlink_map[msgid].msgname)
        payloads = b"".join(frame.payload.ljust(shape.size, b"\0") for frame in frames)
        written = encode_rows(shape.name, np.frombuffer(payloads, dtype=shape.dtype), encoder)
        expected = []
        for number, frame in enumerate(frames):
            message = dialect.MAVLink(None).parse_buffer(frame.raw)[0]
            theirs.seq = number % 256
            expected.append(bytes(message.pack(theirs)))
        assert written == expected
        assert encoder.seq == len(frames) % 256


def test_many_are_encoded_as_one_by_one() -> None:
    values = blank("SET_POSITION_TARGET_LOCAL_NED", 300)
    values["vx"] = np.linspace(-1.0, 1.0, 300)
    values["yaw"][::3] = 0.5
    many, single = Encoder(255, 190), Encoder(255, 190)
    one_by_one = [encode_batch("SET_POSITION_TARGET_LOCAL_NED", values[k : k + 1], [single])[0] for k in range(300)]
    assert encode_batch("SET_POSITION_TARGET_LOCAL_NED", values, [many] * 300) == one_by_one
    assert many.seq == single.seq
    two = [many if k % 2 else single for k in range(300)]
    assert {frame[5] for frame in encode_batch("SET_POSITION_TARGET_LOCAL_NED", values, two)} == {255}


@pytest.mark.parametrize("unit", [WINDOWS, UNKNOWN, b"\xfe", b"\xfd"], ids=["windows", "unknown", "fe", "fd"])
def test_hostile_bytes_take_a_few_lines_of_python_whatever_they_are(unit: bytes) -> None:
    lines = 0

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal lines
        if frame.f_code.co_filename != inspect.getfile(blocks):
            return None
        lines += event == "line"
        return trace

    data = (unit * (20_000 // len(unit) + 1))[:20_000]
    before = sys.gettrace()
    sys.settrace(trace)
    try:
        block_of([data])
    finally:
        sys.settrace(before)
    assert lines <= 5 * len(data)


def _telemetry(sysid: int, k: int, compid: int = 1) -> list[bytes]:
    encoder = Encoder(sysid, compid)
    return [
        encoder.encode("HEARTBEAT", type=2, autopilot=12, base_mode=128 * (k % 2), custom_mode=k, mavlink_version=3),
        encoder.encode("LOCAL_POSITION_NED", time_boot_ms=1000 + k, x=float(k), vz=0.5),
        encoder.encode("ATTITUDE_QUATERNION", time_boot_ms=1000 + k, q1=1.0),
        encoder.encode("SYS_STATUS", voltage_battery=12_000 + k, onboard_control_sensors_health=k),
        encoder.encode("COMMAND_ACK", command=400, result=k % 5),
        encoder.encode("STATUSTEXT", severity=4, text=f"word {k}"),
        encoder.encode("TIMESYNC", tc1=0, ts1=k),
        bytes([0xFD, 3, 0, 0, 9, sysid, 1, 0xFF, 0xFF, 0xFF, 1, 2, 3, 0xAA, 0xBB]),
        encoder.encode("HEARTBEAT", type=6, autopilot=8, mavlink_version=3),
        encoder.encode("HEARTBEAT", type=1, autopilot=12, base_mode=128, mavlink_version=3),
        encoder.encode("HEARTBEAT", type=2, autopilot=0),
    ]


def _state(station: Station) -> dict[str, str]:
    fleet = station.fleet
    state: dict[str, Any] = {
        name: value.tolist()
        for name, value in vars(fleet).items()
        if isinstance(value, np.ndarray) and name != "_source_of_row"
    }
    state |= {name: value.tolist() for name, value in fleet.seen.items()}
    state |= {"peer": fleet.peer, "rivals": fleet._rivals, "bytes": sorted(station.bytes_received.items())}
    state |= {"counts": sorted(fleet.counts.items()), "elsewhere": sorted(fleet._elsewhere.items())}
    state |= {"parts": fleet.senders._parts, "kinds": fleet.senders._strange, "others": fleet.senders._components}
    state |= {"texts": fleet.take_texts(), "timesync": fleet.take_timesync_requests()}
    return {name: repr(value) for name, value in state.items()}


@settings(deadline=None)
@given(
    st.lists(
        st.lists(
            st.tuples(
                st.sampled_from([1, 1, 2, 2, 3, 9]),  # 1 to 3 are the team's
                st.sampled_from([1, 1, 1, 1, 2]),
                st.sampled_from([0, 0, 0, 1]),
                st.sampled_from(["home", "home", "home", "home", "away"]),
                st.lists(st.sampled_from([*range(8), *range(8), *range(11)]), min_size=1, max_size=4),
                st.sampled_from([b"", b"", b"noise"]),
            ),
            min_size=1,
            max_size=12,
        ),
        max_size=8,
    ),
    st.integers(1, 12),
    st.booleans(),
)
def test_a_fleet_that_reads_blocks_knows_what_one_knows_that_reads_frames(
    ticks: list[Any], cut: int, held: bool
) -> None:
    """Strangers, other components, other links and addresses among them; also the log is the same to the byte."""
    logs = [io.BytesIO(), io.BytesIO()]
    one, other = (Station(Fleet([1, 2, 3], [0, 0, 1]), 0) for _ in range(2))
    writers = [TlogWriter(log, 0) for log in logs]
    now_ns = 0
    for number, tick in enumerate(ticks):
        if held and number == 1:
            one.fleet.hold_addresses()
            other.fleet.hold_addresses()
        arrivals = Arrivals()
        for place, (sysid, compid, link, peer, kinds, noise) in enumerate(tick):
            now_ns += 40_000_000
            raw = _telemetry(sysid, 8 * number + place, compid)
            data = b"".join(raw[k] for k in kinds) + noise
            arrivals.add(link, f"{peer}{sysid}:1", data, now_ns)
            one.receive(link, f"{peer}{sysid}:1", data, now_ns)
            writers[0].received(link, f"{peer}{sysid}:1", data, now_ns)
            if place == cut or place == len(tick) - 1:
                block = arrivals.block()
                other.take_block(block)
                writers[1].took_block(block)
        one.ingest()
        other.ingest()
        assert _state(one) == _state(other)
    for writer in writers:
        writer.flush()
    assert logs[0].getvalue() == logs[1].getvalue()


def _of_newer_dialect(msgid: int, size: int, seq: int) -> bytes:
    """A frame with a payload of that size whatever the message's is, as firmware with a newer dialect sends it."""
    body = bytes([size, 0, 0, seq, 1, 1, *msgid.to_bytes(3, "little")]) + bytes(range(1, size + 1))
    extra = bytes([common.mavlink_map[msgid].crc_extra])
    return b"\xfd" + body + crc16.mcrf4xx(body + extra).to_bytes(2, "little")


@pytest.mark.parametrize("msgid", COMMON)
def test_fields_that_a_newer_dialect_has_appended_are_left_out(msgid: int) -> None:
    # PX4 1.16 appends two bytes to some TIMESYNC and cuts zeros off others; a block with both was a fault of ours.
    known = layout(common.mavlink_map[msgid].msgname).size
    sizes = [max(known - 4, 1), min(known + 2, 255), known, min(known + 9, 255)]
    data = b"".join(_of_newer_dialect(msgid, size, k) for k, size in enumerate(sizes))
    (ours,) = block_of([data]).decode()
    (theirs,) = decode([piece for piece in FrameSplitter().feed(data) if isinstance(piece, Frame)])
    assert ours.values.tobytes() == theirs.values.tobytes()
    assert len(ours.values) == len(sizes)


def test_nothing_and_noise_alone_are_blocks_too() -> None:
    for datagrams in ([b""], [b"", b"noise", b""], [GOOD[:-1], GOOD[-1:]], [GOOD_V1 + b"\xfd"]):
        block = block_of(datagrams)
        assert [pieces for _, _, pieces, _ in block.pieces()] == [FrameSplitter().feed(data) for data in datagrams]
        assert block.decode() == [] or len(block) == 1
        station = Station(Fleet([1], [0]), 0)
        station.take_block(block)
        station.ingest()
