"""Teams whose vehicles, sensors and graphs are worse than the law's assumptions, flown through the whole chain."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.campaign.cases import Case, Cases
from groundstation.app.campaign.run import fly_case
from groundstation.app.campaign.vary import load_vary
from groundstation.app.resources import packaged_configs
from groundstation.app.serving import SitlOptions, open_server
from groundstation.core.errors import UserError

CUBE8 = packaged_configs() / "missions" / "cube8.yaml"
FOUR = """
verify: true
set:
  rate_hz: 25
  formation: ../formations/tetrahedron4.yaml
  gains: ../gains/tetrahedron4.npz
  avoidance.radius_m: 0.5
  avoidance.activation_m: 0.6
  position_error_m: 0.02
  link_delay_s: 0.1
  steps.1.hold.seconds: 1
  steps.0.form: {tolerance_m: 0.1, timeout_s: 20}
starts: {kind: planar}
limit_s: 90
"""
EMULATOR = "emulator: {noise: {position_m: 0.02}, link: {delay_s: 0.05, loss: 0.02}, own_frames: {%s}}\n"


UNREAD = ("verify: true", "verify: false")
"""To read a log again costs as much as to fly it: once for each kind of trouble is enough."""


def _case(folder: Path, text: str, run: int = 0) -> Case:
    path = folder / "vary.yaml"
    path.write_text(text, encoding="utf-8")
    return Cases(CUBE8, load_vary(path), 3).case(run)


@pytest.mark.parametrize(
    ("frames", "read"), [("heading_deg: 25, level_deg: 2", True), ("heading_deg: 25, alike: true", False)]
)
def test_a_team_with_wrong_north_and_level_forms(frames: str, *, read: bool, tmp_path: Path) -> None:
    row = fly_case(_case(tmp_path, (FOUR if read else FOUR.replace(*UNREAD)) + EMULATOR % frames))
    assert (row["success"], row["error"], row["log_mismatches"]) == (True, "", 0 if read else -1), row["reason"]


def test_a_team_beyond_the_bound_does_not_form_and_says_so(tmp_path: Path) -> None:
    row = fly_case(_case(tmp_path, FOUR.replace(*UNREAD) + EMULATOR % "heading_deg: 80, alike: true"))
    assert not row["formed"]
    assert row["error"] == ""
    assert "limit 45: its heading is off" in row["reason"], row["reason"]


def _sensed(sensing: str) -> str:
    link = "emulator: {noise: {position_m: 0.02}, link: {delay_s: 0.05, loss: 0.02}}\n"
    return FOUR.replace("starts:", f"  sensing: {{{sensing}}}\nstarts:") + link


@pytest.mark.parametrize("more", ["share: either", "share: own, memory_s: 0.5"])
def test_a_team_forms_with_poor_sensors_and_its_log_is_flown_again_to_the_same_bytes(tmp_path: Path, more: str) -> None:
    limited = "range_m: 6, field_of_view_deg: 340, loss: 0.3, noise_m: 0.03, heading_deg: 10, level_deg: 2, "
    row = fly_case(_case(tmp_path, _sensed(limited + more)))
    assert (row["success"], row["error"], row["log_mismatches"], row["log_complete"]) == (True, "", 0, True), row


@pytest.mark.parametrize("unseen", ["wait", "leave_out"])
def test_a_team_that_senses_nobody_does_not_form_says_so_and_keeps_r(tmp_path: Path, unseen: str) -> None:
    read = unseen == "wait"
    text = _sensed(f"range_m: 0.2, unseen: {unseen}").replace("timeout_s: 20", "timeout_s: 10")
    row = fly_case(_case(tmp_path, text if read else text.replace(*UNREAD)))
    assert not row["formed"]
    assert row["safe"]
    assert row["min_distance_m"] >= row["safety_radius_m"]
    assert row["told"]
    assert row["log_mismatches"] == (0 if read else -1)
    assert "not formed" in row["reason"]


def _served(heading_deg: float, level_deg: float) -> SitlOptions:
    return SitlOptions(
        3, "px4", 0, 1, None, False, False, None, "none", "quiet", True, 1.0, 0.0, 0.0, False, heading_deg, level_deg,
        1.0, None, 2, False, None,
    )  # fmt: skip


def test_the_emulator_on_sockets_has_wrong_frames_too_and_refuses_angles_that_are_none() -> None:
    with open_server(replace(_served(20.0, 3.0), port=14999)) as server:
        own = server.world.state.own_frames
        assert own is not None
        assert np.degrees(np.abs(own.heading_rad)) == pytest.approx([20.0] * 3)
    with pytest.raises(UserError, match=r"--level-error: 181.0 is out of range, limits 0.0 and 180.0"):
        open_server(_served(0.0, 181.0))
