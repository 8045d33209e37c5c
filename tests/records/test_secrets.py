"""The key in SETUP_SIGNING reaches no log, in neither direction, whole or damaged, in one piece or many."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter
from groundstation.mavlink.signing import SecretKey, Signing
from groundstation.records.notes import Noise, Received, Refused, Sent
from groundstation.records.tlog import TlogReader, TlogWriter

KEY = bytes(range(200, 232))
EPOCH_US = 1_577_836_800_000_000
SETUP = Encoder(255, 190).encode("SETUP_SIGNING", target_system=1, target_component=1, secret_key=list(KEY))
SIGNED = Signing(SecretKey(bytes(32))).sign(SETUP, 0, 1000)
OURS = Encoder(255, 190).encode("HEARTBEAT", type=6)
HEARTBEAT = Encoder(1).encode("HEARTBEAT", type=2)


def _shows_key(content: bytes) -> bool:
    return any(KEY[k : k + 4] in content for k in range(len(KEY) - 3))


@pytest.mark.parametrize("setup", [SETUP, SIGNED], ids=["plain", "signed"])
def test_whole_ones_are_left_out_sent_received_and_refused(tmp_path: Path, setup: bytes) -> None:
    path = tmp_path / "a.tlog"
    (frame,) = FrameSplitter().feed(setup)
    assert isinstance(frame, Frame)
    with TlogWriter(path, EPOCH_US) as log:
        log.sent(setup, 1000)
        for link in (0, 1):
            log.received(link, "p", HEARTBEAT + setup + HEARTBEAT, 2000)
        log.refused(0, "p", frame, 1, 3000)
        log.sent(OURS, 4000)
    assert not _shows_key(path.read_bytes())
    kinds = [type(record) for record in TlogReader(path.read_bytes())]
    assert kinds == [Received] * 4 + [Sent]


@given(
    setup=st.sampled_from([SETUP, SIGNED]),
    bad=st.integers(10, len(SETUP) - 1),
    cuts=st.lists(st.integers(1, len(SETUP)), max_size=4),
    stream=st.booleans(),
)
def test_damaged_ones_in_pieces_show_nothing_of_the_key(setup: bytes, bad: int, cuts: list[int], stream: bool) -> None:
    damaged = bytearray(setup)
    damaged[bad] ^= 0x55
    file = io.BytesIO()
    log, splitter = TlogWriter(file, EPOCH_US), FrameSplitter(datagrams=not stream)
    data, start = b"xx" + bytes(damaged) + b"rest", 0
    for stop in [*sorted(cuts), len(data)]:
        log.took(0, "p", splitter.feed(data[start:stop]), 1000)
        start = max(start, stop)
    log.took(0, "p", splitter.feed(bytes(300)), 2000)  # what a stream still holds
    log._flush()
    content = file.getvalue()
    assert not _shows_key(content)
    noise = sum(len(record.data) for record in TlogReader(content) if isinstance(record, Noise))
    assert noise == len(data) + 300


def test_what_other_programs_wrote_is_not_handed_on() -> None:
    stamp = EPOCH_US.to_bytes(8, "big")
    records = list(TlogReader(stamp + HEARTBEAT + stamp + SIGNED + stamp + HEARTBEAT))
    assert [type(record) for record in records] == [Received, Received]


def test_refused_frames_come_back_with_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "a.tlog"
    big = Encoder(7).encode("FILE_TRANSFER_PROTOCOL", payload=bytes(range(1, 252)))
    frames = [piece for piece in FrameSplitter().feed(HEARTBEAT + big) if isinstance(piece, Frame)]
    with TlogWriter(path, EPOCH_US) as log:
        for why, frame in enumerate(frames, start=1):
            log.refused(why, f"peer {why}", frame, why, 5000)
    assert list(TlogReader(path.read_bytes())) == [
        Refused(5000, 1, "peer 1", 1, HEARTBEAT),
        Refused(5000, 2, "peer 2", 2, big),
    ]
