"""Eight emulated Crazyflies fly lab_cube8 behind the gateway in virtual time; the log replays to the same setpoints."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.app.emulator import served_world, world_config
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from tests.app.flights import Flight, mission


def test_the_lab_cube_is_flown_and_replays_to_the_same_setpoints(tmp_path: Path) -> None:
    flight = Flight(mission("lab_cube8"), chatter=True, log=tmp_path / "lab.tlog")
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    assert flight.world.min_distance_airborne_m >= 0.45
    assert not flight.world.truth.armed.any() or {pilot.mode_name() for pilot in flight.world.autopilots} == {"READY"}
    assert not flight.texts("alarm")
    assert verify_log(tmp_path / "lab.tlog").mismatches == 0


def test_a_pad_for_an_origin_is_refused() -> None:
    with pytest.raises(UserError, match="write origin: team"):
        world_config(mission("lab_cube8", "vehicles.3.origin=pad"))


def test_over_udp_an_emulated_team_of_them_needs_a_gateway_of_its_own() -> None:
    with (
        pytest.raises(UserError, match="run gs sitl --autopilot and gs gateway"),
        served_world(mission("lab_cube8"), 1),
    ):
        pass
