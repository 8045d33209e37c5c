"""Plays the room of a recorded flight again: its frames, as they came, at the pace at which they came."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path

from groundstation.core.errors import CheckFailed
from groundstation.mavlink.mocap_frames import BODY_SYSID, ROOM_SYSIDS
from groundstation.records.manifest import manifest_beside
from groundstation.records.notes import Received
from groundstation.records.tlog import read_tlog


def recorded(log: Path) -> Iterator[tuple[int, bytes]]:
    """Arrival, ns, and bytes of every frame of a log's motion capture system.

    Raises:
        UserError: the log cannot be read.
    """
    manifest = manifest_beside(log)
    frames = (
        record
        for record in read_tlog(log, None if manifest is None else manifest.epoch_unix_us)
        if isinstance(record, Received) and record.frame.sysid in ROOM_SYSIDS
    )
    for t_ns, together in groupby(frames, lambda record: record.t_ns):
        yield t_ns, b"".join(record.frame.raw for record in together)


def play(log: Path, send: Callable[[bytes], None], pace: Callable[[int], None]) -> int:
    """Sends them; returns how many datagrams there were.

    Args:
        log: the .tlog file.
        send: takes a datagram.
        pace: waits until that many ns have passed since the first one.

    Raises:
        UserError: the log cannot be read.
        CheckFailed: there is no such frame in it.
    """
    count, first_ns = 0, 0
    for t_ns, data in recorded(log):
        first_ns = first_ns if count else t_ns
        pace(t_ns - first_ns)
        send(data)
        count += 1
    if not count:
        raise CheckFailed(f"{log}: no frame of a motion capture system in it (ATT_POS_MOCAP of system {BODY_SYSID})")
    return count
