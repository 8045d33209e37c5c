"""Which differences between a flight and its replay are another processor's rounding, and which are not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.verify import VerifyResult, compare_frames
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter
from tests.reference import unpack

SETPOINT = {
    "time_boot_ms": 5, "target_system": 1, "target_component": 1, "coordinate_frame": 1, "type_mask": 0,
    "x": 0.0, "y": 0.0, "z": 0.0, "vx": 0.7, "vy": 1e-17, "vz": -0.25, "afx": 0.0, "afy": 0.0, "afz": 0.0,
    "yaw": float("nan"), "yaw_rate": 0.0,
}  # fmt: skip


def compared(made: dict[str, float], recorded: dict[str, float]) -> VerifyResult:
    result = VerifyResult()
    mine = Encoder(255).encode("SET_POSITION_TARGET_LOCAL_NED", **made)
    (theirs,) = FrameSplitter().feed(Encoder(255).encode("SET_POSITION_TARGET_LOCAL_NED", **recorded))
    assert isinstance(theirs, Frame)
    compare_frames([mine], [theirs], result)
    return result


@pytest.mark.parametrize(
    "changes", [{"vy": -3e-18}, {"vx": float(np.nextafter(np.float32(0.7), np.float32(1)))}, {"vy": 0.0, "vz": -0.25}]
)
def test_the_last_place_of_a_float_is_rounding(changes: dict[str, float]) -> None:
    result = compared(SETPOINT | changes, SETPOINT)
    assert (result.frames, result.rounded, result.mismatches, result.max_error_m_s) == (1, 1, 0, 0.0)


@pytest.mark.parametrize(
    ("changes", "error_m_s"),
    [
        ({"vx": 0.700001}, 1e-6),
        ({"vy": 2e-9}, 2e-9),
        ({"vx": -0.7}, 1.4),
        ({"type_mask": 7}, 0.0),
        ({"target_system": 2}, 0.0),
        ({"time_boot_ms": 6}, 0.0),
        ({"yaw": 0.0}, 0.0),
    ],
)
def test_anything_more_is_a_mismatch(changes: dict[str, float], error_m_s: float) -> None:
    result = compared(SETPOINT | changes, SETPOINT)
    assert (result.frames, result.rounded, result.mismatches) == (1, 0, 1)
    assert result.max_error_m_s == pytest.approx(error_m_s, rel=0.1)


def test_the_same_bytes_are_neither_and_a_frame_too_many_or_of_another_place_is_a_mismatch() -> None:
    same = compared(SETPOINT, SETPOINT)
    assert (same.rounded, same.mismatches) == (0, 0)
    encoder, result = Encoder(255), VerifyResult()
    first, second = (encoder.encode("SET_POSITION_TARGET_LOCAL_NED", **SETPOINT) for _ in range(2))
    (recorded,) = FrameSplitter().feed(second)
    assert isinstance(recorded, Frame)
    compare_frames([first], [recorded], result)
    assert (result.rounded, result.mismatches) == (0, 1)
    compare_frames([first, second], [recorded], result)
    assert result.mismatches == 3


@pytest.mark.parametrize("kernel", ["Prescott", "Haswell"])
def test_a_log_of_another_processor_is_found_again(kernel: str, tmp_path: Path) -> None:
    """Older kernels of OpenBLAS stand for processors that this one is not; elsewhere the variable changes nothing."""
    run = subprocess.run(
        [sys.executable, "-m", "groundstation", "replay", str(unpack("goes_on", tmp_path)), "--verify", "--json"],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OPENBLAS_CORETYPE": kernel},
    )
    values = json.loads(run.stdout.splitlines()[-1])
    assert (run.returncode, values["mismatches"], values["complete"]) == (0, 0, True), run.stderr
    assert values["rounded"] < 20
