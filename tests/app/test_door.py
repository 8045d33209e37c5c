"""A new user's first minutes: names of files and keys, what comes along, a folder of one's own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from groundstation.app.cli import COMMANDS
from groundstation.app.resources import find_config
from groundstation.core.errors import UserError
from tests.app.commands import gs

ROOT = Path(__file__).parents[2]


def test_a_mission_may_be_named_without_its_suffix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_config(Path("cube8"), "missions").name == "cube8.yaml"
    (tmp_path / "cube8.yaml").write_text("name: mine\n")
    assert find_config(Path("cube8"), "missions") == Path("cube8.yaml")  # one's own comes first


@pytest.mark.parametrize("name", ["cubee8", "cubee8.yaml", "folder/cube_8.yml"])
def test_a_mission_that_is_not_there_is_answered_with_the_nearest(name: str) -> None:
    with pytest.raises(UserError, match=r"no such file, the nearest name is cube8; name one .* first_flight2"):
        find_config(Path(name), "missions")


@pytest.mark.parametrize(
    ("change", "answer"),
    [
        ("speed_limit=1", "speed_limit: unknown key, did you mean speed_limit_m_s?"),
        ("avoidance.radius=1", "avoidance.radius: unknown key, did you mean radius_m?"),
        ("vehicles.0.pad=[0, 0, 0]", "vehicles[0].pad: unknown key, did you mean pad_m?"),
        ("limits.batery_min=1", "limits.batery_min: unknown key, did you mean battery_min?"),
        ("steps=[{hold: {second: 1}}]", "hold.second: unknown key, did you mean seconds?"),
        ("xyzzy=1", "xyzzy: unknown key, remove it or correct its spelling"),
    ],
)
def test_an_unknown_key_is_answered_with_the_one_that_was_meant(
    change: str, answer: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = gs(["check", "--mission", "first_flight2", "--set", change], monkeypatch, capsys)
    assert code == 2
    assert answer in err


def test_what_comes_along_is_listed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = gs(["missions", "--json"], monkeypatch, capsys)
    listed = {row["name"]: row for row in json.loads(out.splitlines()[-1])["missions"]}
    assert code == 0
    assert listed["first_flight2"]["vehicles"] == 2
    assert all(row["about"].endswith(".") and Path(row["file"]).is_file() for row in listed.values())


@pytest.mark.parametrize("like", ["cube8", "sequence8", "mixed8", "arducopter_two_squares8", "first_flight2"])
def test_a_folder_of_ones_own_loads_as_it_is(
    like: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from groundstation.mission.plan.reading import load_mission

    monkeypatch.chdir(tmp_path)
    code, out, _ = gs(["init", "mine", "--like", like, "--json"], monkeypatch, capsys)
    assert code == 0
    made = json.loads(out.splitlines()[-1])
    plan = load_mission(Path(made["mission"]))
    assert (plan.spec.name, plan.size) == ("mine", 2 if like == "first_flight2" else 8)
    assert {path.name for path in Path("mine").iterdir()} == set(made["files"])

    before = {path: path.read_bytes() for path in Path("mine").iterdir()}
    code, _, err = gs(["init", "mine"], monkeypatch, capsys)
    assert (code, "is there already" in err) == (2, True)
    assert {path: path.read_bytes() for path in Path("mine").iterdir()} == before


@pytest.mark.parametrize("name", ["../..", "", "a b", "-x/ y"])
def test_a_name_that_no_mission_can_have_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = gs(["init", "--", name], monkeypatch, capsys)
    assert (code, "letters, digits" in err) == (2, True)
    assert not list(tmp_path.iterdir())


def test_little_is_loaded_before_ctrl_c_is_looked_after() -> None:
    code = "import sys; old = set(sys.modules); import groundstation.__main__; print(*sorted(set(sys.modules) - old))"
    done = subprocess.run([sys.executable, "-S", "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = [name for name in done.stdout.split() if not name.startswith("groundstation")]
    assert "typing" not in loaded
    assert len(loaded) < 20, loaded


_HEAVY = "numpy", "scipy", "cvxpy", "pydantic", "matplotlib", "yaml", "pymavlink", "sitl"


def test_no_command_loads_what_it_works_with_before_it_is_called() -> None:
    code = (
        "import sys; from groundstation.app.cli import COMMANDS, build\n"
        f"for name in COMMANDS:\n    build(name); print(name, [name for name in {_HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [f"{name} []" for name in COMMANDS]


@pytest.mark.parametrize(
    ("line", "goes_on"),
    [("gs ", "fly"), ("gs fly --", "--dry-run"), ("gs design --m", "--method"), ("gs campaign --", "--runs")],
)
def test_a_shell_is_told_how_a_line_goes_on(line: str, goes_on: str) -> None:
    words = line.split()
    typed = "" if line.endswith(" ") else words[-1]
    asked = {"_GS_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - bool(typed))}
    done = subprocess.run(
        [sys.executable, "-m", "groundstation"], capture_output=True, text=True, check=True, env=os.environ | asked
    )
    found = done.stdout.split()
    assert found
    assert all(word.startswith(typed) for word in found)
    assert {"gs ": "fly", "gs fly --": "--dry-run", "gs design --m": "--method", "gs campaign --": "--runs"}[
        line
    ] in found


def test_what_an_option_lists_is_what_there_is() -> None:
    from groundstation.app.commands import design, mocap, sitl, sitl_env
    from groundstation.app.real_sitl import HOME
    from groundstation.design.designer import METHODS
    from groundstation.mocap.bodies import LINK
    from sitl.personalities import PERSONALITIES

    assert tuple(METHODS) == design._METHODS
    assert mocap._LINK == LINK
    assert sitl.personality_names() == sorted(PERSONALITIES)
    assert ",".join(map(str, HOME)) == sitl_env._HOME


def test_the_program_has_a_second_name() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "groundstation", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("gs ")


@pytest.fixture
def door(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module of the entry point, loaded on Windows: elsewhere it would take Ctrl-C from pytest."""
    monkeypatch.setattr(sys, "platform", "win32")
    yield import_module("groundstation.__main__")
    sys.modules.pop("groundstation.__main__")


def test_windows_is_told_where_the_program_runs(door: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        door.main()
    assert ended.value.code == 2
    assert "WSL 2" in capsys.readouterr().err
