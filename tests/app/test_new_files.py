"""What ``gs`` writes for people who begin: formation files, JSON schemas, shell completion."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.app.formation_text import formation_text
from groundstation.app.resources import packaged_configs
from groundstation.core.formation import Formation
from groundstation.core.types import FloatArray
from groundstation.design.common_shapes import SHAPES, points_of
from groundstation.design.store import load_formation
from tests.app.commands import gs


def _distances(points: FloatArray) -> list[float]:
    return [float(np.linalg.norm(a - b)) for a, b in itertools.combinations(points, 2)]


@settings(max_examples=30, deadline=None)
@given(shape=st.sampled_from(sorted(SHAPES)), agents=st.integers(2, 30))
def test_shapes_have_their_agents_one_metre_apart_above_the_ground(shape: str, agents: int) -> None:
    points = points_of(shape, agents)
    assert points.shape == (agents, 3)
    assert min(_distances(points)) == pytest.approx(1.0)
    assert points[:, 2].min() == 0.0


def test_shapes_are_what_they_are_called() -> None:
    around = points_of("ring", 6)
    assert np.linalg.norm(around - around.mean(axis=0), axis=1) == pytest.approx(1.0)  # a hexagon's radius is its side
    assert sorted(map(tuple, points_of("cube", 8))) == sorted(itertools.product((0.0, 1.0), repeat=3))
    assert points_of("v", 3)[0, 1] > points_of("v", 3)[1, 1] == points_of("v", 3)[2, 1]
    ball = points_of("sphere", 20)
    centred = ball - np.array([0.0, 0.0, (ball[:, 2].max() + ball[:, 2].min()) / 2.0])
    assert np.ptp(np.linalg.norm(centred, axis=1)) < 1e-9


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-1e3, 1e3)] * 3), min_size=2, max_size=6, unique=True),
    st.text(st.characters(codec="utf-8", exclude_categories=["C"]), min_size=1, max_size=20),
)
def test_a_formation_that_was_written_reads_the_same(points: list[tuple[float, float, float]], name: str) -> None:
    written = Formation(name=name, points_enu_m=np.array(points), edges=tuple((0, i) for i in range(1, len(points))))
    values = yaml.safe_load(formation_text(written, about=["first"]))
    assert values["name"] == name
    assert np.array_equal(np.array(values["points"]), written.points_enu_m)
    edges = [[1, 2]] if values["edges"] == "complete" else values["edges"]
    assert edges == [[i + 1, j + 1] for i, j in written.edges]


def test_a_new_formation_is_one_that_gs_design_accepts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, _ = gs(["new", "formation", "ring", "-n", "7", "--spacing", "1.5", "--json"], monkeypatch, capsys)
    assert code == 0
    made = json.loads(out.splitlines()[-1])
    assert made["slowest"] > 1.0
    assert min(_distances(load_formation(tmp_path / "ring7.yaml").points_enu_m)) == pytest.approx(1.5)
    code, out, _ = gs(["design", "ring7.yaml", "--json"], monkeypatch, capsys)
    designed = json.loads(out.splitlines()[-1])
    assert (code, designed["feasible"], designed["edges"]) == (0, True, made["edges"])

    before = (tmp_path / "ring7.yaml").read_bytes()
    code, _, err = gs(["new", "formation", "ring", "-n", "7"], monkeypatch, capsys)
    assert (
        code,
        "or replace it with --force" in " ".join(err.split()),
        (tmp_path / "ring7.yaml").read_bytes() == before,
    ) == (2, True, True)


def test_a_formation_from_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("p.csv").write_text("x,y,z\n0,0,0\n1.25,0,0\n0,1,0\n0,0,2\n")
    assert gs(["new", "formation", "p.csv", "--graph", "complete"], monkeypatch, capsys)[0] == 0
    formation = load_formation(Path("p.yaml"))
    assert formation.points_enu_m.tolist() == [[0, 0, 0], [1.25, 0, 0], [0, 1, 0], [0, 0, 2]]
    assert len(formation.edges) == 6


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to stand in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("typed", "content", "answer"),
    [
        ("hexagon -n 6", None, "hexagon: unknown; known are ring"),
        ("ring", None, "--agents: say how many"),
        ("ring -n 1", None, "--agents 1: must be 2 to 2000"),
        ("ring -n 4 --spacing 0", None, "--spacing 0: must be more than 0 m"),
        (
            "ring -n 4 --graph star",
            None,
            "--graph star: unknown, did you mean sparse? known are complete, mesh, sparse",
        ),
        ("p.csv", None, "p.csv: cannot be read"),
        ("p.csv", "0,0,0\n1,nan,0\n", "p.csv: line 2: expected three finite numbers"),
        ("p.csv", "0,0,0\n1,1\n", "p.csv: line 2: expected three finite numbers"),
        ("p.csv", "0,0,0\n", "p.csv: has 1 points"),
        ("p.csv", "0,0,0\n0,0,0\n", "p.csv: two points are in one place"),
        ("p.csv -n 4", "0,0,0\n1,0,0\n", "--agents 4: p.csv says how many"),
    ],
)
def test_what_is_no_formation_is_refused_and_nothing_is_written(
    typed: str, content: str | None, answer: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        Path("p.csv").write_text(content)
    with pytest.MonkeyPatch.context() as patch:
        code, _, err = gs(["new", "formation", *typed.split()], patch, capsys)
    assert (code, answer in err) == (2, True), err
    assert not list(folder.glob("*.yaml"))


@pytest.mark.parametrize(
    ("what", "folder"), [("mission", "missions"), ("formation", "formations"), ("campaign", "campaigns")]
)
def test_schemas_know_every_key_of_the_files_that_come_along(
    what: str, folder: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = gs(["schema", what], monkeypatch, capsys)
    assert code == 0
    schema = json.loads(out)
    assert schema["additionalProperties"] is False
    for path in (packaged_configs() / f"{what}s").glob("*.yaml"):
        assert set(yaml.safe_load(path.read_text())) <= set(schema["properties"]), path


@pytest.mark.parametrize(
    ("line", "expected"), [("gs re", {"replay", "report"}), ("gs fly --mis", {"--mission"}), ("gs des", {"design"})]
)
def test_a_shell_is_told_how_a_line_goes_on(line: str, expected: set[str]) -> None:
    words = line.split()
    environment = {"_GS_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    done = subprocess.run(
        [sys.executable, "-m", "groundstation"],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert set(done.stdout.split()) == expected, done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts_name_both_commands(
    shell: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = gs(["completion", shell], monkeypatch, capsys)
    assert code == 0
    assert all(name in out for name in ("_GS_COMPLETE", "groundstation"))
