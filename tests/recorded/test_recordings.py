"""Real firmware, recorded: what our program believes of it, against the simulators' own truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.recorded.judging import held_back, judge
from tests.recorded.recording import OURS, REAL, listen, load

QUIET = (0.35, 0.12)  # largest error of position (m) and of velocity (m/s), root mean square of any axis
SHAKEN = (0.35, 0.35)  # PX4's own simulator shakes its sensors: velocities are off, positions hardly


def test_a_shaken_velocity_is_measured_as_it_was_and_no_position_is_blamed(tmp_path: Path) -> None:
    folder = REAL / "px4_cube8_stock_aborted"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here; recordings of this size are no part of the repository")
    whole = load(folder, tmp_path)
    # The program of that day blamed a position at 41.6 s and another one at 45.4 s.
    recording = replace(whole, records=tuple(item for item in whole.records if item.t_ns < 50 * 10**9))
    belief = listen(recording)
    assert len([text for _, text in belief.alarms if "its velocity is poor" in text]) == 8
    assert len(belief.alarms) == 8
    for item in judge(recording, belief):
        true_m_s = float(np.linalg.norm(item.vel_rms_m_s))
        assert 0.6 < item.told_rms_m_s / true_m_s < 1.1, item
        assert np.linalg.norm(item.steady_rms_m_s) < 0.75 * true_m_s, item


@pytest.mark.parametrize(
    ("folder", "bounds"),
    [
        (OURS / "px4_first_flight2_from_power_up", SHAKEN),
        (REAL / "px4_first_flight2", SHAKEN),
        (REAL / "px4_cube8_killed_in_form_taken_over", QUIET),
        (REAL / "arducopter_two_squares8", QUIET),
    ],
    ids=lambda value: value.name if isinstance(value, Path) else "",
)
def test_real_firmware_is_believed_as_it_was(folder: Path, bounds: tuple[float, float], tmp_path: Path) -> None:
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here; recordings of this size are no part of the repository")
    recording = load(folder, tmp_path)
    belief = listen(recording)
    assert len(belief.t_ns) > 500  # else it proves nothing
    assert held_back(belief) == []  # the real autopilots agreed to be armed a moment later
    assert belief.alarms == []
    assert not belief.restarts.any()
    assert belief.clock_known.all()
    for item in judge(recording, belief):
        assert item.flew
        assert item.unarmed_in_air == 0
        assert item.landed_in_air == 0
        assert item.pos_rms_m.max() < bounds[0], item
        assert item.vel_rms_m_s.max() < bounds[1], item
        assert 0.0 <= item.aloft_early_s < 5.0  # told by thrust, before the ground is left
        assert np.isnan(item.landed_late_s) or 0.0 <= item.landed_late_s < 6.0
        assert item.ready_before_arming_s >= 1.0
