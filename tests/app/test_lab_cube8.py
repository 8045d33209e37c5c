"""Eight emulated Crazyflies fly lab_cube8 behind the gateway in virtual time; the log replays to the same setpoints."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from groundstation.app.emulator import served_world, world_config
from groundstation.app.verify import verify_log
from groundstation.core import frames
from groundstation.core.errors import UserError
from groundstation.records.replay import load_flight
from sitl.personalities import PROFILES
from sitl.personalities.crazyflie.profiles import CRAZYFLIE
from tests.app.flights import Flight, mission


def test_the_lab_cube_is_flown_and_replays_to_the_same_setpoints(tmp_path: Path) -> None:
    flight = Flight(mission("lab_cube8"), chatter=True, log=tmp_path / "lab.tlog")
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    assert flight.world.min_distance_airborne_m >= 0.45
    assert not flight.world.truth.armed.any() or {pilot.mode_name() for pilot in flight.world.autopilots} == {"READY"}
    assert not flight.texts("alarm")
    assert verify_log(tmp_path / "lab.tlog").mismatches == 0
    room = flight.runner.fleet.room
    assert room is not None
    assert not room.counts
    # Who reads the log believes the same positions as the flight: those of the motion capture.
    tracks = load_flight(tmp_path / "lab.tlog").vehicles
    assert [len(track.t_ns) > 90 * flight.now_ns / 1e9 for track in tracks] == [True] * 8
    for row, track in enumerate(tracks):
        assert track.pos_team_enu_m[-1] == pytest.approx(frames.enu_from_ned(room.pos_ned_m[row]), abs=1e-6)


def test_it_is_flown_by_vehicles_that_answer_as_the_firmware_does(monkeypatch: pytest.MonkeyPatch) -> None:
    # Its gains (25 degrees for 1 m/s, 6/s of attitude, 20 degrees at most); the emulator's own attitude is far quicker.
    loops = replace(
        CRAZYFLIE.loops, kp_xy_per_s=4.28, ki_xy_per_s2=0.17, attitude_rad_s=12.0, dead_time_s=0.04,
        tilt_max_rad=math.radians(20.0),
    )  # fmt: skip
    monkeypatch.setitem(PROFILES, "crazyflie", replace(CRAZYFLIE, loops=loops))
    flight = Flight(mission("lab_cube8"))
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    assert flight.world.min_distance_airborne_m >= 0.45
    assert not flight.texts("alarm")


def test_a_pad_for_an_origin_is_refused() -> None:
    with pytest.raises(UserError, match="write origin: team"):
        mission("lab_cube8", "vehicles.3.origin=pad")
    with pytest.raises(UserError, match="write origin: team"):
        world_config(mission("lab_cube8", "vehicles.3.origin=pad", "positioning=mocap"))


def test_with_a_positioning_deck_they_need_no_motion_capture() -> None:
    flight = Flight(mission("lab_pair2", "positioning=mocap"), chatter=True)
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    assert flight.runner.fleet.room is None


def test_over_udp_an_emulated_team_of_them_needs_a_gateway_of_its_own() -> None:
    with (
        pytest.raises(UserError, match="run gs sitl --autopilot and gs gateway"),
        served_world(mission("lab_cube8"), 1),
    ):
        pass
