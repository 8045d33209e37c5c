"""Shells are told how a line goes on after an option, too, in bash, zsh and fish, and do not wait for it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from groundstation.app import completing
from groundstation.app.completing import files
from groundstation.design.common_shapes import SHAPES
from groundstation.design.graphs import SHARE
from groundstation.mission.operator import Order

_HEAVY = "numpy", "scipy", "cvxpy", "matplotlib", "pymavlink", "sitl"
_SAID: dict[str, tuple[float, list[str]]] = {}


def _asked(line: str, shell: str, folder: Path) -> str:
    """What the program answers a shell."""
    words = line.split(" ")
    asked = {
        "bash": {"COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)},
        "zsh": {"_TYPER_COMPLETE_ARGS": line},
        "fish": {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
    }[shell]
    done = subprocess.run(
        [sys.executable, "-m", "groundstation"],
        env=os.environ | asked | {"_GS_COMPLETE": f"complete_{shell}", "PYTHONPROFILEIMPORTTIME": "1"},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    loaded = {said.rpartition("|")[2].strip() for said in done.stderr.splitlines() if said.startswith("import time:")}
    assert len(loaded) > 10
    assert not loaded.intersection(_HEAVY), "whoever presses Tab waits for it"
    assert all(said.startswith("import time:") for said in done.stderr.splitlines())
    return done.stdout


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in (
        "mine.yaml",
        "flights/cube8-seed0.tlog",
        "flights/cube8-seed1.tlog",
        "old.tlog",
        "p.csv",
        "s.skyc",
        "x.md",
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    return tmp_path


_LINES = {
    "gs fly --mission ": {"cube8", "hello1", "mine.yaml", "flights/"},
    "gs fly --dry-run --mission cub": {"cube8"},
    "gs init x --like seq": {"sequence8"},
    "gs design pyr": {"pyramid5", "pyramid6"},
    "gs campaign --vary win": {"wind"},
    "gs command ": set(completing.ORDERS),
    "gs command la": {"land"},
    "gs command land ": {"all"},
    "gs command hold ": set[str](),
    "gs new ": {"formation", "law"},
    "gs new formation ": {*SHAPES, "p.csv", "s.skyc", "flights/"},
    "gs new formation ring --graph ": {"complete", "mesh", *SHARE},
    "gs report cube8-seed": {"cube8-seed0", "cube8-seed1"},
    "gs replay flights/": {"flights/cube8-seed0.tlog", "flights/cube8-seed1.tlog"},
    "gs compare old.tlog o": {"old.tlog"},
    "gs identify fli": {"flights/cube8-seed0.tlog", "flights/cube8-seed1.tlog"},
    "gs params di": {"diff"},
    "gs schema m": {"mission"},
    "gs bench flo": {"flood"},
    "gs sitl --autopilot p": {"px4"},
    "gs fly --mission cube8 --set limits.pose_": {"limits.pose_age_s=", "limits.pose_lost_s=", "limits.pose_jump_m="},
    "gs fly --mission cube8 --set lim": {"limits."},
    "gs campaign --set rat": {"rate_hz="},
    "gs fly --set nothing.x": set[str](),
}


@pytest.mark.parametrize("line", _LINES)
def test_a_line_goes_on_in_bash(line: str, folder: Path) -> None:
    found = {word for word in _asked(line, "bash", folder).splitlines() if word}
    expected = _LINES[line]
    assert expected <= found if line.endswith("mission ") else found == expected


@pytest.mark.parametrize(
    "line", ["gs fly --mission cub", "gs command la", "gs new formation rin", "gs report cube8-seed"]
)
def test_it_goes_on_in_zsh_and_fish_as_well(line: str, folder: Path) -> None:
    expected = _LINES.get(line) or {"gs fly --mission cub": {"cube8"}, "gs new formation rin": {"ring"}}[line]
    assert set(_asked(line, "fish", folder).split()) == expected
    zsh = _asked(line, "zsh", folder)
    assert zsh.startswith("_arguments '*: :((")
    assert {word.strip('"') for word in zsh.partition("((")[2].partition("))")[0].split("\n")} == expected


def test_words_that_are_offered_are_those_that_there_are() -> None:
    assert set(completing.ORDERS) == {order.value for order in Order}
    assert set(completing.SHAPES) == set(SHAPES)
    assert set(completing.GRAPHS) == set(SHARE)


def test_a_single_folder_goes_on_with_what_is_in_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    (folder / "deep/er").mkdir(parents=True)
    (folder / "deep/er/a.tlog").touch()
    assert files("de", (".tlog",)) == ["deep/er/a.tlog"]
    assert files("nowhere/", (".tlog",)) == []
    assert files("\0", (".tlog",)) == []
