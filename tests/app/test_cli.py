"""The command line as people and scripts use it: JSON, exit codes, messages, files."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from groundstation.app import cli
from groundstation.app.output import Output, flush_streams, hold_streams, to_json
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, decode, encode_batch
from tests.app.commands import gs

FLY_KEYS = {
    "mission", "outcome", "reason", "vehicles", "converged", "time_to_form_s", "formation_error_m", "min_distance_m",
    "min_clearance", "safety_radius_m", "gridlocks", "role_swaps", "wind_mean_m_s", "wind_gust_m_s",
    "setpoints", "ticks", "deadline_misses", "tick_late_ms", "tick_work_ms", "telemetry_to_setpoint_ms",
    "duration_s", "wall_s", "log", "log_complete", "seed",
}  # fmt: skip

SHORT = ["--set", "steps.1.hold.seconds=1", "--set", "rate_hz=10"]
TWO = ["fly", "--mission", "first_flight2.yaml", "--dry-run", *SHORT]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The folder with the log and the manifest of ``TWO``, flown once, and what it answered."""
    folder, answer = tmp_path_factory.mktemp("flown"), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(answer):
        patch.setattr(sys, "argv", ["gs", *TWO, "--json", "--log", str(folder / "a.tlog")])
        with contextlib.suppress(SystemExit):
            cli.main()
    return folder, json.loads(answer.getvalue().splitlines()[-1])


@pytest.fixture
def in_a_copy(flown: tuple[Path, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The working directory has copies of both; the answer."""
    folder, answer = flown
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return answer


def test_a_dry_run_answers_in_json_and_its_log_verifies_to_the_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    fly = ["fly", "--mission", "cube8.yaml", "--dry-run", "--set", "rate_hz=25", "--seed", "7", "--json"]
    code, out, _ = gs(fly, monkeypatch, capsys)
    assert code == 0
    values = json.loads(out.splitlines()[-1])
    assert set(values) == FLY_KEYS
    assert (values["outcome"], values["vehicles"], values["seed"]) == ("completed", 8, 7)
    assert values["log_complete"] is True
    assert values["formation_error_m"] <= 0.05
    assert values["min_distance_m"] >= values["safety_radius_m"] == 0.45

    code, out, _ = gs(["replay", values["log"], "--verify", "--json"], monkeypatch, capsys)
    assert code == 0
    replayed = json.loads(out.splitlines()[-1])
    assert (replayed["mismatches"], replayed["max_error_m_s"]) == (0, 0.0)
    assert replayed["setpoints"] == values["setpoints"] > 1000
    assert replayed["ticks"] == values["ticks"]

    # A log in which one bit of one setpoint was changed no longer verifies.
    log = Path(values["log"])
    data = bytearray(log.read_bytes())
    marker = data.index(bytes([255, 190, 84, 0, 0]), len(data) // 2)
    data[marker + 8] ^= 1
    log.write_bytes(bytes(data))
    code, out, err = gs(["replay", str(log), "--verify", "--json"], monkeypatch, capsys)
    assert code == 1
    assert json.loads(out.splitlines()[-1])["mismatches"] >= 1
    assert "Traceback" not in err


def test_preflight_that_fails_ends_with_3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    links = [f"vehicles.{number}.link=udpin://127.0.0.1:0" for number in range(8)]
    changes = [argument for change in ["limits.preflight_s=0.5", *links] for argument in ("--set", change)]
    code, out, err = gs(["fly", "--mission", "cube8.yaml", "--json", *changes], monkeypatch, capsys)
    assert code == 3
    values = json.loads(out.splitlines()[-1])
    assert values["outcome"] == "aborted"
    assert values["setpoints"] == 0
    assert "nothing was armed" in err
    assert "vehicle 8: no heartbeat" in err
    code, out, err = gs(["check", "--mission", "cube8.yaml", "--json", *changes], monkeypatch, capsys)
    assert code == 3
    assert json.loads(out.splitlines()[-1])["ready"] is False


@pytest.mark.parametrize(
    "arguments",
    [
        ["fly"],
        ["fly", "--mission"],
        ["fly", "--bogus"],
        ["fly", "--mission", "nowhere.yaml", "--dry-run"],
        ["fly", "--mission", "cube8.yaml", "--dry-run", "--seed", "-1"],
        ["fly", "--mission", "cube8.yaml", "--dry-run", "--set", "wings=2"],
        ["fly", "--mission", "cube8.yaml", "--dry-run", "--log", "log.txt"],
        ["fly", "--mission", "cube8.yaml", "--realtime"],
        ["replay", "nowhere.tlog"],
        ["report", "nowhere.tlog", "-o", "out"],
        ["import", "crazyswarm", "nowhere", "-o", "x.tlog"],
        ["design", "nowhere.yaml"],
        ["sitl", "--vehicles", "0"],
        ["sitl", "--vehicles", "2", "--autopilot", "kite"],
        ["dance"],
    ],
    ids=" ".join,
)
def test_wrong_usage_ends_with_2_and_a_message(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = gs(arguments, monkeypatch, capsys)
    assert code == 2
    assert err.strip()
    assert "Traceback" not in out + err
    assert not list(tmp_path.glob("*.tlog"))


def test_a_truncated_log_is_read_up_to_its_last_whole_frame_and_says_so(
    in_a_copy: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert in_a_copy["outcome"] == "completed"
    whole = Path("a.tlog").read_bytes()
    code, out, _ = gs(["replay", "a.tlog", "--verify", "--json"], monkeypatch, capsys)
    assert (code, json.loads(out.splitlines()[-1])["complete"]) == (0, True)
    Path("a.tlog").write_bytes(whole[: len(whole) * 2 // 3 + 5])
    for arguments in (["replay", "a.tlog", "--verify", "--json"], ["replay", "a.tlog", "--json"]):
        code, out, err = gs(arguments, monkeypatch, capsys)
        values = json.loads(out.splitlines()[-1])
        assert code == 1
        assert values["vehicles"] == 2
        assert values.get("mismatches", 0) == 0
        assert not values.get("complete", False)
        assert "no whole record" in err
        assert "Traceback" not in err
    # Cut between two records: nothing shows it but the manifest, which knows how long the flight was.
    Path("a.tlog").write_bytes(whole[: whole.rindex(bytes([255, 190, 129, 1, 0]), 0, len(whole) // 2) - 5 - 8])
    code, out, err = gs(["replay", "a.tlog", "--verify", "--json"], monkeypatch, capsys)
    assert (code, json.loads(out.splitlines()[-1])["complete"]) == (1, False)
    assert "ends before the flight does" in err
    Path("a.tlog").write_bytes(b"")
    code, _, err = gs(["replay", "a.tlog", "--json"], monkeypatch, capsys)
    assert code == 2
    assert "is empty" in err


@pytest.mark.usefixtures("in_a_copy")
def test_a_command_that_was_changed_in_the_log_is_found_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    data = Path("a.tlog").read_bytes()
    start = data.index(bytes([255, 190, 76, 0, 0])) - 5
    (command,) = FrameSplitter().feed(data[start : start + 12 + data[start + 1]])
    assert isinstance(command, Frame)
    values = decode([command])[0].values.copy()
    values["param2"] += 1.0
    (forged,) = encode_batch("COMMAND_LONG", values, [Encoder(255, 190, seq=command.seq)])
    Path("a.tlog").write_bytes(data.replace(command.raw, forged, 1))
    code, out, _ = gs(["replay", "a.tlog", "--verify", "--json"], monkeypatch, capsys)
    assert (code, json.loads(out.splitlines()[-1])["mismatches"]) == (1, 1)


def test_with_json_even_a_refusal_is_an_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = gs(["fly", "--mission", "nowhere.yaml", "--json"], monkeypatch, capsys)
    values = json.loads(out.splitlines()[-1])
    assert (code, values["exit_code"]) == (2, 2)
    assert "nowhere.yaml: no such file" in values["error"]
    assert values["error"] in err


def test_the_version_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = gs(["--version"], monkeypatch, capsys)
    assert (code, out.split()[0]) == (0, "gs")


def test_the_log_of_a_real_flight_is_never_written_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "precious.tlog"
    log.write_bytes(b"precious")
    code, _, err = gs(["fly", "--mission", "cube8.yaml", "--dry-run", "--log", str(log)], monkeypatch, capsys)
    assert code == 2
    assert "exists, and is not what this command would make again" in " ".join(err.split())
    assert log.read_bytes() == b"precious"
    code, _, err = gs(["import", "crazyswarm", str(tmp_path), "-o", str(log)], monkeypatch, capsys)
    assert code == 2
    assert log.read_bytes() == b"precious"


def test_the_overview_names_every_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = gs(["--help"], monkeypatch, capsys)
    assert code == 0
    for name in cli.COMMANDS:
        assert f"  {name} " in out
        assert gs([name, "--help"], monkeypatch, capsys)[0] == 0


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (["fly", "--json"], "--mission: is missing: mission file"),
        (["fly", "--mission", "cube8", "--dryrun", "--json"], "--dryrun: unknown option, did you mean --dry-run?"),
        (["fly", "--mission", "cube8", "--seed", "x", "--json"], "--seed"),
        (["fyl", "--json"], "gs fyl: unknown, did you mean fly?"),
        (["sitl", "--port", "x", "--json"], "--port"),
        (["sitl", "--noise", "x", "--json"], "--noise: 'x' is unknown"),
        (["design", "--json"], "FORMATION"),
        (["missions", "extra", "--json"], "extra"),
    ],
)
def test_wrong_usage_is_answered_in_json_too(
    words: list[str], answer: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = gs(words, monkeypatch, capsys)
    values = json.loads(out.splitlines()[-1])
    assert (code, values["exit_code"]) == (2, 2)
    assert answer.lower() in values["error"].lower()
    assert err
    assert "Traceback" not in err


def test_an_emulator_tells_what_it_sent_when_it_ends(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sitl.server.Server.run", lambda server, stop, look: None)  # Ctrl-C at once
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        code, out, _ = gs(["sitl", "--vehicles", "2", "--port", "14987", "--json"], monkeypatch, capsys)
    finally:
        for number, handler in zip((signal.SIGINT, signal.SIGTERM), before, strict=True):
            signal.signal(number, handler)
    values = json.loads(out.splitlines()[-1])
    assert (code, values["vehicles"], values["datagrams_sent"]) == (0, 2, 0)


def test_ctrl_c_in_a_command_is_a_word_and_an_answer(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def struck(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("groundstation.design.store.load_formation", struck)
    code, out, err = gs(["design", "cube8", "--json"], monkeypatch, capsys)
    assert (code, err) == (130, "gs: stopped by Ctrl-C\n")
    assert json.loads(out)["exit_code"] == 130


def test_json_is_strict() -> None:
    assert json.loads(to_json({"a": float("nan"), "b": [1.0, float("inf")], "c": "x"})) == {
        "a": None,
        "b": [1.0, None],
        "c": "x",
    }


def test_flying_does_not_load_what_only_reports_and_designs_need() -> None:
    code = (
        "import sys, groundstation.app.commands.fly, groundstation.app.flying;"
        "print([name for name in ('matplotlib', 'cvxpy', 'clarabel', 'mavsdk') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_timetable_of_faults_goes_with_a_dry_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("faults.yaml").write_text("faults:\n  - {kind: arming_refused, vehicles: [4]}\n", encoding="utf-8")
    fly = ["fly", "--mission", "cube8.yaml", "--dry-run", "--json", "--set", "limits.preflight_s=5"]
    code, out, _ = gs([*fly, "--faults", "faults.yaml"], monkeypatch, capsys)
    values = json.loads(out.splitlines()[-1])
    assert (code, values["outcome"], values["setpoints"]) == (3, "aborted", 0)
    assert values["reason"].startswith("vehicle 4: not ready to arm")
    for text, message in (
        ("faults: [{kind: gremlins}]", "faults.yaml: faults[0].kind: 'gremlins' is unknown"),
        ("faults: [{kind: reboot, vehicles: [99]}]", "99"),
        ("faults: [", "is no YAML"),
    ):
        Path("faults.yaml").write_text(text, encoding="utf-8")
        code, _, err = gs([*fly, "--faults", "faults.yaml"], monkeypatch, capsys)
        assert code == 2, text
        assert message in err
    code, _, err = gs(["fly", "--mission", "cube8.yaml", "--faults", "faults.yaml"], monkeypatch, capsys)
    assert code == 2
    assert "faults are for a dry run" in err


def test_a_flight_by_gps_can_be_looked_at_like_any_other(
    in_a_copy: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    true_m = in_a_copy["min_distance_m"]
    code, out, _ = gs(["replay", "a.tlog", "--verify", "--json"], monkeypatch, capsys)
    values = json.loads(out.splitlines()[-1])
    assert (code, values["mismatches"]) == (0, 0)
    assert values["min_distance_m"] == pytest.approx(true_m, abs=1.0)  # what GPS says, not what is


@pytest.mark.parametrize(
    ("closed", "arguments", "code"),
    [
        (">&-", ["check", "--mission", "nowhere.yaml"], 2),
        ("<&- >&- 2>&-", ["check", "--mission", "nowhere.yaml", "--json"], 2),
        (">&-", ["command"], 0),
    ],
)
def test_streams_that_were_closed_before_it_began_change_no_exit_code(
    closed: str, arguments: list[str], code: int, tmp_path: Path
) -> None:
    program = "import sys; from groundstation.app.cli import main; sys.argv[0] = 'gs'; main()"
    done = subprocess.run(
        ["/bin/sh", "-c", f'exec "$@" {closed}', "sh", sys.executable, "-c", program, *arguments],
        capture_output=True,
        env={**os.environ, "HOME": str(tmp_path), "XDG_RUNTIME_DIR": ""},
        check=False,
    )
    assert (done.returncode, done.stdout) == (code, b"")
    assert b"Traceback" not in done.stderr


def test_streams_that_are_none_are_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    flush_streams()
    Output(as_json=True).console.on_broken_pipe()
    hold_streams()
    sys.stdout.write("to nowhere")
    assert sys.stdout.name == sys.stderr.name == os.devnull
