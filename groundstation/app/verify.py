"""Feeds a recorded flight through the same object that flew it and compares every setpoint, to the bit.

What is compared is every frame that was sent, byte by byte, tick by tick: setpoints, commands, answers and heartbeats;
on a difference between setpoints the velocities in them too. A flight that was refused has no setpoints and is compared
all the same. A log without a single tick proves nothing and is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.app.again import Again, mission_of
from groundstation.core.errors import CheckFailed
from groundstation.mavlink.codec import Frame, FrameSplitter, decode, flagged, message_id
from groundstation.mission.plan.own_code import CodeSource
from groundstation.mission.plan.reading import plan_from_record
from groundstation.records.notes import Sent
from groundstation.records.tlog import read_tlog

_SETPOINT = message_id("SET_POSITION_TARGET_LOCAL_NED")


@dataclass
class VerifyResult:
    """How a replay compares with its flight.

    Attributes:
        ticks: steps made again.
        frames: sent frames of any type compared.
        setpoints: setpoints among them.
        mismatches: frames of any type that differ in any bit, are missing or are too many.
        max_error_m_s: largest difference of a velocity component among setpoints that differ.
        complete: the log reaches to the end of the flight, as its manifest tells it.
    """

    ticks: int = 0
    frames: int = 0
    setpoints: int = 0
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
            _compare(expected, recorded, result)
            recorded = []
            expected = [frame for datagram in outgoing for frame in datagram.frames]
            result.ticks += 1
        elif isinstance(record, Sent):
            recorded.append(record.frame)
    ended = manifest.result or {}
    result.complete = reader.truncated_bytes == 0 and result.ticks >= int(ended.get("ticks") or 0)
    if result.complete and ended:
        _compare(expected, recorded, result)
    if result.ticks == 0:
        raise CheckFailed(f"{path}: no tick in it; there is nothing to verify")
    return result


def _compare(expected: list[bytes], recorded: list[Frame], result: VerifyResult) -> None:
    result.frames += len(recorded)
    result.setpoints += sum(frame.msgid == _SETPOINT for frame in recorded)
    result.mismatches += abs(len(expected) - len(recorded))
    splitter = FrameSplitter()
    for raw, theirs in zip(expected, recorded, strict=False):
        if raw == flagged(theirs.raw, signed=False):  # whoever flies it again needs no key
            continue
        result.mismatches += 1
        (mine,) = splitter.feed(raw)
        if isinstance(mine, Frame) and mine.msgid == theirs.msgid == _SETPOINT:
            (batch,) = decode([mine, theirs])
            velocity = np.stack([batch.values["vx"], batch.values["vy"], batch.values["vz"]]).astype(np.float64)
            result.max_error_m_s = max(result.max_error_m_s, float(np.abs(np.diff(velocity, axis=1)).max()))
