"""The paper's pure law, from the mission file: it flies as the paper says, and on vehicles only when asked for."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from groundstation.mission.monitors.findings import Finding, Reaction, Sight
from groundstation.mission.monitors.flight import Distance
from groundstation.mission.plan.reading import load_mission
from tests.app.commands import gs
from tests.app.flights import HALF_RATE, SECOND_NS, Flight

PAPER = packaged_configs() / "missions" / "paper_cube8.yaml"


def test_it_has_the_numbers_of_section_viii() -> None:
    plan = load_mission(PAPER)
    spec = plan.spec
    assert (spec.avoidance.radius_m, spec.avoidance.activation_m, spec.takeoff.height_m) == (0.45, 0.5, 0.5)
    assert (plan.scale.kind, plan.scale.gain, plan.control_gain) == ("arctan", 2.5, 1.0)
    assert (plan.lead_s, plan.upright_1_s, plan.keep_place_1_s) == (0.0, 0.0, 0.0)
    assert (spec.avoidance.turns, spec.avoidance.damps, spec.avoidance.detours) == (True, False, False)
    assert plan.keep_out_margin_m < 0.001
    xy, z = plan.gains.xy.copy(), plan.gains.z.copy()
    np.fill_diagonal(xy, 0.0)
    np.fill_diagonal(z, 0.0)
    modes = np.concatenate([np.linalg.eigvalsh(block - np.diag(block.sum(axis=1))) for block in (xy, z)])
    moving = modes[np.abs(modes) > 1e-6]
    assert (moving.min(), moving.max()) == pytest.approx((-10.0, -5.0), abs=1e-3)


def test_it_forms_and_comes_nearer_than_r_which_is_told_and_flown_again_to_the_bit(tmp_path: Path) -> None:
    log = tmp_path / "paper.tlog"
    flight = Flight(load_mission(PAPER, [HALF_RATE, "steps.1.hold.seconds=1"]), log=log)
    assert flight.runner.outcome == "completed"
    figures = flight.runner.figures
    assert (figures.detours, figures.role_swaps) == (0, 0)
    assert 0.225 < flight.meter.figures()["min_distance_m"] < 0.43  # of the same team with the damper it is more than r
    assert any("minimum is 0.45 m" in note.text for note in flight.notes)
    verified = verify_log(log)
    assert (verified.mismatches, verified.complete) == (0, True)


@pytest.mark.parametrize(("apart_m", "reaction"), [(0.3, Reaction.SAY), (0.2, Reaction.ALL_HOME)])
def test_nearer_than_r_is_told_and_half_of_r_brings_everybody_back(apart_m: float, reaction: Reaction) -> None:
    plan = load_mission(PAPER)
    everybody = np.ones(8, dtype=np.bool_)
    places = np.arange(8.0)[:, None] * np.array([1.0, 0.0, 0.0])
    places[1, 0] = apart_m
    monitor = Distance(plan)
    found: list[Finding] = []
    for tick in range(30):
        now_ns = tick * SECOND_NS // 50
        sight = SimpleNamespace(
            pos_team_ned_m=places, blind=~everybody, now_ns=now_ns, pose_ns=np.full(8, now_ns), airborne=everybody
        )
        found += monitor.look(cast(Sight, sight), everybody)
    assert [(item.reaction, item.vehicles) for item in found] == [(reaction, (0, 1))]


def test_vehicles_fly_it_only_when_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(tmp_path / "never.tlog")
    code, _, said = gs(["fly", "--mission", "paper_cube8", "--log", log], monkeypatch, capsys)
    assert code == 2
    assert "avoidance.method: rotation is for dry runs, allowed for vehicles is both" in said
    assert "--incomplete-avoidance" in said
    assert not list(tmp_path.iterdir())


def test_a_law_in_place_of_what_is_left_out_is_refused() -> None:
    with pytest.raises(UserError, match="law stands in for Algorithm 2, which method: damper leaves out"):
        load_mission(PAPER, ["avoidance.method=damper", "avoidance.law=my_law:Turn"])
