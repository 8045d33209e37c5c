"""``gs fly`` as a process over UDP, and what may be done to it: a sample of ``gs bench sigkill``, on the wall clock."""

from __future__ import annotations

import json
import math
import signal
from pathlib import Path

from groundstation.app.killed_flight import Watched, close_stdout, fly_and, kill
from groundstation.app.resources import packaged_configs

MISSION = packaged_configs() / "missions" / "first_flight2.yaml"
CHANGES = ["steps.1.hold.seconds=4"]


def _in_the_air(watched: Watched) -> bool:
    return bool(watched.world.truth.airborne.all())


def test_a_killed_one_leaves_a_whole_log_and_a_team_that_the_next_one_brings_home(tmp_path: Path) -> None:
    flight = fly_and(kill, _in_the_air, MISSION, tmp_path, changes=CHANGES)
    assert flight.exit_code == -signal.SIGKILL
    assert not flight.log_message.startswith("not readable")
    assert (flight.mismatches, flight.setpoints > 50) == (0, True)
    assert flight.take_over_code == 0, flight.output
    assert not math.isnan(flight.down_s)
    assert flight.min_distance_m >= 2.5  # r of that mission
    (result,) = [json.loads(line) for line in flight.output.splitlines() if line.startswith("{")]
    assert result["outcome"] == "completed"


def test_one_that_is_suspended_goes_on_or_comes_back_and_nobody_is_left_in_the_air(tmp_path: Path) -> None:
    stopped_ns: list[int] = []

    def suspend(watched: Watched) -> None:
        watched.process.send_signal(signal.SIGSTOP)
        stopped_ns.append(watched.world.now_ns)

    def wake(watched: Watched) -> None:
        if stopped_ns and watched.world.now_ns - stopped_ns[0] >= 3_000_000_000:
            stopped_ns.clear()
            watched.process.send_signal(signal.SIGCONT)

    flight = fly_and(suspend, _in_the_air, MISSION, tmp_path, changes=CHANGES, then=wake)
    assert flight.exit_code in (0, 1), flight.output
    assert flight.take_over_code is None
    assert "the ground station stood still for" in flight.output
    assert not math.isnan(flight.down_s)
    assert flight.mismatches == 0


def test_one_whose_output_nobody_reads_any_more_flies_on_to_its_end(tmp_path: Path) -> None:
    flight = fly_and(close_stdout, _in_the_air, MISSION, tmp_path, changes=CHANGES)
    assert flight.exit_code == 0, flight.output
    assert "Traceback" not in flight.output
    assert "phase  done" in flight.output
    assert flight.take_over_code is None
