"""A disk that is full: before takeoff nobody is armed, in the air the flight goes on; either way it is told."""

from __future__ import annotations

import contextlib
import errno
import io
import json
from pathlib import Path
from typing import Any

import pytest

from groundstation.app.emulator import world_config
from groundstation.app.loop import Interrupts, fly_virtual
from groundstation.app.session import Session
from groundstation.mission.purpose import Purpose
from groundstation.mission.runner import Phase, Runner
from groundstation.records import recording
from groundstation.records.tlog import TlogWriter
from sitl.world import World
from tests.app.commands import gs
from tests.app.flights import pair


class FillingDisk(io.BytesIO):
    """Takes everything until it is full."""

    full = False

    def write(self, data: Any, /) -> int:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)


class Watched:
    """A dry run whose disk fills up when the flight is in a phase, and has been there for some ticks."""

    def __init__(self, phase: Phase, ticks: int, *, take_over: bool = False, limit_s: float = 20.0) -> None:
        plan = pair()
        world = World(world_config(plan, 1), 1)
        disk = FillingDisk()
        self.session = Session(Runner(plan, 0, Purpose.TAKE_OVER if take_over else Purpose.FLY), TlogWriter(disk, 0))
        self.runner = self.session.runner
        self.told: list[str] = []
        self.ever_armed = False
        left = ticks

        def watch(session: Session, now_ns: int) -> None:
            nonlocal left
            left -= session.runner.phase is phase
            disk.full |= left < 0
            self.told += [note.text for note in session.take_notes() if "recording stopped" in note.text]
            self.ever_armed |= bool(world.truth.armed.any())
            if now_ns >= limit_s * 1e9:
                raise TimeoutError

        with contextlib.suppress(TimeoutError):
            fly_virtual(self.session, world, period_ns=50_000_000, watchers=(watch,), interrupts=Interrupts())


@pytest.mark.parametrize("ticks", [0, 30, 69])
def test_a_disk_that_fills_up_during_preflight_arms_nobody(ticks: int) -> None:
    flight = Watched(Phase.CONNECT, ticks)
    assert flight.runner.phase is Phase.DONE
    assert flight.runner.outcome == "aborted"
    assert not flight.ever_armed
    assert flight.told == ["log: recording stopped: No space left on device; nobody takes off without a log"]
    assert "No space left" in flight.session.unlogged
    assert not flight.session.armed_unlogged


def test_one_that_fills_up_while_the_team_is_arming_ends_the_flight_before_takeoff() -> None:
    flight = Watched(Phase.ARM, 0)
    assert flight.runner.outcome == "aborted"
    assert flight.session.armed_unlogged
    assert flight.runner.figures.ticks < 400


def test_in_the_air_the_flight_goes_on() -> None:
    flight = Watched(Phase.TAKEOFF, 0, limit_s=10.0)
    assert flight.runner.phase is Phase.TAKEOFF
    assert flight.told == ["log: recording stopped: No space left on device; the flight goes on without a log"]
    assert flight.session.unlogged == ""


def test_a_take_over_needs_no_disk() -> None:
    flight = Watched(Phase.TAKEOVER, 0, take_over=True, limit_s=4.0)
    assert flight.runner.phase is Phase.TAKEOVER
    assert flight.told == ["log: recording stopped: No space left on device; the flight goes on without a log"]


def test_the_command_says_that_nothing_was_armed_and_that_the_log_is_not_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    disk = FillingDisk()
    disk.full = True
    monkeypatch.setattr(recording, "LogFile", lambda path, descriptor: disk)
    arguments = ["fly", "--mission", "first_flight2.yaml", "--dry-run", "--log", str(tmp_path / "a.tlog"), "--json"]
    code, out, err = gs(arguments, monkeypatch, capsys)
    values = json.loads(out.splitlines()[-1])
    assert (code, values["outcome"], values["setpoints"], values["log_complete"]) == (3, "aborted", 0, False)
    assert "No space left on device; nobody takes off without a log, make room" in values["reason"]
    assert "nothing was armed" in err
    assert "the log is not complete" in err
