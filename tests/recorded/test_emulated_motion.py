"""The emulated ArduCopter moves as the real one did when it is told what the real one was told.

The recordings are of real firmware in its own simulator; what it did is its own report, which the recorded truth bears
out (``test_recordings``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.core.types import FloatArray
from groundstation.records.responses import load_motions
from sitl.personalities import PROFILES
from tests.recorded.recording import REAL, load
from tests.sitl.test_dynamics import STEP_S, flying

_GRID_S = 0.01
_SETTLED_S = 3.0
_ASKED_M_S = 0.08


def _flown(asked_enu_m_s: FloatArray) -> FloatArray:
    """Velocities of an emulated ArduCopter on the grid of what it is told, shape (t, 3)."""
    dynamics = flying("arducopter")
    times_s = np.arange(len(asked_enu_m_s)) * _GRID_S
    steps_s = np.arange(round(times_s[-1] / STEP_S)) * STEP_S
    out = np.empty((len(steps_s), 3))
    for k, now_s in enumerate(steps_s):
        dynamics.commands.vel_sp_enu_m_s[:, 0] = asked_enu_m_s[int(now_s / _GRID_S)]
        dynamics.step()
        out[k] = dynamics.motion.vel_enu_m_s[:, 0]
    return np.stack([np.interp(times_s, steps_s + STEP_S, column) for column in out.T], axis=1)


@pytest.mark.parametrize(("name", "ids"), [("arducopter_two_squares8", (1, 7)), ("mixed8", (7,))])
def test_told_the_same_it_does_the_same(name: str, ids: tuple[int, ...], tmp_path: Path) -> None:
    folder = REAL / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here; recordings of this size are no part of the repository")
    assert "arducopter" in PROFILES
    load(folder, tmp_path)
    (tmp_path / "flight.manifest.json").write_bytes((folder / "flight.manifest.json").read_bytes())
    motions = {motion.id: motion for motion in load_motions(tmp_path / "flight.tlog", _GRID_S)}
    for number in ids:
        asked, done = motions[number].asked_enu_m_s, motions[number].done_enu_m_s
        missed = done - _flown(asked)
        late = np.arange(len(missed)) >= round(_SETTLED_S / _GRID_S)
        known = np.isfinite(missed).all(axis=1) & late
        left = ((missed[known] - missed[known].mean(axis=0)) ** 2).sum(axis=0)
        moved = ((done[known] - done[known].mean(axis=0)) ** 2).sum(axis=0)
        assert asked[known].std(axis=0).max() > _ASKED_M_S  # else it was told nothing
        # Level and up. As two linear filters it missed 0.09 and 0.16 of the motion.
        assert left[:2].sum() < 0.015 * moved[:2].sum(), number
        assert left[2] < 0.015 * moved[2], number
