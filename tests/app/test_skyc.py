"""Formations out of .skyc shows, which the test writes by the published format."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BPoly

from groundstation.app.skyc_file import read_skyc
from groundstation.core.errors import UserError
from groundstation.design.store import load_formation
from tests.app.commands import gs

_CURVED = [[0.0, [0, 0, 0], []], [4.0, [0, 0, 2], []], [10.0, [6, 3, 2, 0.5], [[2, 0, 2], [5, -1, 4]]]]
_STRAIGHT = [[0.0, [0, 2, 0], []], [8.0, [0, 2, 4], []]]


def _trajectory(points: Any, **more: Any) -> dict[str, Any]:
    return {"version": 1, "points": points, "takeoffTime": 0.0, **more}


def _write(path: Path, show: Any, members: dict[str, Any]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("show.json", show if isinstance(show, bytes) else json.dumps(show))
        for name, content in members.items():
            archive.writestr(name, json.dumps(content))
    return path


def _show(*trajectories: Any) -> dict[str, Any]:
    drones = [
        {"type": "generic", "settings": {"name": f"drone {number}", "home": [9, 9, 9], "trajectory": trajectory}}
        for number, trajectory in enumerate(trajectories)
    ]
    return {"version": 1, "settings": {}, "swarm": {"drones": drones}, "environment": {"type": "outdoor"}, "meta": {}}


@pytest.fixture
def show(tmp_path: Path) -> Path:
    reference = {"$ref": "./drones/drone 0/trajectory.json#"}
    late = _trajectory([[0.0, [4, 4, 0], []], [2.0, [4, 4, 2], []]], takeoffTime=5.0)
    return _write(
        tmp_path / "three.skyc",
        _show(reference, _trajectory(_STRAIGHT), late),
        {"drones/drone 0/trajectory.json": _trajectory(_CURVED), "drones/drone 0/lights.json": {}},
    )


def test_places_at_a_time_are_those_of_the_curves(show: Path) -> None:
    curve = BPoly(np.array([[0, 0, 2], [2, 0, 2], [5, -1, 4], [6, 3, 2]], dtype=float)[:, None], [4.0, 10.0])
    for at_s, expected in (
        (0.0, [[0, 0, 0], [0, 2, 0], [4, 4, 0]]),
        (2.0, [[0, 0, 1], [0, 2, 1], [4, 4, 0]]),
        (6.0, [curve(6.0), [0, 2, 3], [4, 4, 1]]),  # the last one takes off at 5 s
        (1e3, [[6, 3, 2], [0, 2, 4], [4, 4, 2]]),
    ):
        assert read_skyc(show, at_s) == pytest.approx(np.array(expected, dtype=float))


def test_a_moment_of_a_show_becomes_a_formation_file(
    show: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(show.parent)
    typed = ["new", "formation", show.name, "--at", "6", "--graph", "complete", "--json"]
    code, out, _ = gs(typed, monkeypatch, capsys)
    made = json.loads(out.splitlines()[-1])
    assert (code, made["file"], made["n"]) == (0, "three.yaml", 3)
    assert np.array_equal(load_formation(Path("three.yaml")).points_enu_m, read_skyc(show, 6.0))


_REFERENCE = {"$ref": "./drones/x.json#"}


@pytest.mark.parametrize(
    ("content", "members", "typed", "answer"),
    [
        (b"{", {}, "", "show.json: is not JSON"),
        ({}, {}, "", "show.json: swarm.drones is missing"),
        (_show(_trajectory(_STRAIGHT)), {}, "", "swarm.drones: has 1 drones"),
        (_show(_REFERENCE, _REFERENCE), {}, "", "has no ./drones/x.json"),
        (_show({"$ref": "../../etc/passwd"}, {}), {}, "", "has no ../../etc/passwd"),
        (_show({"version": 2}, {}), {}, "", "swarm.drones[0]: is no trajectory of version 1"),
        (_show(_trajectory([]), {}), {}, "", "expected a list that is not empty"),
        (_show(_trajectory([[0, [0, 0]]]), {}), {}, "", "points[0]: expected [t, [x, y, z]"),
        (_show(_trajectory([[0, [0, 0, 1e400]]]), {}), {}, "", "points[0]: expected [t, [x, y, z]"),
        (_show(_REFERENCE, {}), {"drones/x.json": _trajectory([[1, [0, 0, 0]], [1, [1, 0, 0]]])}, "--at 5",
         "./drones/x.json: points[1]: time does not go on"),
        (_show(*[_trajectory(_STRAIGHT)] * 2), {}, "", "two drones are in one place at 0 s; choose another time"),
        (_show(*[_trajectory(_STRAIGHT)] * 2), {}, "--at -1", "--at -1: must be 0 to"),
        (None, {}, "", "is no .skyc file: File is not a zip file"),
    ],
)  # fmt: skip
def test_what_is_no_show_is_refused_in_words(
    content: Any,
    members: dict[str, Any],
    *,
    typed: str,
    answer: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "bad.skyc"
    if content is None:
        path.write_bytes(b"x" * 100)
    else:
        _write(path, content, members)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        code, _, err = gs(["new", "formation", "bad.skyc", *typed.split()], patch, capsys)
    assert (code, answer in " ".join(err.split())) == (2, True), err
    assert not list(tmp_path.glob("*.yaml"))


def test_a_show_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    path = _write(tmp_path / "bomb.skyc", b" " * (33 << 20), {})
    assert path.stat().st_size < 1 << 20
    with pytest.raises(UserError, match="33 MB unpacked, limits 32 MB"):
        read_skyc(path, 0.0)


def test_a_time_is_of_shows_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = gs(["new", "formation", "ring", "-n", "4", "--at", "3"], monkeypatch, capsys)
    assert (code, "--at 3: is the time of a .skyc show" in err) == (2, True)
