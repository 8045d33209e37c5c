"""Logs read as columns give what reading them record by record gives."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from groundstation.mavlink.codec import Encoder
from groundstation.records import spans, tlog
from groundstation.records.notes import Received, Record, Sent, Tick
from groundstation.records.replay import Flight, load_flight
from groundstation.records.responses import load_motions
from groundstation.records.spans import Span
from groundstation.records.tlog import TlogReader, TlogWriter
from tests.reference import unpack


def _one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tlog, "plain_stretch", lambda *_: None)


def _same(one: Flight, other: Flight) -> None:
    for field in dataclasses.fields(Flight):
        if field.name == "vehicles":
            continue
        if field.name == "formations":
            assert [item.start_ns for item in one.formations] == [item.start_ns for item in other.formations]
            continue
        np.testing.assert_equal(getattr(one, field.name), getattr(other, field.name), field.name)
    assert len(one.vehicles) == len(other.vehicles)
    for mine, theirs in zip(one.vehicles, other.vehicles, strict=True):
        for field in dataclasses.fields(mine):
            left, right = getattr(mine, field.name), getattr(theirs, field.name)
            np.testing.assert_array_equal(left, right, err_msg=field.name)


@pytest.mark.parametrize("name", ["completed", "rough_day", "lossy", "taken_over", "room"])
def test_a_flight_is_the_same_as_read_record_by_record(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = unpack(name, tmp_path)
    spanned = [type(item) for item in tlog.read_tlog(path).spans()]
    assert spanned.count(Span) > 3
    assert len(spanned) < 2_000  # of tens of thousands
    quick, motions = load_flight(path), load_motions(path, 0.1)
    _one_by_one(monkeypatch)
    _same(quick, load_flight(path))
    for mine, theirs in zip(motions, load_motions(path, 0.1), strict=True):
        np.testing.assert_array_equal(mine.asked_enu_m_s, theirs.asked_enu_m_s)
        np.testing.assert_array_equal(mine.done_enu_m_s, theirs.done_enu_m_s)


def _frame(sysid: int, compid: int = 1) -> bytes:
    return Encoder(sysid, compid).encode("SYS_STATUS", voltage_battery=11_000 + sysid)


def _strange_log(path: Path, *, by_link: bool) -> None:
    """Two links, frames under our own ids, noise and damage, among hundreds of plain records."""
    with TlogWriter(path, 1_600_000_000_000_000, by_link=by_link) as log:
        for k in range(400):
            t_ns = k * 20_000_000
            log.received(0, "a:1", _frame(1), t_ns)
            log.received(1, "b:1" if k % 50 else "b:2", _frame(1 if by_link else 2), t_ns)
            if k % 97 == 0:
                log.received(1, "c:3", _frame(255, 190), t_ns)
                log.received(1, "c:3", b"noise", t_ns)
                log.event(f"info: {k}", t_ns)
            log.tick(t_ns, k)
            log.sent(Encoder(255, 190).encode("SET_POSITION_TARGET_LOCAL_NED", vx=0.5, target_system=k % 3), t_ns)


def _told(items: list[Record | Span]) -> tuple[list[tuple[object, ...]], list[tuple[object, ...]], int, list[Record]]:
    """Received frames, sent ones, ticks, and the rest."""
    came: list[tuple[object, ...]] = []
    went: list[tuple[object, ...]] = []
    ticks, rest = 0, list[Record]()
    for item in items:
        match item:
            case Span():
                ticks += item.ticks
                for link, peer, pieces, t_ns in item.received.pieces():
                    came += [(t_ns, link, peer, piece.raw) for piece in pieces if not isinstance(piece, bytes)]
                times = item.sent.datagrams.t_rx_ns[item.sent.datagram]
                for t_ns, link, start, stop in zip(
                    times.tolist(), item.sent_link.tolist(), item.sent.start, item.sent.stop, strict=True
                ):
                    went.append((t_ns, None if link < 0 else link, item.sent.data[start:stop]))
            case Received(t_ns, link, peer, frame):
                came.append((t_ns, link, peer, frame.raw))
            case Sent(t_ns, frame, at):
                went.append((t_ns, at, frame.raw))
            case Tick():
                ticks += 1
            case _:
                rest.append(item)
    return came, went, ticks, rest


@pytest.mark.parametrize("by_link", [False, True])
@pytest.mark.parametrize("damage", [None, 3_000, 40_000])
@pytest.mark.parametrize("records", [100, spans._RECORDS])
def test_whatever_is_strange_is_read_with_care(
    by_link: bool, damage: int | None, records: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "strange.tlog"
    _strange_log(path, by_link=by_link)
    content = bytearray(path.read_bytes())
    if damage is not None:
        content[damage : damage + 30] = bytes(30)
    reader = TlogReader(bytes(content[:-5]))
    monkeypatch.setattr(spans, "_RECORDS", records)
    quick = _told(list(reader.spans()))
    left_out = reader.damaged_bytes, reader.truncated_bytes
    assert quick == _told(list(reader))
    assert left_out == (reader.damaged_bytes, reader.truncated_bytes)
    assert (left_out[0] > 0, left_out[1] > 0) == (damage is not None, True)
    assert {link for _, link, _, _ in quick[0]} == {0, 1}


def test_a_large_log_is_mapped_and_reads_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = unpack("completed", tmp_path)
    small = load_flight(path)
    monkeypatch.setattr(tlog, "_MAPPED_MIN", 1)
    _same(small, load_flight(path))
