"""What setpoints of px4_quad are shaped by is how recorded PX4 answers: real firmware in its own simulator.

Its own report of velocity is compared with what scipy makes of the profile's response and the recorded setpoints.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from groundstation.core.compensation import AxisResponse
from groundstation.core.types import FloatArray
from groundstation.mission.plan.profiles import PROFILES
from groundstation.records.responses import load_motions
from tests.recorded.recording import REAL, load

_GRID_S = 0.02
_DELAYS_S = np.arange(0.06, 0.31, 0.02)


def _left(axis: AxisResponse | float, asked_m_s: FloatArray, done_m_s: FloatArray) -> float:
    """Share of the motion that an axis' response (a float: one lag) leaves unexplained, with the delay that fits."""
    if isinstance(axis, float):
        above, below = np.array([1.0]), np.array([axis, 1.0])
    else:
        above = np.array([axis.p_1_s, axis.i_1_s2])
        below = np.array([1.0, axis.p_1_s + axis.drag_1_s, axis.i_1_s2])
    system = signal.cont2discrete((above, below), _GRID_S)
    times_s = np.arange(len(asked_m_s)) * _GRID_S
    went = signal.lfilter(np.ravel(system[0]), np.ravel(system[1]), asked_m_s)
    known = np.isfinite(done_m_s)
    moved = done_m_s[known] - done_m_s[known].mean()
    found = []
    for delay_s in _DELAYS_S:
        off = (done_m_s - np.interp(times_s - delay_s, times_s, went, left=0.0))[known]
        found.append(float(((off - off.mean()) ** 2).sum() / (moved**2).sum()))
    return min(found)


@pytest.mark.parametrize("name", ["px4_cube8_quiet", "px4_cube8_killed_in_hold"])
def test_recorded_px4_answers_as_the_response_that_its_setpoints_are_shaped_by(name: str, tmp_path: Path) -> None:
    folder = REAL / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here; recordings of this size are no part of the repository")
    load(folder, tmp_path)
    (tmp_path / "flight.manifest.json").write_bytes((folder / "flight.manifest.json").read_bytes())
    response = PROFILES["px4_quad"].response
    assert response is not None
    level, plain, up = [], [], []
    for motion in load_motions(tmp_path / "flight.tlog", _GRID_S):
        for axis in (0, 1):
            asked, done = motion.asked_enu_m_s[:, axis], motion.done_enu_m_s[:, axis]
            if asked.std() > 0.2:
                level.append(_left(response.horizontal, asked, done))
                plain.append(_left(PROFILES["px4_quad"].lag_s, asked, done))
        asked, done = motion.asked_enu_m_s[:, 2], motion.done_enu_m_s[:, 2]
        if asked.std() > 0.2:
            up.append(_left(response.vertical, asked, done))
    # 0.6 to 2.0 % level (one lag: 5 to 12 %), 0.3 to 1.7 % up.
    assert len(level) >= 8
    assert max(level) < 0.03
    assert np.median(plain) > 4.0 * np.median(level)
    assert len(up) >= 8
    assert max(up) < 0.025
