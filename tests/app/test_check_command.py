"""``gs check`` as people use it: over sockets, with ``--fix``, and for missions that do not fit themselves."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

import pytest
from rich.console import Console

from groundstation.app.check_screen import show_rows
from groundstation.app.emulator import world_config
from groundstation.app.output import Output
from groundstation.mission.ground.check_table import CheckRow
from sitl.server import Server
from tests.app.commands import gs
from tests.app.flights import pair
from tests.sitl.served import free_udp_port


def test_fix_sets_what_a_check_before_has_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    port = free_udp_port()
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
            refused = gs(arguments, monkeypatch, capsys)
            fixed = gs([*arguments, "--fix"], monkeypatch, capsys)
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
    assert values["failsafe"].startswith("when the ground station is gone: they are asked to hold for 20 s and land")
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
    code, out, err = gs(["check", "--mission", "cube8.yaml", "--json", *arguments], monkeypatch, capsys)
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
    code, _, err = gs(["check", *arguments], monkeypatch, capsys)
    assert code == 2
    assert err.strip()


def _row(number: int) -> CheckRow:
    return CheckRow(
        id=number, role=number, link="udpin://0.0.0.0:14540", firmware="px4 1.17.0 dev", mode="AUTO.LOITER",
        heartbeat_age_s=0.5, estimator="good", position_age_s=0.02, off_pad_m=0.01, off_pad_limit_m=0.3,
        positions_hz=50.0, attitudes_hz=50.0, asked_hz=50.0, round_trip_s=0.004, clock_s=0.002, battery=0.97,
        battery_need=0.31, failsafe="as planned", checked=True, problems=("no",) if number == 2 else (), notes=(),
    )  # fmt: skip


@pytest.mark.parametrize("width", [80, 60, 120, 400])
def test_what_preflight_found_is_whole_at_any_width(width: int) -> None:
    text = io.StringIO()
    show_rows(Console(file=text, width=width), [_row(1), _row(2), _row(13)])
    shown = text.getvalue()
    assert "…" not in shown
    assert max(map(len, shown.splitlines())) <= width
    for words in ("px4 1.17.0 dev", "AUTO.LOITER", "0.01/0.30 m", "50+50/50 Hz", "±2 ms", "97/31 %", "as planned"):
        assert shown.count(words) == 3, words
    assert shown.count("not ready") == 1
    assert ("vehicle 13, role 13: ready" in shown) == (width < 200)


def test_a_pipe_gets_the_table_in_lines_as_long_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    show_rows(Output(as_json=False).console, [_row(13)])
    lines = capsys.readouterr().out.splitlines()
    assert len({len(line) for line in lines}) == 1
    assert len(lines) == 5
    assert "AUTO.LOITER" in lines[3]
