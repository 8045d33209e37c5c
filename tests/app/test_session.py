"""Every byte that a link brings is split into frames once, and the log and the mission get the same ones."""

from __future__ import annotations

import io

import pytest

from groundstation.app.session import Session
from groundstation.mavlink.codec import Encoder, FrameSplitter
from groundstation.mission.runner import Runner
from groundstation.records.notes import Noise, Received
from groundstation.records.tlog import TlogReader, TlogWriter
from tests.app.flights import pair

HELLO = Encoder(1).encode("HEARTBEAT", type=2, autopilot=12, system_status=3, mavlink_version=3)


def _session(*changes: str) -> tuple[Session, io.BytesIO]:
    file = io.BytesIO()
    return Session(Runner(pair(*changes), 0), TlogWriter(file, 0)), file


def _log(session: Session, file: io.BytesIO) -> list[Received | Noise]:
    assert session._log is not None
    session._log.flush()
    return [record for record in TlogReader(file.getvalue()) if isinstance(record, Received | Noise)]


def test_every_byte_is_split_once(monkeypatch: pytest.MonkeyPatch) -> None:
    split = 0
    feed = FrameSplitter.feed

    def counted(self: FrameSplitter, data: bytes) -> object:
        nonlocal split
        split += len(data)
        return feed(self, data)

    session, file = _session()
    monkeypatch.setattr(FrameSplitter, "feed", counted)
    noise = b"what is this"
    for k in range(5):
        session.deliver(0, "10.0.0.1:1", HELLO + noise, 1_000_000 + k)
    session.tick(20_000_000)
    monkeypatch.undo()
    assert split <= 5 * len(HELLO + noise)
    assert session.runner.fleet.peer[0] == "10.0.0.1:1"
    assert session.runner.fleet.counts["bytes that were no frame"] == 5 * len(noise)
    assert [type(record) for record in _log(session, file)] == [Received, Noise] * 5


@pytest.mark.parametrize(("url", "whole"), [("tcpin://127.0.0.1:14540", True), ("udpin://127.0.0.1:14540", False)])
def test_a_frame_in_two_pieces_is_one_on_a_stream_and_noise_on_datagrams(url: str, *, whole: bool) -> None:
    session, file = _session(f"vehicles.0.link={url}", f"vehicles.1.link={url}")
    session.deliver(0, "p", HELLO[:7], 0)
    session.deliver(0, "p", HELLO[7:], 1_000)
    session.tick(20_000_000)
    assert (session.runner.fleet.peer[0] == "p") == whole
    assert [type(record) for record in _log(session, file)] == ([Received] if whole else [Noise, Noise])


@pytest.mark.parametrize("url", ["tcpin://127.0.0.1:14540", "udpin://127.0.0.1:14540"])
def test_a_flood_of_addresses_takes_no_memory_and_does_not_keep_a_vehicle_from_being_heard(url: str) -> None:
    session, _ = _session(f"vehicles.0.link={url}", f"vehicles.1.link={url}")
    for number in range(1500):
        session.deliver(0, f"stranger{number}", b"\xfd", 0)
    assert len(session._splitters._streams) <= 256
    session.deliver(0, "p1", HELLO, 0)
    session.tick(20_000_000)
    assert session.runner.fleet.peer[0] == "p1"
