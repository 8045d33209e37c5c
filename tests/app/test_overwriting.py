"""No command replaces what it did not make; what it would make again it replaces, and says so."""

from __future__ import annotations

import json
import lzma
from pathlib import Path

import pytest

from groundstation.app.resources import packaged_configs
from tests.app.commands import gs
from tests.app.test_record_commands import CSV
from tests.reference import FOLDER

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
    code, _, err = gs([*named, "--set", "speed_limit_m_s=0.7"], monkeypatch, capsys)
    assert code == 2
    assert "exists, and is not what this command would make again" in " ".join(err.split())
    code, _, err = gs([*named, "--set", "speed_limit_m_s=1.0"], monkeypatch, capsys)
    assert code == 3
    assert f"replaces {logs[0]}" in err

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


def _design(*more: str) -> list[str]:
    return ["design", "tetrahedron4", *more]


_WRITERS = {
    "fly": ("log", ["fly", "--mission", "first_flight2", "--dry-run", "--set", "limits.preflight_s=0.2"], "--log"),
    "design": ("npz", _design(), "-o"),
    "design picture": ("svg", _design("--suggest-graph", "sparse"), "--picture"),
    "design graph": ("yaml", _design("--suggest-graph", "sparse"), "--graph-file"),
    "new": ("yaml", ["new", "formation", "line", "-n", "3"], "-o"),
    "new law": ("py", ["new", "law", "x"], "-o"),
    "import": ("tlog", ["import", "crazyswarm", "recorded"], "-o"),
    "identify": ("png", ["identify", "flown.tlog"], "--picture"),
}
"""Commands that write one file: its suffix, what is typed, the option that names it."""
_MADE_NEW = ("design graph", "new", "new law")
"""Of these, those whose files people go on with: there, they are not made again."""


@pytest.mark.parametrize("name", _WRITERS)
def test_every_command_that_writes_a_file_keeps_the_one_rule(
    name: str, tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    suffix, typed, option = _WRITERS[name]
    if name == "import":
        Path("recorded").mkdir()
        for part, text in CSV.items():
            Path("recorded", part).write_text(text)
    if name == "identify":
        flown = FOLDER / "completed"
        Path("flown.tlog").write_bytes(lzma.decompress(flown.with_suffix(".tlog.xz").read_bytes()))
        Path("flown.manifest.json").write_bytes(flown.with_suffix(".manifest.json").read_bytes())
    file = Path(f"made.{'tlog' if suffix == 'log' else suffix}")
    line = [*typed, option, str(file)]
    assert gs(line, monkeypatch, capsys)[0] in (0, 3)
    own = file.read_bytes()
    code, out, err = gs(line, monkeypatch, capsys)
    said = " ".join((out + err).split())
    if name in _MADE_NEW:
        assert (code, "exists, and is not what this command would make again" in said) == (2, True)
    else:
        assert (code in (0, 3), f"replaces {file}" in said) == (True, True)
    file.write_bytes(FOREIGN)
    file.with_suffix(".manifest.json").unlink(missing_ok=True)
    code, _, err = gs(line, monkeypatch, capsys)
    said = " ".join(err.split())
    assert (code, file.read_bytes()) == (2, FOREIGN)
    assert f"{file}: exists, and is not what this command would make again; name another" in said
    assert "or replace it with --force" in said
    code, out, err = gs([*line, "--force"], monkeypatch, capsys)
    assert code in (0, 3)
    assert f"replaces {file}" in (said := " ".join((out + err).split())) or f"replaced {file}" in said
    assert file.read_bytes()[:8] == own[:8]


_NAMED = {
    **{name: (suffix, [*typed, option]) for name, (suffix, typed, option) in _WRITERS.items()},
    "export": ("csv", ["export", "flown.tlog", "--to", "csv", "-o"]),
    "report": ("", ["report", "flown.tlog", "-o"]),
    "compare": ("", ["compare", "flown.tlog", "flown.tlog", "-o"]),
    "campaign": ("", ["campaign", "--mission", "first_flight2", "--runs", "1", "-o"]),
    "campaign log": ("tlog", ["campaign", "--mission", "first_flight2", "--only", "0", "--log"]),
    "params": ("params", ["params", "save", "--mission", "first_flight2", "--file"]),
}
"""Commands that write where they are told: the suffix of one file, and what is typed before its name."""

_NAMELESS = [
    (name, called)
    for name, (suffix, typed) in _NAMED.items()
    for called in ("nothing", "nothing, joined", "a folder", "the folder above", "long", "longer", "device")
    if (suffix or called not in ("a folder", "the folder above", "long"))  # those that want a folder
    and (typed[-1].startswith("--") or called != "nothing, joined")
]


@pytest.mark.parametrize(("name", "called"), _NAMELESS)
def test_a_name_that_no_file_can_have_is_refused_before_anything_is_written(
    name: str, called: str, tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    inside = tmp_path / "inside"
    (inside / "recorded").mkdir(parents=True)
    monkeypatch.chdir(inside)
    flown = FOLDER / "completed"
    Path("flown.tlog").write_bytes(lzma.decompress(flown.with_suffix(".tlog.xz").read_bytes()))
    Path("flown.manifest.json").write_bytes(flown.with_suffix(".manifest.json").read_bytes())
    suffix, typed = _NAMED[name]
    end = f".{'tlog' if suffix == 'log' else suffix}" if suffix else ""
    file = {
        "nothing": "",
        "nothing, joined": "",
        "a folder": ".",
        "the folder above": "..",
        "long": "x" * (250 - len(end)) + end,  # there is such a name, but none for the file that is to take it
        "longer": "x" * 300 + end,
        "device": "/dev/null",
    }[called]
    before = sorted(tmp_path.rglob("*"))
    line = [*typed[:-1], f"{typed[-1]}="] if called == "nothing, joined" else [*typed, file]
    code, _, err = gs([*line, "--force"], monkeypatch, capsys)
    said = " ".join(err.split())
    assert (code, said.startswith("gs: ")) == (2, True)
    assert (file or f"gs: {typed[-1]}: its name is empty") in said
    assert sorted(tmp_path.rglob("*")) == before


def test_every_command_that_writes_takes_force() -> None:
    from tests.docs.pages import click_commands

    writes = {"-o", "--output", "--log", "--picture", "--graph-file", "--file"}
    forced = set()
    for name, command in click_commands().items():
        options = {option for parameter in command.params for option in parameter.opts}
        if writes & options and name != "console":  # its --log is read
            assert "--force" in options, name
        if "--force" in options:
            forced.add(name)
    # `gs init` names a folder and no option; `gs signing new` makes a key, which nothing may replace.
    asked = "fly design new init params import report compare campaign export identify"
    assert forced == set(asked.split())


def test_a_folder_of_ones_own_is_written_into_with_force_only(
    tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    mission = Path("mine/mission.yaml")
    assert gs(["init", "mine"], monkeypatch, capsys)[0] == 0
    mission.write_bytes(FOREIGN)
    assert gs(["init", "mine"], monkeypatch, capsys)[0] == 2
    assert mission.read_bytes() == FOREIGN
    code, out, _ = gs(["init", "mine", "--force"], monkeypatch, capsys)
    assert (code, "replaced in mine" in out, mission.read_bytes() != FOREIGN) == (0, True, True)


def test_nothing_replaces_what_vehicles_flew(tmp_path: Path, monkeypatch: Patch, capsys: Captured) -> None:
    monkeypatch.chdir(tmp_path)
    named = [*FLY, "--log", "a.tlog"]
    assert gs(named, monkeypatch, capsys)[0] == 3
    manifest = Path("a.manifest.json")
    values = json.loads(manifest.read_text())
    manifest.write_text(json.dumps(values | {"dry_run": False, "seed": None}))
    kept = Path("a.tlog").read_bytes()
    code, _, err = gs([*named, "--force"], monkeypatch, capsys)
    assert (code, "vehicles flew it: it cannot be had again" in " ".join(err.split())) == (2, True)
    assert Path("a.tlog").read_bytes() == kept


def test_parameters_are_not_asked_for_where_they_may_not_be_kept(
    tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hello1.params").write_bytes(FOREIGN)
    monkeypatch.setattr("groundstation.app.param_keeping.lines_of", None)  # nobody gets as far
    code, _, err = gs(["params", "save", "--mission", "hello1"], monkeypatch, capsys)
    assert (code, "or replace it with --force" in " ".join(err.split())) == (2, True)
