from __future__ import annotations

import errno
import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil
from pymavlink.dialects.v10 import ardupilotmega as dialect_v1

from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Encoder, FrameSplitter
from groundstation.records.notes import Event, Noise, Operator, Received, Record, Roles, Sent, Tick
from groundstation.records.tlog import TlogReader, TlogWriter, read_tlog

EPOCH_US = 1_577_836_800_000_000


class Memory(io.BytesIO):
    """A file whose bytes outlive its closing."""

    content = b""

    def close(self) -> None:
        self.content = self.getvalue()
        super().close()


def heartbeat(sysid: int, compid: int = 1, version: int = 2) -> bytes:
    return Encoder(sysid, compid, version=version).encode("HEARTBEAT", type=2, autopilot=12, mavlink_version=3)


def crc_x25(data: bytes) -> int:
    """CRC-16/MCRF4XX bit by bit, as the MAVLink guide defines it."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0x8408 if crc & 1 else crc >> 1
    return crc


def written(write: Any, **options: Any) -> bytes:
    file = Memory()
    with TlogWriter(file, EPOCH_US, **options) as writer:
        write(writer)
    assert writer.problem is None
    return file.content


def everything(writer: TlogWriter) -> None:
    """A short flight with a record of each kind."""
    writer.operator("start", 1_000)
    for number in range(4):
        t_ns = 2_000 + number * 20_000_000
        writer.received(0, "127.0.0.1:14580", heartbeat(1), t_ns)
        writer.received(0, "127.0.0.1:14581", heartbeat(2), t_ns)
        writer.tick(t_ns + 1_000, number)
        writer.sent(heartbeat(255, 190), t_ns + 1_000)
    writer.received(0, "127.0.0.1:14581", b"boot: \xfd\xfe garbage" * 20, 90_000_000)
    writer.event("phase: form", 95_000_000)
    writer.roles([2, None, 0], 96_000_000)
    writer.received(1, "10.0.0.2:9", heartbeat(1), 99_000_000)


def test_one_frame_is_these_bytes() -> None:
    def write(writer: TlogWriter) -> None:
        writer.sent(heartbeat(255, 190), 1_234_567_000)

    log = written(write)
    stamp_us = EPOCH_US + 1_234_567
    # HEADER: TUNNEL (385, CRC extra 147) from 255/190: type 0x9000, target 0/0, 10 bytes: version 1, epoch
    payload = struct.pack("<HBBB", 0x9000, 0, 0, 10) + struct.pack("<Hq", 1, EPOCH_US)
    payload = payload.rstrip(b"\0")
    body = bytes((len(payload), 0, 0, 0, 255, 190, 0x81, 0x01, 0x00)) + payload
    header = b"\xfd" + body + struct.pack("<H", crc_x25(body + b"\x93"))
    # HEARTBEAT (0, CRC extra 50): custom_mode 0, type 2, autopilot 12, base_mode 0, status 0, version 3
    body = bytes((9, 0, 0, 0, 255, 190, 0, 0, 0)) + bytes((0, 0, 0, 0, 2, 12, 0, 0, 3))
    frame = b"\xfd" + body + struct.pack("<H", crc_x25(body + b"\x32"))
    assert log == struct.pack(">Q", stamp_us) + header + struct.pack(">Q", stamp_us) + frame


def test_all_kinds_come_back() -> None:
    records = list(TlogReader(written(everything)))
    assert [type(record).__name__ for record in records] == [
        "Operator",
        *["Received", "Received", "Tick", "Sent"] * 4,
        "Noise",
        "Event",
        "Roles",
        "Received",
    ]
    assert records[0] == Operator(1_000, "start")
    first, second, tick, sent = records[1:5]
    assert isinstance(first, Received)
    assert isinstance(second, Received)
    assert isinstance(sent, Sent)
    assert (first.t_ns, first.link, first.peer, first.frame.raw) == (2_000, 0, "127.0.0.1:14580", heartbeat(1))
    assert (second.peer, second.frame.sysid) == ("127.0.0.1:14581", 2)
    assert tick == Tick(3_000, 0)
    assert (sent.t_ns, sent.frame.raw) == (3_000, heartbeat(255, 190))
    assert records[-4] == Noise(90_000_000, 0, "127.0.0.1:14581", b"boot: \xfd\xfe garbage" * 20)
    assert records[-3] == Event(95_000_000, "phase: form")
    assert records[-2] == Roles(96_000_000, (2, None, 0))
    last = records[-1]
    assert isinstance(last, Received)
    assert (last.link, last.peer, last.frame.sysid) == (1, "10.0.0.2:9", 1)


def test_origin_is_noted_once_while_it_stays() -> None:
    def write(count: int) -> bytes:
        return written(lambda writer: [writer.received(0, "peer", heartbeat(1), k * 1000) for k in range(count)])

    assert len(write(5)) - len(write(4)) == 8 + len(heartbeat(1))


def test_tick_time_is_kept_to_the_nanosecond() -> None:
    (tick,) = TlogReader(written(lambda writer: writer.tick(123_456_789_012_345, 7)))
    assert tick == Tick(123_456_789_012_345, 7)


def test_received_frame_with_our_own_ids_stays_received() -> None:
    def write(writer: TlogWriter) -> None:
        writer.sent(heartbeat(255, 190), 1_000)
        writer.received(3, "other station", heartbeat(255, 190), 2_000)
        writer.sent(heartbeat(255, 190), 3_000)
        writer.received(3, "third station", heartbeat(255, 230), 4_000)
        writer.sent(heartbeat(255, 190), 5_000)
        writer.received(3, "other station", heartbeat(255, 190), 6_000)

    records = list(TlogReader(written(write)))
    assert [type(record) for record in records] == [Sent, Received, Sent, Received, Sent, Received]
    assert isinstance(records[1], Received)
    assert isinstance(records[3], Received)
    assert records[1].peer == "other station"
    assert records[3].peer == "third station"


def test_forged_note_from_the_air_stays_a_received_frame() -> None:
    forged = Encoder(255, 190).encode("TUNNEL", payload_type=0x9004, payload_length=5, payload=b"\x00land")
    (record,) = TlogReader(written(lambda writer: writer.received(0, "attacker", forged, 0)))
    assert isinstance(record, Received)


def test_signing_keys_stay_out() -> None:
    key = b"a key that nobody may see 32 byt"
    setup = Encoder(255, 190).encode("SETUP_SIGNING", target_system=1, secret_key=list(key))
    damaged = setup[:-1] + bytes((setup[-1] ^ 1,))

    def write(writer: TlogWriter) -> None:
        writer.sent(setup, 0)
        writer.received(0, "p", heartbeat(1) + setup + heartbeat(1), 0)
        writer.received(0, "p", damaged, 0)
        writer.received(0, "p", b"noise" + setup[:30], 0)

    log = written(write)
    assert key not in log
    assert key[:8] not in log
    assert [len(record.data) for record in TlogReader(log) if isinstance(record, Noise)] == [len(damaged), 35]


@given(st.text(max_size=400), st.lists(st.one_of(st.none(), st.integers(0, 65_000)), max_size=200))
def test_texts_and_roles_of_any_length(text: str, roles: list[int | None]) -> None:
    def write(writer: TlogWriter) -> None:
        writer.operator(text, 0)
        writer.event(text, 1_000)
        writer.received(2, text, heartbeat(9), 2_000)
        writer.roles(roles, 3_000)

    operator, event, received, last = TlogReader(written(write))
    assert operator == Operator(0, text)
    assert event == Event(1_000, text)
    assert isinstance(received, Received)
    assert received.peer == text
    assert last == Roles(3_000, tuple(roles))


@given(
    st.lists(st.one_of(st.binary(max_size=300), st.sampled_from([heartbeat(1), heartbeat(2, version=1)])), max_size=6)
)
def test_received_bytes_come_back_in_order(datagrams: list[bytes]) -> None:
    log = written(lambda writer: [writer.received(0, "p", data, 0) for data in datagrams])
    pieces = [piece for data in datagrams for piece in FrameSplitter().feed(data)]
    back = [record.data if isinstance(record, Noise) else record.frame for record in _received(TlogReader(log))]
    assert back == pieces


def _received(records: TlogReader) -> list[Noise | Received]:
    return [record for record in records if isinstance(record, Noise | Received)]


WHOLE = written(everything)
RECORDS = list(TlogReader(WHOLE))


def test_every_truncation_gives_a_prefix() -> None:
    counts = []
    for size in range(len(WHOLE) - 1, 44, -1):
        reader = TlogReader(WHOLE[:size])
        records = list(reader)
        assert records == RECORDS[: len(records)]
        assert reader.damaged_bytes == 0
        assert (reader.message is None) == (reader.truncated_bytes == 0)
        counts.append(len(records))
    assert counts == sorted(counts, reverse=True)
    assert counts[0] == len(RECORDS) - 1
    assert counts[-1] == 0


def test_truncation_tells_how_much_was_lost() -> None:
    reader = TlogReader(WHOLE[:-5], "flight.tlog")
    list(reader)
    lost = 8 + len(heartbeat(1)) - 5
    assert reader.truncated_bytes == lost
    assert reader.message == f"flight.tlog: the last {lost} bytes are no whole record and were left out"


def record_starts(log: bytes) -> list[int]:
    """Where each record of a log of MAVLink 2 frames without signatures begins, and where the log ends."""
    starts = [0]
    while starts[-1] < len(log):
        starts.append(starts[-1] + 8 + 12 + log[starts[-1] + 9])
    return starts


STARTS = record_starts(WHOLE)


def frame_at(start: int) -> bytes:
    return WHOLE[start + 8 : start + 20 + WHOLE[start + 9]]


def frames(records: TlogReader) -> list[bytes]:
    return [record.frame.raw for record in records if isinstance(record, Received | Sent)]


@given(st.integers(44, len(WHOLE)), st.binary(min_size=1, max_size=600))
def test_garbage_costs_no_later_record(position: int, garbage: bytes) -> None:
    reader = TlogReader(WHOLE[:position] + garbage + WHOLE[position:])
    hit = [start for start in STARTS if start < position][-1]
    later = [start for start in STARTS if start >= position][:-1]
    stamps = [stamp_us for stamp_us, _ in reader._frames()]
    raws = [frame.raw for _, frame in reader._frames()]
    before = [start for start in STARTS if start < hit] + ([hit] if position in STARTS else [])
    assert raws[: len(before)] == [frame_at(start) for start in before]
    assert raws[len(raws) - len(later) :] == [frame_at(start) for start in later]
    assert all(abs(stamp_us - EPOCH_US) < 86_400_000_000 for stamp_us in stamps)


def test_garbage_between_two_records_is_counted() -> None:
    middle = STARTS[8]
    reader = TlogReader(WHOLE[:middle] + b"\xfd\x09 no frame at all" + WHOLE[middle:])
    assert list(reader) == RECORDS
    assert reader.damaged_bytes == 18
    assert reader.message is not None
    assert "18 bytes amid the log" in reader.message


def test_damaged_first_time_stamp_costs_one_record() -> None:
    log = written(lambda writer: [writer.sent(heartbeat(255, 190), k * 1_000_000) for k in range(5)])
    broken = b"\x00\x01" + log[2:]
    reader = TlogReader(broken, epoch_unix_us=EPOCH_US)
    assert [record.t_ns for record in reader] == [k * 1_000_000 for k in range(5)]


@pytest.mark.parametrize("version", [1, 2])
def test_foreign_log(version: int, tmp_path: Path) -> None:
    path = tmp_path / "qgc.tlog"
    frames_in = [heartbeat(1, version=version), heartbeat(255, 190, version), heartbeat(7, version=version)]
    path.write_bytes(b"".join(struct.pack(">Q", 1_700_000_000_000_000 + k * 500) + f for k, f in enumerate(frames_in)))
    reader = read_tlog(path)
    records = list(reader)
    assert not reader.native
    assert reader.epoch_unix_us == 1_700_000_000_000_000
    assert [type(record) for record in records] == [Received, Sent, Received]
    assert [record.t_ns for record in records] == [0, 500_000, 1_000_000]
    assert [record.frame.raw for record in records if isinstance(record, Received | Sent)] == frames_in


def test_foreign_log_by_pymavlink_with_unknown_id_and_time_jump(tmp_path: Path) -> None:
    old = dialect_v1.MAVLink(None, srcSystem=4, srcComponent=1)
    first = bytes(dialect_v1.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0, 0, 0).pack(old))
    unknown = b"\xfd\x03\x00\x00\x05\x04\x01\xf0\xff\x7f" + b"abc" + b"??"
    times = [1_700_000_000_000_000, 1_700_000_000_000_100, 1_800_000_000_000_000, 1_800_000_000_000_001]
    data = [first, unknown, heartbeat(4), heartbeat(4)]
    path = tmp_path / "other.tlog"
    path.write_bytes(b"".join(struct.pack(">Q", t) + raw for t, raw in zip(times, data, strict=True)))
    reader = read_tlog(path)
    assert frames(reader) == data
    assert reader.message is None


def test_signed_frames_are_kept_whole() -> None:
    frame = bytearray(heartbeat(3))
    frame[2] |= 1
    body = bytes(frame[1:-2])
    signed = b"\xfd" + body + struct.pack("<H", crc_x25(body + b"\x32")) + bytes(range(13))
    (record,) = TlogReader(written(lambda writer: writer.received(0, "p", signed, 0)))
    assert isinstance(record, Received)
    assert record.frame.signed
    assert record.frame.raw == signed


def test_mavutil_reads_the_same_messages(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    position = Encoder(2).encode("LOCAL_POSITION_NED", time_boot_ms=5, x=1.5, y=-2.0, z=-0.5)
    with TlogWriter(path, EPOCH_US) as writer:
        writer.received(0, "p", heartbeat(1), 0)
        writer.tick(20_000_000, 1)
        writer.received(0, "p", position, 1_500_000_000)
    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    messages = []
    while (message := log.recv_msg()) is not None:
        messages.append(message)
    log.close()
    names = [message.get_type() for message in messages]
    assert names == ["TUNNEL", "TUNNEL", "HEARTBEAT", "TUNNEL", "TUNNEL", "LOCAL_POSITION_NED"]
    assert [message.payload_type for message in messages if message.get_type() == "TUNNEL"] == [
        0x9000,
        0x9002,
        0x9001,
        0x9002,
    ]
    last = messages[-1]
    assert (last.get_srcSystem(), last.x, last.y, last.z) == (2, 1.5, -2.0, -0.5)
    assert last._timestamp == pytest.approx(EPOCH_US / 1e6 + 1.5, abs=1e-6)


def test_log_reaches_the_file_each_second() -> None:
    file = io.BytesIO()
    writer = TlogWriter(file, EPOCH_US)
    writer.tick(5_000_000_000, 1)
    writer.tick(5_999_999_000, 2)
    assert file.getvalue() == b""
    writer.tick(6_000_000_000, 3)
    assert [record for record in TlogReader(file.getvalue()) if isinstance(record, Tick)][-1].number == 3


class FullDisk(io.BytesIO):
    """Takes so many bytes, in small bites, and then no more."""

    def __init__(self, room: int) -> None:
        super().__init__()
        self.room = room

    def write(self, data: Any, /) -> int:
        if self.room == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        count = min(len(data), self.room, 7)
        self.room -= count
        return super().write(data[:count])


def test_full_disk_ends_the_recording_and_not_the_flight() -> None:
    disk = FullDisk(200)
    writer = TlogWriter(disk, EPOCH_US)
    for number in range(500):
        writer.tick(number * 20_000_000, number)
        writer.received(0, "p", heartbeat(1), number * 20_000_000)
    assert writer.problem == "log: recording stopped: No space left on device"
    kept = disk.getvalue()
    assert len(kept) == 200
    assert [record.number for record in TlogReader(kept) if isinstance(record, Tick)] == [0, 1]
    writer.close()
    writer.close()


def test_a_file_that_is_deleted_or_replaced_is_noticed_within_a_second(tmp_path: Path) -> None:
    def ticks_until_told(path: Path, mischief: Callable[[], object]) -> tuple[int, str]:
        with TlogWriter(path, EPOCH_US) as writer:
            for number in range(200):
                if number == 60:
                    mischief()
                writer.tick(number * 20_000_000, number)
                if writer.problem is not None:
                    return number, writer.problem.partition("recording stopped: ")[2]
        raise AssertionError("never told")

    deleted = "the file was deleted or moved while it was written"
    path, folder = tmp_path / "a.tlog", tmp_path / "folder"
    assert ticks_until_told(path, path.unlink) == (100, deleted)
    folder.mkdir()
    assert ticks_until_told(folder / "b.tlog", lambda: folder.rename(tmp_path / "away")) == (100, deleted)
    other = tmp_path / "other"
    other.write_bytes(b"")
    assert ticks_until_told(tmp_path / "c.tlog", lambda: other.replace(tmp_path / "c.tlog")) == (
        100,
        "the file was replaced while it was written",
    )


def test_small_bites_lose_nothing() -> None:
    slow = FullDisk(10**9)
    writer = TlogWriter(slow, EPOCH_US)
    everything(writer)
    writer._flush()
    assert slow.getvalue() == WHOLE


def test_log_without_records_is_still_a_log() -> None:
    reader = TlogReader(written(lambda writer: None))
    assert list(reader) == []
    assert reader.epoch_unix_us == EPOCH_US


def test_unusable_files_are_told(tmp_path: Path) -> None:
    empty, text, missing = tmp_path / "empty.tlog", tmp_path / "text.tlog", tmp_path / "none.tlog"
    empty.write_bytes(b"")
    text.write_text("time,x,y,z\n" * 100)
    for path, words in ((empty, "empty"), (text, "no MAVLink frame in 1100 bytes"), (missing, "no such log")):
        with pytest.raises(UserError, match=words) as caught:
            read_tlog(path)
        assert str(path) in str(caught.value)
    with pytest.raises(UserError, match="is no regular file, expected a log"):
        read_tlog(tmp_path)
    with pytest.raises(UserError, match="cannot create the log"):
        TlogWriter(tmp_path / "no folder" / "flight.tlog", EPOCH_US)


def test_later_format_is_refused() -> None:
    payload = struct.pack("<Hq", 2, EPOCH_US)
    header = Encoder(255, 190).encode("TUNNEL", payload_type=0x9000, payload_length=10, payload=payload)
    with pytest.raises(UserError, match="log format 2, this program reads up to 1"):
        TlogReader(struct.pack(">Q", EPOCH_US) + header)


def test_notes_of_a_later_minor_kind_are_passed_over() -> None:
    later = Encoder(255, 190).encode("TUNNEL", payload_type=0x9123, payload_length=1, payload=b"x")
    log = written(lambda writer: writer.tick(0, 1)) + struct.pack(">Q", EPOCH_US) + later
    records: list[Record] = list(TlogReader(log))
    assert records == [Tick(0, 1)]
