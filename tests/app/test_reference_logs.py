"""Logs of earlier flights, flown again: a setpoint, a command or a reason that changes by accident shows here."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.app.resources import packaged_configs
from groundstation.app.verify import verify_log
from groundstation.mission.runner import Phase
from tests.calls import count_calls
from tests.reference import FLIGHTS, FOLDER, known_figures, unpack

BYTES_MAX = 2_600_000


COUNTED = ("lands_here", "taken_over", "goes_on")
"""They have preflight and take-over, all that is flown, landings of one and of all, one that flies apart."""


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_log_that_is_kept_is_flown_again_to_the_bit_and_nothing_is_done_twice_in_a_tick(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = count_calls(monkeypatch) if name in COUNTED else None
    result = verify_log(unpack(name, tmp_path))
    assert (result.mismatches, result.complete) == (0, True), "changed on purpose? then `make refs`, and say so"
    assert result.rounded <= result.frames // 200, "more than another processor's rounding"
    known = known_figures()[name]
    assert result.setpoints == known["setpoints"]
    assert (result.setpoints > 0) == (known["outcome"] != "refused")
    if calls is not None:
        assert {"TeamFrame.poses", "Board.look", "Landing.step", "Fleet.stands"} <= calls.counted
        assert ("Apart.step" in calls.counted) == (name == "goes_on")
        assert {"Surroundings._look_around", "Surroundings.shown", "Resting._take"} <= calls.counted
        assert dict(calls.twice) == {}


def test_the_logs_show_what_they_are_kept_for_and_stay_small() -> None:
    figures = known_figures()
    assert figures.keys() == FLIGHTS.keys()
    seen = {phase for item in figures.values() for phase in item["phases"].split()}
    assert seen == {phase.value for phase in Phase}
    assert {item["outcome"] for item in figures.values()} == {"completed", "aborted", "refused"}
    timetables = {path.stem for path in (packaged_configs() / "faults").glob("*.yaml")}
    assert timetables <= figures.keys()
    packaged = {path.stem for path in (packaged_configs() / "missions").glob("*.yaml")}
    assert packaged & figures.keys()
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) <= BYTES_MAX
