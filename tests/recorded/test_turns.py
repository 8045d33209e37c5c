"""When real vehicles return after their ground station is gone, against the turns that the plan gives them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.mavlink.autopilots import AUTOPILOTS
from groundstation.mission.ground.failsafe import make_failsafe
from groundstation.records.notes import Sent
from tests.app.flights import mission
from tests.recorded.recording import REAL, load

_CLIMBS_M_S = 0.5


def test_px4_leaves_within_a_second_of_its_turn(tmp_path: Path) -> None:
    folder = REAL / "px4_cube8_killed_in_hold"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here; recordings of this size are no part of the repository")
    recording = load(folder, tmp_path)
    gone_ns = max(record.t_ns for record in recording.records if isinstance(record, Sent))
    failsafe = make_failsafe(recording.plan)
    failsafes = AUTOPILOTS["px4"].failsafes
    for vehicle, wish in enumerate(failsafe.wishes):
        t_ns, vel = recording.truth.t_ns[vehicle], recording.truth.vel_ned_m_s[vehicle]
        left = np.flatnonzero((t_ns > gone_ns + 5_000_000_000) & (vel[:, 2] < -_CLIMBS_M_S))[0]
        late_s = (int(t_ns[left]) - gone_ns) / 1e9 - wish.after_s
        settings = failsafes.settings(wish)
        waits_s = settings["COM_DL_LOSS_T"] + settings["COM_FAIL_ACT_T"]
        assert 0.0 <= waits_s + late_s - wish.after_s < 1.0  # and ArduCopter leaves up to 0.4 s before its turn


@pytest.mark.parametrize("after_s", [10.0, 12.0, 20.0, 48.0])
def test_what_px4_is_late_by_is_taken_off_and_its_parameters_stay_within_their_limits(after_s: float) -> None:
    wish = replace(make_failsafe(mission("px4_cube8")).wishes[0], after_s=after_s)
    settings = AUTOPILOTS["px4"].failsafes.settings(wish)
    assert settings["COM_DL_LOSS_T"] + settings["COM_FAIL_ACT_T"] + 3.0 == after_s
    assert settings["COM_DL_LOSS_T"] >= 5.0
    assert 0.0 <= settings["COM_FAIL_ACT_T"] <= 25.0
