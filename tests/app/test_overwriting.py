"""No command replaces what it did not make; what it would make again it replaces, and says so."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from groundstation.app.resources import packaged_configs
from tests.app.commands import gs

FOREIGN = b"<!doctype html><title>my thesis</title>"
FLY = ["fly", "--mission", "first_flight2.yaml", "--dry-run", "--set", "limits.preflight_s=0.2", "--json"]
"""Refused before the vehicles are ready: a dry run of a moment, with its log."""
Patch = pytest.MonkeyPatch
Captured = pytest.CaptureFixture[str]


def test_dry_runs_without_a_name_keep_each_other_and_reports_replace_reports_alone(
    tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    logs = []
    for speed in ("1.0", "0.8"):
        code, out, _ = gs([*FLY, "--set", f"speed_limit_m_s={speed}"], monkeypatch, capsys)
        assert code == 3
        logs.append(json.loads(out.splitlines()[-1])["log"])
    assert logs == ["flights/first_flight2-seed0.tlog", "flights/first_flight2-seed0-2.tlog"]
    named = [*FLY, "--log", logs[0]]  # as `make fly` does
    code, _, err = gs(named, monkeypatch, capsys)
    assert code == 3
    assert f"replaces {logs[0]}, an earlier dry run" in err

    report = ["report", logs[0], "-o", "report"]
    (tmp_path / "report").mkdir()
    page, picture = tmp_path / "report" / "index.html", tmp_path / "report" / "distances.png"
    page.write_bytes(FOREIGN)
    code, _, err = gs(report, monkeypatch, capsys)
    assert code == 2
    assert "report/index.html: exists, and is not what this command would make again" in " ".join(err.split())
    assert [page.read_bytes(), list(page.parent.iterdir())] == [FOREIGN, [page]]
    page.rename(picture)  # a picture of somebody else under one of our names
    assert gs(report, monkeypatch, capsys)[0] == 2
    assert list(page.parent.iterdir()) == [picture]
    assert gs([*report, "--force"], monkeypatch, capsys)[0] == 0
    drawn = picture.read_bytes()
    assert drawn.startswith(b"\x89PNG")
    code, out, err = gs(report, monkeypatch, capsys)  # the second time it is its own
    assert code == 0
    assert "replaced: report/index.html" in out + err
    page.unlink()
    page.symlink_to(tmp_path / "elsewhere")
    assert gs([*report, "--force"], monkeypatch, capsys)[0] == 2
    assert not (tmp_path / "elsewhere").exists()


def test_gains_replace_gains_of_the_same_formation_alone(tmp_path: Path, monkeypatch: Patch, capsys: Captured) -> None:
    monkeypatch.chdir(tmp_path)
    gains, text = Path("a.npz"), Path("notes.npz")
    text.write_bytes(FOREIGN)
    assert gs(["design", "tetrahedron4.yaml", "-o", "a.npz"], monkeypatch, capsys)[0] == 0
    assert gs(["design", "tetrahedron4.yaml", "-o", "a.npz"], monkeypatch, capsys)[0] == 0
    first = gains.read_bytes()
    code, _, err = gs(["design", "pyramid5.yaml", "-o", "a.npz"], monkeypatch, capsys)
    assert code == 2
    assert "a.npz: exists, and is not what this command would make again; name another file with -o" in " ".join(
        err.split()
    )
    assert gains.read_bytes() == first
    assert gs(["design", "tetrahedron4.yaml", "-o", "notes.npz"], monkeypatch, capsys)[0] == 2
    assert text.read_bytes() == FOREIGN
    assert gs(["design", "pyramid5.yaml", "-o", "a.npz", "--force"], monkeypatch, capsys)[0] == 0
    assert gains.read_bytes() != first


def test_a_suggested_graph_replaces_no_formation_and_no_foreign_picture(
    tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    own = Path("own.yaml")
    own.write_bytes((packaged_configs() / "formations" / "tetrahedron4.yaml").read_bytes())
    before = own.read_bytes()
    suggest = ["design", "own.yaml", "--suggest-graph", "balanced"]
    assert gs([*suggest, "--graph-file", "own.yaml"], monkeypatch, capsys)[0] == 2
    assert own.read_bytes() == before
    picture = Path("graph.svg")
    for _ in range(2):
        assert gs([*suggest, "--picture", "graph.svg"], monkeypatch, capsys)[0] == 0
    picture.write_bytes(b"<svg/>")
    assert gs([*suggest, "--picture", "graph.svg"], monkeypatch, capsys)[0] == 2
    assert picture.read_bytes() == b"<svg/>"


def test_a_campaign_takes_no_folder_with_somebody_elses_page(
    tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    (tmp_path / "index.html").write_bytes(FOREIGN)
    code, _, err = gs(["campaign", "--mission", "cube8.yaml", "--runs", "1", "-o", str(tmp_path)], monkeypatch, capsys)
    assert code == 2
    assert "index.html: exists, and is not what this command would make again" in " ".join(err.split())
    assert (tmp_path / "index.html").read_bytes() == FOREIGN
