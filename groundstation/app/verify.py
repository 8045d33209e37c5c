"""Feeds a recorded flight through the same object that flew it and compares every setpoint, to the bit.

What is compared is every frame that was sent, byte by byte, tick by tick: setpoints, commands, answers and heartbeats;
on a difference between setpoints the velocities in them too. A flight that was refused has no setpoints and is compared
all the same. A log without a single tick proves nothing and is refused.

Linear algebra is rounded otherwise on another processor (OpenBLAS has a kernel for each), by parts in 1e16. In a few
frames, mostly where something is nearly zero, that reaches the 32 bits that are sent. These are counted apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.app.again import Again, mission_of
from groundstation.core.errors import CheckFailed
from groundstation.mavlink.codec import Frame, FrameSplitter, decode, flagged, message_id
from groundstation.mission.plan.own_code import CodeSource
from groundstation.mission.plan.reading import plan_from_record
from groundstation.records.notes import Sent
from groundstation.records.tlog import read_tlog

_SETPOINT = message_id("SET_POSITION_TARGET_LOCAL_NED")
_RELATIVE = 2.0**-22  # two of the last places of a float of 32 bits
_ABSOLUTE = 1e-9  # m, m/s, rad: where sums cancel, what is left of rounding is not small against the result


@dataclass
class VerifyResult:
    """How a replay compares with its flight.

    Attributes:
        ticks: steps made again.
        frames: sent frames of any type compared.
        setpoints: setpoints among them.
        rounded: frames that differ in the last bits of their floats alone; 0 on the processor that flew.
        mismatches: frames of any type that differ in anything else, are missing or are too many.
        max_error_m_s: largest difference of a velocity component among setpoints that differ.
        complete: the log reaches to the end of the flight, as its manifest tells it.
    """

    ticks: int = 0
    frames: int = 0
    setpoints: int = 0
    rounded: int = 0
    mismatches: int = 0
    max_error_m_s: float = 0.0
    complete: bool = True


def verify_log(path: Path, code: CodeSource | None = None) -> VerifyResult:
    """Replays a log through a new runner.

    Args:
        path: a log that this program recorded, with its manifest beside it.
        code: where a law or avoidance that is not ours is looked for.

    Returns:
        The comparison; ``mismatches`` is 0 when the flight is reproduced.

    Raises:
        UserError: no manifest or no gains in it, or a log of another kind.
        CheckFailed: there is nothing in it to verify.
    """
    manifest, gains_npz = mission_of(path)
    plan = plan_from_record(manifest.mission, gains_npz, f"manifest of {path}", code)
    reader = read_tlog(path, manifest.epoch_unix_us)
    result = VerifyResult()
    again = Again(plan, take_over=manifest.take_over)
    expected: list[bytes] = []
    recorded: list[Frame] = []
    for record in reader:
        outgoing = again.take(record)
        if outgoing is not None:
            compare_frames(expected, recorded, result)
            recorded = []
            expected = [frame for datagram in outgoing for frame in datagram.frames]
            result.ticks += 1
        elif isinstance(record, Sent):
            recorded.append(record.frame)
    ended = manifest.result or {}
    result.complete = reader.truncated_bytes == 0 and result.ticks >= int(ended.get("ticks") or 0)
    if result.complete and ended:
        compare_frames(expected, recorded, result)
    if result.ticks == 0:
        raise CheckFailed(f"{path}: no tick in it; there is nothing to verify")
    return result


def compare_frames(expected: list[bytes], recorded: list[Frame], result: VerifyResult) -> None:
    """Compares what a tick sends with what it sent, in order, and counts it.

    Args:
        expected: frames made again, unsigned.
        recorded: frames of the log, perhaps signed.
        result: is added to.
    """
    result.frames += len(recorded)
    result.setpoints += sum(frame.msgid == _SETPOINT for frame in recorded)
    result.mismatches += abs(len(expected) - len(recorded))
    splitter = FrameSplitter()
    for raw, theirs in zip(expected, recorded, strict=False):
        if raw == flagged(theirs.raw, signed=False):  # whoever flies it again needs no key
            continue
        (mine,) = splitter.feed(raw)
        if not isinstance(mine, Frame) or _head(mine) != _head(theirs):
            result.mismatches += 1
            continue
        rows = decode([mine, theirs])[0].values
        if all(_same(rows[name]) for name in rows.dtype.names or ()):
            result.rounded += 1
            continue
        result.mismatches += 1
        if mine.msgid == _SETPOINT:
            velocity = np.stack([rows["vx"], rows["vy"], rows["vz"]]).astype(np.float64)
            result.max_error_m_s = max(result.max_error_m_s, float(np.abs(np.diff(velocity, axis=1)).max()))


def _head(frame: Frame) -> tuple[int, int, int, int, int]:
    return frame.version, frame.msgid, frame.sysid, frame.compid, frame.seq


def _same(pair: NDArray[np.generic]) -> bool:
    """Whether one field of two frames, shape (2, ...), is the same; floats but for rounding."""
    if np.issubdtype(pair.dtype, np.floating):
        return bool(np.allclose(pair[0], pair[1], rtol=_RELATIVE, atol=_ABSOLUTE, equal_nan=True))
    return bool(np.all(pair[0] == pair[1]))
