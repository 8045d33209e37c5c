"""``gs check`` as people use it: over sockets, with ``--fix``, and for missions that do not fit themselves."""

from __future__ import annotations

import json
import socket
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

import pytest

from groundstation.app.emulator import world_config
from sitl.server import Server
from tests.app.flights import pair
from tests.app.test_cli import _gs


def test_fix_sets_what_a_check_before_has_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "170")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    config = world_config(pair(autopilots=("px4", "px4")))
    config = replace(config, vehicles=tuple(replace(vehicle, params=()) for vehicle in config.vehicles))
    links = [f"vehicles.{number}.link=udpin://127.0.0.1:{port}" for number in (0, 1)]
    changes = [argument for change in links for argument in ("--set", change)]
    arguments = ["check", "--mission", "first_flight2.yaml", "--json", *changes]
    stop = Event()
    with Server(config, 1, port=port) as server:
        thread = Thread(target=server.run, args=(stop,), daemon=True)
        thread.start()
        try:
            refused = _gs(arguments, monkeypatch, capsys)
            fixed = _gs([*arguments, "--fix"], monkeypatch, capsys)
        finally:
            stop.set()
            thread.join()
    code, out, err = refused
    values = json.loads(out.splitlines()[-1])
    assert (code, values["ready"]) == (3, False)
    assert [row["ready"] for row in values["vehicles"]] == [False, False]
    assert "NAV_DLL_ACT is 0" in values["vehicles"][1]["problems"][0]
    assert "nothing was armed" in err
    assert "`gs check --fix` sets" in err
    code, out, err = fixed
    values = json.loads(out.splitlines()[-1])
    assert (code, values["ready"], values["problems"]) == (0, True, [])
    assert [row["failsafe"] for row in values["vehicles"]] == ["as planned", "as planned"]
    assert any("NAV_DLL_ACT from 0 to 3" in note for note in values["vehicles"][0]["notes"])
    assert values["failsafe"].startswith("when the ground station is gone: they hold for 20 s and land")
    assert "as planned" in err
    assert "px4 1.17.0 dev" in err
    assert all(pilot.params["NAV_DLL_ACT"] == 3 for pilot in server.world.autopilots)
    assert not server.world.truth.armed.any()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["gains=../gains/pyramid6.npz"], "gains"),
        (["avoidance.radius_m=1.2", "avoidance.activation_m=1.3"], "minimum is 1.2 m (avoidance.radius_m)"),
        (["fence.max_m=[0.5,0.5,3]"], "fence"),
        (["vehicles.1.pad_m=[-1,-0.8,0]"], "minimum is 0.45 m (avoidance.radius_m)"),
        (["vehicles.1.id=1"], "is the id of vehicles[0] too"),
    ],
)
def test_a_mission_that_does_not_fit_itself_is_refused(
    changes: list[str], words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [argument for change in changes for argument in ("--set", change)]
    code, out, err = _gs(["check", "--mission", "cube8.yaml", "--json", *arguments], monkeypatch, capsys)
    assert code == 3
    values = json.loads(out.splitlines()[-1])
    assert (values["mission"], values["ready"], values["vehicles"]) == ("cube8", False, [])
    assert words in values["problems"][0]
    assert "nothing was armed" in err


@pytest.mark.parametrize(
    "arguments",
    [
        ["--mission", "nowhere.yaml"],
        ["--mission", "cube8.yaml", "--set", "wings=2"],
        ["--mission", "cube8.yaml", "--set", "failsafe.action=pray"],
        ["--mission", "cube8.yaml", "--set", "failsafe.hold_s=3"],
    ],
    ids=" ".join,
)
def test_what_cannot_be_read_is_wrong_usage(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = _gs(["check", *arguments], monkeypatch, capsys)
    assert code == 2
    assert err.strip()
