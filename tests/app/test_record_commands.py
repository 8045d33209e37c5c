from __future__ import annotations

import json
import socket
import struct
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from groundstation.app.commands.import_ import import_
from groundstation.app.commands.replay import replay
from groundstation.app.commands.report import report
from groundstation.app.replaying import parse_target, stream
from groundstation.app.verify import VerifyResult
from groundstation.core.errors import MissionFailed, UserError
from groundstation.mavlink.codec import Encoder
from groundstation.records.notes import Received
from groundstation.records.tlog import TlogReader, TlogWriter, read_tlog

EPOCH_US = 1_577_836_800_000_000
APP = typer.Typer()
for name, function in (("import", import_), ("replay", replay), ("report", report)):
    APP.command(name)(function)

CSV = {
    "time_stamp.csv": "h\n1541003533.25\n1541003533.75\n",
    "positions.csv": "h\n0,0,1,1,0,1\n0,0,1,0.5,0,1\n",
    "control_velocity.csv": "h\n0,0,0,0,0,0\n0,0,0,0,0,0\n",
    "permutations.csv": "h\n1,0,0,1\n1,0,0,1\n",
    "stopFlag.csv": "h\n0,0\n0,0\n",
    "stopFlag_old.csv": "h\n0,0\n0,0\n",
}


def run(*arguments: str) -> dict[str, Any]:
    """Runs a command with --json; returns what its last line of stdout says, raises what it raised."""
    result = CliRunner().invoke(APP, [*arguments, "--json"])
    if isinstance(result.exception, UserError):
        raise result.exception
    assert result.exit_code == 0, result.output
    values: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    return values


@pytest.fixture
def log(tmp_path: Path) -> Path:
    folder = tmp_path / "csv"
    folder.mkdir()
    for name, text in CSV.items():
        (folder / name).write_text(text)
    values = run("import", "crazyswarm", str(folder), "-o", str(tmp_path / "flight.tlog"))
    assert values["log"] == str(tmp_path / "flight.tlog")
    assert (values["vehicles"], values["samples"], values["duration_s"]) == (2, 2, 0.5)
    assert values["min_distance_m"] == 0.5
    return tmp_path / "flight.tlog"


def test_replay_answers_with_the_figures_of_the_log(log: Path) -> None:
    assert run("replay", str(log)) == {
        "vehicles": 2,
        "samples": 2,
        "duration_s": 0.5,
        "min_distance_m": 0.5,
        "notes": [],
    }


def test_report_writes_its_files(log: Path, tmp_path: Path) -> None:
    values = run("report", str(log), "-o", str(tmp_path / "pictures"))
    assert len(values["files"]) == 5
    assert all(Path(file).is_file() for file in values["files"])


def test_truncated_log_is_read_and_told(log: Path) -> None:
    log.write_bytes(log.read_bytes()[:-3])
    result = CliRunner().invoke(APP, ["replay", str(log)])
    assert isinstance(result.exception, MissionFailed)
    assert "bytes are no whole record" in str(result.exception)
    assert "vehicles" in result.stdout


@pytest.mark.parametrize("command", ["replay", "report"])
def test_missing_and_empty_logs_are_told(command: str, tmp_path: Path) -> None:
    more = ["-o", str(tmp_path / "out")] if command == "report" else []
    with pytest.raises(UserError, match="no such log"):
        run(command, str(tmp_path / "none.tlog"), *more)
    (tmp_path / "empty.tlog").touch()
    with pytest.raises(UserError, match="empty"):
        run(command, str(tmp_path / "empty.tlog"), *more)


def test_import_of_a_missing_folder_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such folder"):
        run("import", "crazyswarm", str(tmp_path / "none"), "-o", str(tmp_path / "flight.tlog"))
    assert list(tmp_path.iterdir()) == []


def test_verify_adds_its_figures_and_fails_on_a_mismatch(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = VerifyResult(ticks=5, setpoints=40, mismatches=0, max_error_m_s=0.0)
    monkeypatch.setattr("groundstation.app.verify.verify_log", lambda path, source: good)
    values = run("replay", str(log), "--verify")
    assert {key: values[key] for key in ("ticks", "setpoints", "mismatches", "max_error_m_s")} == {
        "ticks": 5,
        "setpoints": 40,
        "mismatches": 0,
        "max_error_m_s": 0.0,
    }
    bad = VerifyResult(ticks=5, setpoints=40, mismatches=2, max_error_m_s=0.25)
    monkeypatch.setattr("groundstation.app.verify.verify_log", lambda path, source: bad)
    with pytest.raises(MissionFailed, match=r"2 frames differ .* by up to 0\.25 m/s"):
        run("replay", str(log), "--verify")


def test_stream_sends_received_frames_at_the_recorded_pace() -> None:
    log = b""
    for t_us, sysid in ((1_000_000, 1), (1_200_000, 255), (1_500_000, 2)):
        log += struct.pack(">Q", EPOCH_US + t_us) + Encoder(sysid).encode("HEARTBEAT", type=2)
    happened: list[bytes | int] = []
    assert stream(TlogReader(log), lambda _: True, happened.append, happened.append, speed=2.0) == 2
    assert happened == [
        0,
        Encoder(1).encode("HEARTBEAT", type=2),
        250_000_000,
        Encoder(2).encode("HEARTBEAT", type=2),
    ]


def test_replay_to_a_program_that_listens(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    with TlogWriter(path, EPOCH_US) as writer:
        for sysid in (1, 2, 3):
            writer.received(0, "p", Encoder(sysid).encode("HEARTBEAT", type=2), 0)
            writer.sent(Encoder(255, 190).encode("HEARTBEAT", type=6), 0)
    expected = [record.frame.raw for record in read_tlog(path) if isinstance(record, Received)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(5)
        port = listener.getsockname()[1]
        assert run("replay", str(path), "--to", f"udpout://127.0.0.1:{port}")["frames"] == 3
        assert [listener.recv(300) for _ in range(3)] == expected


def test_targets() -> None:
    assert parse_target("udpout://127.0.0.1:14550") == ("127.0.0.1", 14550)
    assert parse_target("udpout://[::1]:9") == ("::1", 9)
    for url in ("127.0.0.1:14550", "udpin://0.0.0.0:1", "udpout://host", "udpout://host:99999", "udpout://:5", "x://["):
        with pytest.raises(UserError, match="expected udpout://HOST:PORT"):
            parse_target(url)


@pytest.mark.parametrize("speed", ["0", "-1", "nan", "inf"])
def test_speeds_that_make_no_sense_are_told(log: Path, speed: str) -> None:
    with pytest.raises(UserError, match="--speed"):
        run("replay", str(log), "--speed", speed)
