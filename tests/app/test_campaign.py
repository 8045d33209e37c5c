"""Campaigns: what varies, the same table however it was flown, runs that can be had again, what goes wrong in one."""

from __future__ import annotations

import errno
import json
import math
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import dask
import distributed
import numpy as np
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest
from distributed.comm.core import CommClosedError
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

from groundstation.app.campaign import report
from groundstation.app.campaign.cases import Case, Cases, scattered
from groundstation.app.campaign.conduct import _share, lost_words
from groundstation.app.campaign.kinematic import kinematic_time_to_form_s
from groundstation.app.campaign.report import _draw_distances, to_markdown
from groundstation.app.campaign.run import _nothing_yet, emulated, fly_case
from groundstation.app.campaign.spread import DaskFlyer, Interrupted, Lost, fly_timed, spread
from groundstation.app.campaign.summary import figures, interval, missed, summarise, why
from groundstation.app.campaign.table import SCHEMA, Table
from groundstation.app.campaign.vary import ExpectSpec, load_vary
from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError
from sitl.faults import KINDS
from tests.app.commands import gs

CONFIGS = packaged_configs()
CUBE8 = CONFIGS / "missions" / "cube8.yaml"
SHORT = """
set: {rate_hz: 10}
limit_s: 3
settle_s: 0
grid: {starts.kind: [pads, planar, volume]}
emulator: {noise: {position_m: 0.02}, link: {delay_s: 0.05, loss: 0.02}}
"""
TETRAHEDRON = """
set:
  rate_hz: 25
  formation: ../formations/tetrahedron4.yaml
  gains: ../gains/tetrahedron4.npz
  avoidance.radius_m: 0.5
  avoidance.activation_m: 0.6
  steps.1.hold.seconds: 1
"""


def _written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def _case(folder: Path, text: str, run: int = 0, seed: int = 1) -> Case:
    return Cases(CUBE8, load_vary(_written(folder / "vary.yaml", text)), seed).case(run)


def test_a_killed_campaign_that_is_resumed_gives_the_same_bytes_and_every_run_can_be_had_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    _written(tmp_path / "vary.yaml", SHORT)
    common = ["campaign", "--mission", "cube8.yaml", "--vary", "vary.yaml", "--seed", "5", "--runs", "6", "--json"]
    whole = [*common, "--workers", "1", "-o", "whole"]
    code, out, _ = gs(whole, monkeypatch, capsys)
    values = json.loads(out.splitlines()[-1])
    assert (code, values["runs"], values["errors"]) == (0, 6, 0)
    assert {"success_rate", "success_low", "success_high", "min_distance_m", "safety_radius_m",
            "median_time_to_form_s", "worst"} <= set(values)  # fmt: skip
    rows = pq.read_table("whole/runs.parquet").to_pylist()
    assert [row["run"] for row in rows] == list(range(6))
    assert [row["cell"] for row in rows[:4]] == ["pads", "planar", "volume", "pads"]
    assert "wall_s" not in rows[0]
    assert rows[0]["seed"] == rows[1]["seed"] != rows[3]["seed"]  # cells are compared on the same numbers
    for picture in ("success.png", "time_to_form.png", "smallest_distance.png", "index.html", "summary.md"):
        assert (tmp_path / "whole" / picture).stat().st_size > 0

    # Killed with SIGKILL as its third row reaches the disk; in a thread of the process, and in another order of parts.
    killed = [*common, "--workers", "0", "-o", "killed"]
    script = f"""
import os, signal, sys
from groundstation.app import cli
from groundstation.app.campaign import conduct
from groundstation.app.campaign.table import Table
conduct._FLUSH_ROWS = 1
real, seen = Table.append, []
def append(table, rows):
    real(table, rows)
    seen.extend(rows)
    if len(seen) >= 3:
        os.kill(os.getpid(), signal.SIGKILL)
Table.append = append
sys.argv = ["gs", *{killed!r}]
cli.main()
"""
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False, timeout=300)
    assert ended.returncode == -signal.SIGKILL, ended.stderr.decode()
    assert not (tmp_path / "killed" / "runs.parquet").exists()
    assert len(list((tmp_path / "killed" / "parts").glob("part-*.parquet"))) >= 1

    code, _, err = gs(killed, monkeypatch, capsys)
    assert code == 2
    assert "--resume" in err
    code, _, err = gs([*killed, "--resume", "--seed", "6"], monkeypatch, capsys)
    assert code == 2
    assert "another mission, seed or vary file" in err
    code, out, err = gs([*killed, "--resume"], monkeypatch, capsys)
    assert code == 0
    assert "3 are there already" in err
    assert (tmp_path / "killed/runs.parquet").read_bytes() == (tmp_path / "whole/runs.parquet").read_bytes()

    # The command that the summary gives flies that run again.
    worst = values["worst"][0]
    code, out, _ = gs([*shlex.split(worst["replay"])[1:], "--json"], monkeypatch, capsys)
    again = json.loads(out.splitlines()[-1])
    there = rows[worst["run"]]
    assert {key: again[key] for key in SCHEMA.names} == {
        key: None if isinstance(value, float) and math.isnan(value) else value for key, value in there.items()
    }
    first = Path(again["log"]).read_bytes()
    _, out, _ = gs(shlex.split(worst["replay"])[1:], monkeypatch, capsys)
    assert Path(again["log"]).read_bytes() == first
    assert "setpoints" in out
    assert "log_complete" not in out  # of a log that was not verified there is nothing to say
    assert len(first) > 1000


def test_any_scheduler_by_its_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    _written(tmp_path / "vary.yaml", SHORT)
    common = ["campaign", "--mission", "cube8.yaml", "--vary", "vary.yaml", "--runs", "3"]
    package: Any = distributed
    with package.LocalCluster(
        1, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=":0"
    ) as there:
        code, _, _ = gs([*common, "--scheduler", there.scheduler_address, "-o", "there"], monkeypatch, capsys)
        assert code == 0
    code, _, _ = gs([*common, "--workers", "0", "-o", "here"], monkeypatch, capsys)
    assert code == 0
    assert (tmp_path / "there/runs.parquet").read_bytes() == (tmp_path / "here/runs.parquet").read_bytes()


def test_starts_in_a_volume_end_where_they_began(tmp_path: Path) -> None:
    case = _case(tmp_path, TETRAHEDRON + "starts: {kind: volume}\nverify: true\n")
    pads = np.array([vehicle["pad_m"] for vehicle in case.mission["vehicles"]])
    assert len(pads) == 4
    assert np.ptp(pads[:, 2]) > 0.5
    row = fly_case(case)
    assert row["error"] == ""
    assert (row["success"], row["safe"], row["end"]) == (True, True, "4 down")
    assert (row["log_mismatches"], row["log_complete"]) == (0, True)
    assert row["min_distance_m"] >= 0.5
    assert row["start_distance_m"] >= 0.55
    assert row["phases"] == "connect arm takeoff form hold return land done"


def test_upright_regions_are_judged_in_their_own_norm(tmp_path: Path) -> None:
    row = fly_case(_case(tmp_path, TETRAHEDRON + "starts: {kind: planar}\n"))
    assert row["min_clearance"] == pytest.approx(row["min_obedient_m"] / 0.5)
    shape = "  avoidance.shape: cylinder\n  avoidance.half_height_m: 0.6\n"
    row = fly_case(_case(tmp_path, TETRAHEDRON + shape + "starts: {kind: planar}\n"))
    assert row["error"] == ""
    assert row["success"]
    assert 1.0 <= row["min_clearance"] < row["min_obedient_m"] / 0.5


GRIDLOCKED = """
limit_s: 20
settle_s: 0
set:
  rate_hz: 25
  assignment: fixed
  role_swaps: false
  avoidance.radius_m: 0.8
  avoidance.activation_m: 0.85
  vehicles.0.pad_m: [0, 1, 0]
  vehicles.7.pad_m: [-1, -1, 0]
  vehicles.1.pad_m: [1, 0, 0]
  vehicles.5.pad_m: [0, -1, 0]
"""


def test_detours_are_counted_beside_gridlocks_and_swaps(tmp_path: Path) -> None:
    row = fly_case(_case(tmp_path, GRIDLOCKED))
    assert row["error"] == ""
    assert (row["gridlocks"] > 0, row["role_swaps"], row["detours"] > 0) == (True, 0, True)
    values = summarise([row, {**row, "run": 1}], [""], lambda run: f"again {run}")
    assert values["detours"] == 2 * row["detours"]
    head, _, line = (
        [cell.strip() for cell in text.strip("|").split("|")] for text in to_markdown(values).splitlines()[:3]
    )
    assert line[head.index("swaps") + 1 : head.index("swaps") + 2] == [str(2 * row["detours"])]
    assert head[head.index("swaps") + 1] == "detours"


def test_the_kinematic_team_is_the_same_whatever_flies_and_no_faster_than_it_may(tmp_path: Path) -> None:
    grid = "grid: {team.profile: [crazyflie, px4_quad]}\n"
    noise = "emulator: {noise: {position_m: 0.02}, link: {delay_s: 0.05}}\nset: {link_delay_s: 0.1}\n"
    here, there = (_case(tmp_path, grid + noise + "starts: {kind: planar}\n", run) for run in (0, 1))
    time_s = kinematic_time_to_form_s(here)
    assert time_s == kinematic_time_to_form_s(there)
    assert 0.5 < time_s < 10.0
    slower = {**here.mission, "speed_limit_m_s": 0.25}
    assert kinematic_time_to_form_s(replace(here, mission=slower)) > 1.5 * time_s
    hasty = [{"form": {"timeout_s": 0.2}}, *here.mission["steps"][1:]]
    assert math.isnan(kinematic_time_to_form_s(replace(here, mission={**here.mission, "steps": hasty})))


@pytest.mark.parametrize(
    ("cell", "fault", "struck_in"),
    [
        ("px4", "blackout", "form"),
        ("arducopter", "position_nan", "return"),
    ],
)
def test_faults_strike_when_the_phase_is_really_entered(tmp_path: Path, cell: str, fault: str, struck_in: str) -> None:
    text = f"""
team: {{autopilot: {cell}, profile: crazyflie}}
verify: true
faults: {{what: {{kind: {fault}}}, phase: {struck_in}, within_s: 0.5}}
starts: {{kind: planar}}
"""
    text = f"{TETRAHEDRON}  land.timeout_s: 10\n{text}"  # nobody waits longer for one that is in another's way
    row = fly_case(_case(tmp_path, text))
    assert row["error"] == ""
    assert row["faults"] == fault.partition(",")[0]
    assert row["fault_vehicle"] in (1, 2, 3, 4)
    assert row["fault_at_s"] > 5.0
    assert row["safe"], row
    assert row["told"]
    assert row["outcome"] == "aborted"
    assert row["log_mismatches"] == 0


def test_who_falls_with_an_empty_battery_counts_as_one_that_nobody_can_steer(tmp_path: Path) -> None:
    text = """
faults: {what: {kind: battery_drain, percent_per_s: 100}, phase: form}
starts: {kind: planar}
"""
    row = fly_case(_case(tmp_path, TETRAHEDRON + text))
    assert row["error"] == ""
    assert row["outcome"] == "aborted"
    assert row["safe"], row
    assert row["min_distance_m"] <= row["min_obedient_m"]


def test_the_fault_matrix_is_complete() -> None:
    seen = set()
    for name in ("faults", "faults_gps"):  # a room of motion capture, and what only vehicles with GPS can lose
        vary = load_vary(CONFIGS / "campaigns" / f"{name}.yaml")
        cells = [vary.setting(cell.values) for cell in vary.cells]
        seen |= {(setting.team.autopilot, setting.faults.phase, setting.faults.what[0]["kind"]) for setting in cells}
        assert len({cell.name for cell in vary.cells}) == len(vary.cells)
    phases = ("ground", "takeoff", "form", "hold", "return", "land")
    assert seen == {(a, p, kind) for a in ("px4", "arducopter") for p in phases for kind in KINDS}


@pytest.mark.parametrize("path", sorted((CONFIGS / "campaigns").glob("*.yaml")), ids=lambda path: path.stem)
def test_campaigns_that_come_along_make_a_plan_in_every_cell(path: Path) -> None:
    vary = load_vary(path)
    if vary.spec.adversary is not None:  # it has missions of its own, see test_adversary.py
        assert vary.spec.mission is None
        return
    cases = Cases(path.parent / (vary.spec.mission or "../missions/cube8.yaml"), vary, 3)
    for run in range(0, len(vary.cells), max(len(vary.cells) // 20, 1)):
        case = cases.case(run)
        plan = case.plan()
        pads = np.linalg.norm(plan.pads_enu_m[:, None] - plan.pads_enu_m[None], axis=-1)
        if case.setting.starts.kind != "pads":
            assert pads[np.triu_indices(plan.size, 1)].min() >= 1.1 * plan.spec.avoidance.radius_m
        assert emulated(case, plan).vehicles[0].streams == "quiet"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("startz: {kind: planar}", "startz: unknown key"),
        ("starts: {kind: circle}", "starts.kind"),
        ("grid: {startz.kind: [planar]}", "leads nowhere"),
        ("grid: {limit_s.x: [1]}\nlimit_s: 3", "no keys below a single value"),
        ("grid: {starts.kind: []}", "grid.starts.kind"),
        ("choose: {emulator.link.loss: [0.1, 2]}", "emulator.link.loss"),
        ("faults: {what: {kind: gremlin}, phase: form}", "'gremlin' is unknown"),
        ("faults: {what: {kind: blackout}}", "go together"),
        ("faults: {what: {kind: blackout, at_s: 3}, phase: form}", "at_s and vehicles are for timetable"),
        ("emulator: {link: {loss: yes}}", "emulator.link.loss"),
        ("runs: 0", "runs"),
        ("adversary: {}\nset: {rate_hz: 20}", "an adversary draws its own missions"),
        ("adversary: {vehicles: 1}", "adversary.vehicles"),
        ("set: {avoidance.radius_m: 0.9}", "avoidance.radius_m"),
        ("set: {speed_limit: 3}", "speed_limit"),
        ("team: {profile: zeppelin}", "zeppelin: unknown; known are crazyflie"),
        ("starts: {kind: planar, spread: 1.0, apart: 6}", "no room for 8 vehicles"),
        ("faults: {timetable: [{kind: blackout, at_s: 1, vehicles: [99]}]}", "99 is not among"),
    ],
)  # fmt: skip
def test_a_wrong_vary_file_is_told_before_anything_flies(tmp_path: Path, text: str, words: str) -> None:
    def prepare() -> None:
        case = _case(tmp_path, text)
        emulated(case, case.plan())

    with pytest.raises(UserError) as told:
        prepare()
    assert words in str(told.value)


def test_what_is_drawn_per_run_follows_from_the_seed(tmp_path: Path) -> None:
    text = """
choose: {emulator.link.loss: [0, 0.1], set.speed_limit_m_s: [0.3, 0.4, 0.5]}
faults: {within_s: 2, phase: form, what: [{kind: reboot}]}
"""
    vary = load_vary(_written(tmp_path / "vary.yaml", text))
    first, again = (Cases(CUBE8, vary, 8) for _ in range(2))
    other = Cases(CUBE8, vary, 9)
    cases = [first.case(run) for run in range(20)]
    assert cases == [again.case(run) for run in range(20)]
    assert len({case.drawn for case in cases}) > 3
    assert len({(case.victim, case.delay_s) for case in cases}) > 15
    assert [case.seed for case in cases] != [other.case(run).seed for run in range(20)]
    assert first.fingerprint() == again.fingerprint() != other.fingerprint()


@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(2, 12),
    side=st.floats(2.0, 6.0),
    flat=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_starts_are_apart_and_inside(count: int, side: float, flat: bool, seed: int) -> None:
    low, high = np.zeros(3), np.array([side, side, 0.0 if flat else side])
    apart = 0.55 * side / math.sqrt(count)
    points = scattered(count, low, high, apart, np.random.default_rng(seed))
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)[np.triu_indices(count, 1)]
    assert points.shape == (count, 3)
    assert distances.min() >= apart
    assert (points >= low).all()
    assert (points <= high).all()


def test_whatever_goes_wrong_in_a_run_becomes_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = _case(tmp_path, SHORT)
    broken = replace(case, mission={**case.mission, "rate_hz": 1})
    row = fly_case(broken)
    assert "rate_hz" in row["error"]
    assert set(row) == set(SCHEMA.names)
    monkeypatch.setattr("groundstation.app.opening.Runner", lambda *_, **__: 1 / 0)
    row = fly_case(case)
    assert row["error"].startswith("ZeroDivisionError: ")
    assert "test_campaign.py" in row["error"]


IDENTITY = {"fingerprint": "f", "versions": {"gs": "1"}}


def _table(folder: Path, *numbers: int, wall_s: float = 2.5) -> Table:
    """A campaign of which some runs have finished and nothing was merged yet."""
    table = Table(folder / "runs")
    table.open(IDENTITY, resume=False)
    blank = _nothing_yet(_case(table.folder, SHORT))
    for number in numbers:
        table.append([{**blank, "run": number, "wall_s": wall_s}])
    return table


def test_wall_times_that_are_gone_cost_no_run(tmp_path: Path) -> None:
    table = _table(tmp_path, 0, 1)
    table.merge()
    table.times_path.unlink()
    again = Table(table.folder)
    assert again.open(IDENTITY, resume=True) == {0, 1}
    again.append([{**again.merge()[0], "run": 2, "wall_s": 4.0}])
    rows = again.merge()
    assert [row["run"] for row in rows] == [0, 1, 2]
    assert np.array_equal([row["wall_s"] for row in rows], [math.nan, math.nan, 4.0], equal_nan=True)


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize("merged", [False, True])
@pytest.mark.parametrize("text", [None, "", "[]"])
def test_rows_without_what_they_follow_from_are_not_taken_over(
    tmp_path: Path, text: str | None, merged: bool, resume: bool
) -> None:
    table = _table(tmp_path, 0)
    if merged:
        table.merge()
    path = table.folder / "campaign.json"
    path.unlink()
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=r"campaign\.json.* follow from; give another folder"):
        Table(table.folder).open({**IDENTITY, "fingerprint": "other"}, resume=resume)
    assert (path.read_text(encoding="utf-8") if path.exists() else None) == text


def test_a_table_of_other_columns_is_refused(tmp_path: Path) -> None:
    table = _table(tmp_path, 0)
    table.merge()
    pq.write_table(pq.read_table(table.runs_path).drop_columns(["detours"]), table.runs_path)
    with pytest.raises(UserError, match=r"runs\.parquet: has no column detours"):
        Table(table.folder).open(IDENTITY, resume=True)


@pytest.mark.parametrize("full", ["runs.parquet", "wall.parquet"])
def test_a_disk_that_is_full_when_the_table_is_made_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full: str
) -> None:
    table = _table(tmp_path, 0, 1)
    there: list[Path] = []

    def sync(number: int) -> None:
        there.extend(table.folder.glob(".*.part"))
        if there[-1].name == f".{full}.part":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr("groundstation.core.own_files.os.fsync", sync)
        with pytest.raises(UserError, match=r"No space left on device; all rows are in .*: make room, then --resume"):
            table.merge()
    assert there
    assert not list(table.folder.glob(".*"))  # half a file is only in the way
    again = Table(table.folder)
    assert again.open(IDENTITY, resume=True) == {0, 1}
    assert [row["wall_s"] for row in again.merge()] == [2.5, 2.5]
    other = _table(tmp_path / "other", 1, 0)
    other.merge()
    assert again.runs_path.read_bytes() == other.runs_path.read_bytes()


class _Future:
    def __init__(self, outcome: Any) -> None:
        self.outcome = outcome

    def add_done_callback(self, call: Any) -> None:
        call(self)

    def result(self) -> Any:
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return self.outcome

    def release(self) -> None:
        pass


WORKER: Any = None


class _Client:
    def __init__(self) -> None:
        self.asked: list[int] = []

    def nthreads(self) -> dict[str, int]:
        return {"a": 1}

    def submit(self, _function: Any, case: Case, *, pure: bool) -> _Future:
        assert not pure
        self.asked.append(case.run)
        killed = distributed.KilledWorker("fly_timed-5f1e", last_worker=WORKER, allowed_failures=3)
        return _Future({2: killed, 4: ImportError("no such thing")}.get(case.run, {"run": case.run}))


def test_a_lost_worker_makes_no_row_and_an_interrupt_costs_none(tmp_path: Path) -> None:
    case = _case(tmp_path, SHORT)
    client, interrupted = _Client(), Interrupted()
    rows: list[dict[str, Any]] = []
    told: list[str] = []
    cases: Iterator[Case] = (replace(case, run=run) for run in range(7))
    lost = spread(cases, DaskFlyer(client, "here", told.append), rows.extend, interrupted)
    assert sorted(row["run"] for row in rows) == [0, 1, 3, 5, 6]
    assert lost == [Lost(2, "4 workers died with it"), Lost(4, "ImportError: no such thing")]
    assert (
        lost_words(lost, 7)
        == "2 of 7 runs were not flown (run 2: 4 workers died with it); --resume flies what is missing"
    )
    assert told == []

    client = _Client()
    rows.clear()

    def keep(more: list[dict[str, Any]]) -> None:
        rows.extend(more)
        interrupted.asked = True

    spread((replace(case, run=run) for run in range(1000)), DaskFlyer(client, "here", told.append), keep, interrupted)
    assert len(rows) >= 1
    assert max(client.asked) < 10


class _Deserted(_Client):
    """Its only worker comes and goes, then its scheduler."""

    def __init__(self, there: list[bool]) -> None:
        super().__init__()
        self._there = there

    def add_done_callback(self, call: Any) -> None:
        """Nothing is ever flown here."""

    def nthreads(self) -> dict[str, int]:
        if not self._there:
            raise CommClosedError("connection reset by peer")
        if self._there.pop(0):
            return {"a": 1}
        return {}

    def submit(self, _function: Any, case: Case, *, pure: bool) -> Any:
        return self


def test_a_campaign_without_workers_tells_so_and_waits_until_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.app.campaign.spread._LOOK_S", 0.0)
    case = _case(tmp_path, SHORT)
    told: list[str] = []
    flyer = DaskFlyer(_Deserted([True, True, False, False, False, True, True, False]), "at tcp://far:1", told.append)
    assert flyer.room > 0
    flyer.submit(case)
    for _ in range(7):
        assert flyer.wait() == []
    gone = "no workers at tcp://far:1; waiting for one (Ctrl-C stops, --resume goes on)"
    assert told == [gone, "there are workers at tcp://far:1 again", gone]
    with pytest.raises(UserError, match=r"the scheduler at tcp://far:1 is gone; start it again, then --resume"):
        flyer.wait()


def test_a_run_whose_worker_died_is_not_flown_and_resume_flies_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    _written(tmp_path / "vary.yaml", "set: {rate_hz: 10}\nlimit_s: 1\nsettle_s: 0\n")
    common = ["campaign", "--mission", "cube8.yaml", "--vary", "vary.yaml", "--runs", "3", "--json"]

    def dies(case: Case) -> dict[str, Any]:
        if case.run == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return fly_timed(case)

    with monkeypatch.context() as patched, dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        patched.setattr("groundstation.app.campaign.spread.fly_timed", dies)
        code, out, err = gs([*common, "--workers", "1", "-o", "died"], monkeypatch, capsys)
    values = json.loads(out.splitlines()[-1])
    assert (code, values["runs"], values["not_flown"], values["errors"]) == (1, 2, 1, 0)
    assert "1 of 3 runs was not flown (run 1: its worker died); --resume flies what is missing" in err
    assert [row["run"] for row in pq.read_table("died/runs.parquet").to_pylist()] == [0, 2]
    code, out, _ = gs([*common, "--workers", "0", "-o", "died", "--resume"], monkeypatch, capsys)
    assert (code, json.loads(out.splitlines()[-1])["not_flown"]) == (0, 0)
    code, _, _ = gs([*common, "--workers", "0", "-o", "whole"], monkeypatch, capsys)
    assert code == 0
    assert (tmp_path / "died/runs.parquet").read_bytes() == (tmp_path / "whole/runs.parquet").read_bytes()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_table_is_made_leaves_no_folder_without_a_summary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], number: signal.Signals
) -> None:
    monkeypatch.chdir(tmp_path)
    _written(tmp_path / "vary.yaml", "set: {rate_hz: 10}\nlimit_s: 1\nsettle_s: 0\n")
    command = ["campaign", "--mission", "cube8.yaml", "--vary", "vary.yaml", "--workers", "0", "-o", "runs"]
    before = [signal.getsignal(taken) for taken in (signal.SIGINT, signal.SIGTERM)]
    merge, draw = Table.merge, report.draw
    struck: list[str] = []

    def merge_struck(table: Table) -> list[dict[str, Any]]:
        assert signal.getsignal(number) not in before
        struck.append("merge")
        os.kill(os.getpid(), number)
        return merge(table)

    def draw_struck(*arguments: Any) -> Any:
        assert signal.getsignal(number) not in before
        struck.append("draw")
        os.kill(os.getpid(), number)
        return draw(*arguments)

    monkeypatch.setattr(Table, "merge", merge_struck)
    monkeypatch.setattr(report, "draw", draw_struck)
    for extra in ([], ["--resume"]):  # after flying, and where nothing is left to be flown
        (tmp_path / "runs" / "index.html").unlink(missing_ok=True)
        code, _, _ = gs([*command, *extra], monkeypatch, capsys)
        assert code == 0  # all runs were made
        assert (tmp_path / "runs" / "index.html").stat().st_size > 0
    assert struck == ["merge", "draw"] * 2
    assert [signal.getsignal(taken) for taken in (signal.SIGINT, signal.SIGTERM)] == before


def test_rates_have_exact_intervals_and_the_worst_come_first(tmp_path: Path) -> None:
    assert interval(1000, 1000)[0] == pytest.approx(0.025 ** (1 / 1000))
    assert interval(1000, 1000)[1] == 1.0
    assert interval(0, 10)[1] == pytest.approx(1 - 0.025**0.1)
    blank = _nothing_yet(_case(tmp_path, SHORT))
    good = {**blank, "success": True, "formed": True, "safe": True, "ended_safely": True, "outcome": "completed",
            "min_distance_m": 0.6, "min_obedient_m": 0.6, "safety_radius_m": 0.45, "min_clearance": 1.33,
            "time_to_form_s": 5.0, "kinematic_time_to_form_s": 2.0}  # fmt: skip
    slow = {**good, "run": 1, "time_to_form_s": 9.0}
    near = {
        **good,
        "run": 2,
        "min_distance_m": 0.4,
        "min_obedient_m": 0.4,
        "min_clearance": 0.89,
        "nearest_pair": "1-2",
        "success": False,
        "safe": False,
    }
    failed = {**blank, "run": 3, "error": "UserError: no"}
    values = summarise([good, slow, near, failed], ["", ""], lambda run: f"again {run}")
    assert [item["run"] for item in values["worst"]] == [3, 2, 1, 0]
    assert values["worst"][1]["why"] == "distance 0.400 m between 1-2, r is 0.45 m"
    assert (values["runs"], values["success_rate"], values["below_r"], values["errors"]) == (4, 0.5, 1, 1)
    assert values["median_time_to_form_s"] == 5.0
    assert (values["median_slower"], values["kinematic_formed"]) == (2.5, 3)
    assert why({**good, "min_clearance": 0.8}) == "two vehicles at 80% of what their safety region asks for"
    assert [cell["runs"] for cell in values["cells"]] == [2, 2]
    assert "9.0 s" in why(slow)
    bars = ExpectSpec(success_rate=0.5, below_r=0, safe_rate=0.9)
    assert missed(values, bars) == ["safe_rate is 0.5, expected 0.9 at least", "below_r is 1, expected 0 at most"]
    assert missed(figures([good]), bars) == []
    words = {**good, "near_untold": 2, "pad_untold": 1, "disagreements": 3, "disagreed": "near_untold: 1 and 2\nmore"}
    ours = {**good, "run": 1, "tracebacks": 2, "log_mismatches": 3}
    values = summarise([good, words, ours], [""], lambda run: f"again {run}")
    assert (values["disagreements"], values["tracebacks"], values["logs_wrong"]) == (1, 1, 1)
    assert values["disagreed"] == {"near_untold": 1, "pad_untold": 1}
    assert [item["run"] for item in values["worst"]] == [1, 0, 0]
    assert why(words) == "near_untold: 1 and 2"
    bars = ExpectSpec(disagreements=0, tracebacks=1, logs_wrong=0)
    assert missed(values, bars) == ["disagreements is 1, expected 0 at most", "logs_wrong is 1, expected 0 at most"]
    restless = [{**good, "run": run, "hold_speed_m_s": speed} for run, speed in enumerate([math.nan, 0.04, 0.6])]
    values = summarise(restless, [""], lambda run: f"again {run}")
    assert missed(values, ExpectSpec(max_hold_speed_m_s=0.3)) == ["max_hold_speed_m_s is 0.6, expected 0.3 at most"]
    assert missed(figures(restless[:2]), ExpectSpec(max_hold_speed_m_s=0.3)) == []
    assert missed(figures(restless[:1]), ExpectSpec(max_hold_speed_m_s=0.3)) == []  # nobody held
    assert "0.600 m/s" in to_markdown(values)
    struck = [{**good, "faults": "reboot", "fault_phase": phase, "told": True} for phase in ("form", "land", "land")]
    struck[2]["safe"] = False
    values = summarise(struck, [""], lambda run: f"again {run}")
    assert values["matrix"] == {"reboot": {"form": [1, 1], "land": [1, 2]}}
    assert "| reboot | 1 of 1 | 1 of 2 |" in to_markdown(values)


def test_one_run_of_a_cell_shows_in_the_picture_of_distances(tmp_path: Path) -> None:
    blank = {**_nothing_yet(_case(tmp_path, SHORT)), "safety_radius_m": 0.5}
    rows = [{**blank, "run": run, "min_distance_m": value} for run, value in enumerate([0.6, 0.7, math.nan])]
    groups = [([row], f"cell {row['run']}") for row in rows]
    axes = Figure().add_subplot()
    _draw_distances(axes, groups, {})
    drawn = {str(line.get_label()): np.array(line.get_xydata()) for line in axes.get_lines()}
    assert list(drawn) == ["cell 0 (least 1.200)", "cell 1 (least 1.400)", "r"]
    assert drawn["cell 0 (least 1.200)"].tolist() == [[1.2, 0.0], [1.2, 1.0]]
    axes = Figure().add_subplot()
    _draw_distances(axes, [([rows[0], {**rows[0], "min_distance_m": 0.55}], "both")], {})
    assert np.array(axes.get_lines()[0].get_xydata()).tolist() == [[1.1, 0.0], [1.1, 0.5], [1.2, 1.0]]


@pytest.mark.parametrize(
    ("count", "cells", "words"),
    [(10, 312, "one each in the first 10"), (1, 4, "in the first one"), (8, 4, "2 each"), (10, 4, "2 or 3 each")],
)
def test_how_often_each_cell_is_flown_is_told_in_whole_numbers(count: int, cells: int, words: str) -> None:
    assert _share(count, cells) == words
