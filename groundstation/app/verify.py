"""Feeds a recorded flight through the same object that flew it and compares every setpoint, to the bit.

What is compared is each SET_POSITION_TARGET_LOCAL_NED frame of each tick, byte by byte, and on a difference the
velocities in it. A log in which nothing was sent proves nothing and is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.core.errors import MissionFailed, UserError
from groundstation.mavlink.codec import Frame, FrameSplitter, decode, message_id
from groundstation.mission.plan import plan_from_record
from groundstation.mission.runner import Runner
from groundstation.records.manifest import manifest_beside
from groundstation.records.notes import Noise, Operator, Received, Sent, Tick
from groundstation.records.tlog import read_tlog

_SETPOINT = message_id("SET_POSITION_TARGET_LOCAL_NED")


@dataclass
class VerifyResult:
    """How a replay compares with its flight.

    Attributes:
        ticks: steps made again.
        setpoints: setpoints compared.
        mismatches: setpoints that differ in any bit, are missing or are too many.
        max_error_m_s: largest difference of a velocity component among those that differ.
    """

    ticks: int = 0
    setpoints: int = 0
    mismatches: int = 0
    max_error_m_s: float = 0.0


def verify_log(path: Path) -> VerifyResult:
    """Replays a log through a new runner.

    Args:
        path: a log that this program recorded, with its manifest beside it.

    Returns:
        The comparison; ``mismatches`` is 0 when the flight is reproduced.

    Raises:
        UserError: no manifest or no gains in it, or a log of another kind.
        MissionFailed: there is nothing in it to verify.
    """
    manifest = manifest_beside(path)
    if manifest is None or manifest.gains_npz is None:
        raise UserError(
            f"{path}: no manifest with a mission and gains beside it; only logs of `gs fly` can be verified,"
            " keep the .manifest.json together with the .tlog"
        )
    plan = plan_from_record(manifest.mission, manifest.gains_npz, f"manifest of {path}")
    reader = read_tlog(path, manifest.epoch_unix_us)
    result = VerifyResult()
    runner = Runner(plan, start_ns=0, whole_frames=True)
    expected: list[Frame] = []
    recorded: list[Frame] = []
    for record in reader:
        if isinstance(record, Tick):
            _compare(expected, recorded, result)
            recorded = []
            outgoing = runner.step(record.t_ns)
            expected = _setpoints([frame for datagram in outgoing for frame in datagram.frames])
            result.ticks += 1
        elif isinstance(record, Sent):
            if record.frame.msgid == _SETPOINT:
                recorded.append(record.frame)
        elif isinstance(record, Received):
            runner.receive(record.link, record.peer, record.frame.raw, record.t_ns)
        elif isinstance(record, Noise):
            runner.receive(record.link, record.peer, record.data, record.t_ns)
        elif isinstance(record, Operator):
            runner.operator(record.text)
    if reader.truncated_bytes == 0 and manifest.result is not None:
        _compare(expected, recorded, result)
    if result.setpoints == 0:
        raise MissionFailed(f"{path}: no setpoint in {result.ticks} ticks; there is nothing to verify")
    return result


def _setpoints(frames: Sequence[bytes]) -> list[Frame]:
    splitter = FrameSplitter()
    pieces = [piece for raw in frames for piece in splitter.feed(raw)]
    return [piece for piece in pieces if isinstance(piece, Frame) and piece.msgid == _SETPOINT]


def _compare(expected: list[Frame], recorded: list[Frame], result: VerifyResult) -> None:
    result.setpoints += len(recorded)
    result.mismatches += abs(len(expected) - len(recorded))
    for mine, theirs in zip(expected, recorded, strict=False):
        if mine.raw != theirs.raw:
            result.mismatches += 1
            (batch,) = decode([mine, theirs])
            velocity = np.stack([batch.values["vx"], batch.values["vy"], batch.values["vz"]]).astype(np.float64)
            result.max_error_m_s = max(result.max_error_m_s, float(np.abs(np.diff(velocity, axis=1)).max()))
