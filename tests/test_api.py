"""``import groundstation as gs``: light, stable names, examples that run, and everything in it does what it says."""

from __future__ import annotations

import doctest
import subprocess
import sys
import threading
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import groundstation as gs
from groundstation import api
from groundstation.core.errors import UserError

_STABLE = {
    "Comparison", "DesignResult", "Flown", "Formation", "Gains", "Log", "Mission", "Seen", "Tick", "UserError",
    "VerifyResult", "compare", "design", "fly", "load_formation", "load_mission", "read_log", "report",
    "save_gains", "simulate", "verify",
}  # fmt: skip
"""Names that other people's programs use; one that is missing here breaks them."""


def test_importing_loads_nothing_and_every_name_is_there() -> None:
    code = "import groundstation as gs, sys; print('numpy' in sys.modules, 'yaml' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False False\n"
    assert set(gs.__all__) == set(api.__all__) >= _STABLE
    for name in gs.__all__:
        assert callable(getattr(gs, name)), name
        assert name in dir(gs)
        assert getattr(api, name).__doc__, name
    with pytest.raises(AttributeError, match="has no attribute 'simulat'"):
        gs.simulat  # noqa: B018


def test_design_can_be_called_whatever_was_imported_before() -> None:
    code = "import groundstation.design.designer, groundstation as gs; "
    code += "print(gs.design(gs.load_formation('pair2')).feasible)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"


def test_examples_in_docstrings_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(api)
    assert result.failed == 0
    assert result.attempted > 10


def test_a_flight_in_a_few_lines_with_a_look_at_every_tick(tmp_path: Path) -> None:
    ticks: list[gs.Tick] = []

    def look(tick: gs.Tick) -> str | None:
        ticks.append(tick)
        return "land all" if tick.phase == "form" and ticks[-2].phase == "form" else None

    mission = gs.load_mission("first_flight2", ["steps.1.hold.seconds=2"])
    flown = gs.simulate(mission, seed=3, on_tick=look, log=tmp_path / "a.tlog")
    assert (flown.outcome, flown.reason, flown.mission) == ("aborted", "landed by the operator", "first_flight2")
    assert flown.log == tmp_path / "a.tlog"
    assert [tick.t_s for tick in ticks[:2]] == [0.05, 0.1]
    assert {"connect", "arm", "takeoff", "form", "land"} <= {tick.phase for tick in ticks}
    last = ticks[-1]
    assert np.abs(last.pos_enu_m - mission.pads_enu_m).max() < 1.5
    assert all(np.isnan(tick.formation_error_m) for tick in ticks if tick.phase == "takeoff")
    assert all(tick.formation_error_m < 10.0 for tick in ticks if tick.phase == "form")
    assert max(np.linalg.norm(tick.setpoint_enu_m_s, axis=1).max() for tick in ticks) <= 0.5 + 1e-9
    assert gs.verify(tmp_path / "a.tlog").mismatches == 0

    log = gs.read_log(tmp_path / "a.tlog")
    columns = log.positions()
    assert log.vehicles == [1, 2]
    assert set(columns["vehicle"].tolist()) == {1, 2}
    assert np.all(np.diff(columns["t_s"]) >= 0)
    assert columns["z_enu_m"].max() == pytest.approx(max(tick.pos_enu_m[:, 2].max() for tick in ticks), abs=0.6)
    assert len(log.setpoints()["t_s"]) == flown.figures["setpoints"]
    assert log.at([columns["t_s"][-1] / 2]).shape == (1, 2, 3)
    assert [name for name, _, _ in log.phases][:2] == ["connect", "arm"]
    assert log.result["outcome"] == "aborted"
    assert any("landed by the operator" in text for _, text in log.events)
    page = gs.report(log, tmp_path / "report")[0].read_text()
    assert page.startswith("<!doctype html>")
    assert "<h2>Links</h2>" in page


@pytest.mark.parametrize("package", ["pandas", "polars"])
def test_tables_are_frames_where_the_package_is_installed(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = api.Log(tmp_path, _flight())
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(UserError, match=f"{package} is not installed: pip install {package}"):
        getattr(log, f"to_{package}")()
    stand_in: Any = ModuleType(package)
    stand_in.DataFrame = lambda columns: columns
    monkeypatch.setitem(sys.modules, package, stand_in)
    assert sorted(getattr(log, f"to_{package}")("setpoints")) == [
        "t_s", "vehicle", "vx_enu_m_s", "vy_enu_m_s", "vz_enu_m_s",
    ]  # fmt: skip
    with pytest.raises(UserError, match="roles: unknown; known are positions, setpoints"):
        getattr(log, f"to_{package}")("roles")


def _flight() -> Any:
    from types import SimpleNamespace

    track = SimpleNamespace(
        id=4,
        t_ns=np.array([5, 6]),
        pos_team_enu_m=np.zeros((2, 3)),
        setpoint_t_ns=np.array([7]),
        setpoint_vel_enu_m_s=np.ones((1, 3)),
    )
    return SimpleNamespace(vehicles=(track,), start_ns=5)


def test_vehicles_are_flown_from_the_main_thread_alone() -> None:
    told: list[str] = []

    def elsewhere() -> None:
        try:
            gs.fly("first_flight2")
        except UserError as error:
            told.append(str(error))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert told == ["fly: Ctrl-C, which brings everybody back, is heard in the main thread alone; fly from there"]


def test_a_law_of_a_notebook_is_given_as_it_is(tmp_path: Path) -> None:
    def still(seen: gs.Seen) -> Any:
        return np.zeros_like(seen.vel_flu_m_s)

    mission = gs.load_mission("first_flight2", {"steps.0.form.timeout_s": 1}, law=still)
    flown = gs.simulate(mission, log=tmp_path / "still.tlog")
    assert flown.reason.startswith("not formed after 1 s")
    assert gs.verify(tmp_path / "still.tlog", law=still).mismatches == 0
    with pytest.raises(UserError, match="has no test_a_law_of_a_notebook"):
        gs.verify(tmp_path / "still.tlog")


def test_mistakes_are_user_errors_in_words(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="the nearest name is cube8"):
        gs.load_mission("cubee8")
    with pytest.raises(UserError, match="speed_limit: unknown key, did you mean speed_limit_m_s"):
        gs.load_mission("cube8", {"speed_limit": 1})
    with pytest.raises(UserError, match="on_tick: 'dance' is no order"):
        gs.simulate("first_flight2", on_tick=lambda tick: "dance")
    with pytest.raises(UserError, match=r"logs end in \.tlog"):
        gs.simulate("first_flight2", log=tmp_path / "a.txt")
