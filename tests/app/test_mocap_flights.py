"""Eight emulated Crazyflies under a fake motion capture system that goes wrong: safe, and told in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.mocap.fake import FakeConfig, RoomFault
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from sitl.world import WorldConfig
from tests.app.flights import Flight, mission, pair


def lab(*faults: RoomFault, log: Path | None = None, changes: tuple[str, ...] = ()) -> Flight:
    """A flight in which that happens; names of vehicles are those of their rows + 1."""
    plan = mission("lab_cube8", "steps.1.hold.seconds=2", *changes)
    names = "positioning.bodies=place" not in changes
    return Flight(plan, log=log, room=FakeConfig(names=names, faults=faults))


def all_down(flight: Flight) -> bool:
    """Everybody stands on the ground, whole, with motors off."""
    truth = flight.world.truth
    modes = {pilot.mode_name() for pilot in flight.world.autopilots}
    return not truth.airborne.any() and float(np.abs(truth.pos_enu_m[:, 2]).max()) < 0.05 and modes == {"READY"}


def test_a_body_that_is_covered_for_a_moment_is_told_and_the_team_flies_on(tmp_path: Path) -> None:
    flight = lab(RoomFault("occlude", 12.0, 12.3, (3,)), log=tmp_path / "a.tlog")
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    first, second = flight.texts("alarm")
    assert first.startswith("vehicle 4: its body is not in the frames: its markers are covered")
    assert second == "vehicle 4: the motion capture sees it again"
    assert flight.world.min_distance_airborne_m >= 0.45
    assert verify_log(tmp_path / "a.tlog").mismatches == 0


def test_a_body_that_is_covered_for_long_holds_and_the_team_comes_back() -> None:
    flight = lab(RoomFault("occlude", 12.0, 15.0, (3,)))
    assert str(flight.runner.outcome) == "aborted"
    assert "vehicle 4: no position for 1 s; it lands where it is when nobody is below" in flight.runner.reason
    told = " | ".join(flight.texts("alarm"))
    assert "vehicle 4: its body is not in the frames" in told
    assert "vehicle 4: position is 0.5" in told
    assert "vehicle 4: the motion capture sees it again" in told
    assert flight.world.min_distance_airborne_m >= 0.45
    assert all_down(flight)


def test_two_bodies_that_exchange_their_names_in_flight_are_followed_by_where_they_flew(tmp_path: Path) -> None:
    flight = lab(RoomFault("swap", 12.0, 1e9, (2, 5)), log=tmp_path / "a.tlog")
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    (told,) = flight.texts("alarm")
    assert "the bodies of vehicles 3 and 6 have exchanged their names; each is followed by where it flew" in told
    assert flight.world.min_distance_airborne_m >= 0.45
    assert verify_log(tmp_path / "a.tlog").mismatches == 0


def test_when_the_whole_system_is_gone_they_part_and_come_down_and_r_is_kept(tmp_path: Path) -> None:
    """Nobody knows where it is, and everybody drifts its own way: they part while they sink, and are down soon."""
    gone_s = 12.0
    landed_s: list[float] = []

    class Watched(Flight):
        def _watch(self, session, now_ns):  # type: ignore[no-untyped-def]
            super()._watch(session, now_ns)
            if not self.world.truth.airborne.any() and now_ns > gone_s * 1e9:
                landed_s.append(now_ns / 1e9)

    plan = mission("lab_cube8", "steps.1.hold.seconds=2")
    room = FakeConfig(faults=(RoomFault("gone", gone_s),))
    flight = Watched(plan, chatter=True, log=tmp_path / "a.tlog", room=room)
    assert str(flight.runner.outcome) == "aborted"
    assert flight.runner.reason.startswith("motion capture: nothing of anybody for 0.5 s; they land where they are")
    told = flight.texts("alarm")
    assert "motion capture: no frame on udpin://127.0.0.1:14595 for 0.3 s, of anybody" in told[0]
    assert not [line for line in told if "its body" in line]  # it is not the bodies
    assert landed_s[0] - gone_s < 4.0
    assert flight.world.min_distance_airborne_m >= 0.45
    assert all_down(flight)
    assert verify_log(tmp_path / "a.tlog").mismatches == 0


@pytest.mark.parametrize(("kind", "why"), [("jump", "has jumped by 1.")])
def test_a_body_that_cannot_be_where_it_is_told_is_not_believed(kind: str, why: str) -> None:
    flight = lab(RoomFault(kind, 12.0, 14.0, (1,)))
    assert str(flight.runner.outcome) == "aborted"
    assert any(f"vehicle 2: its body {why}" in line for line in flight.texts("alarm"))
    assert flight.world.min_distance_airborne_m >= 0.45
    assert all_down(flight)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (RoomFault("mm"), "its unit is millimetres; write unit: mm"),
        (RoomFault("y_up"), "its y axis points up; write up: y"),
        (RoomFault("swap", vehicles=(0, 7)), "its body stands on the pad of vehicle 8, and the other way round"),
        (RoomFault("occlude", vehicles=(4,)), "vehicle 5: no body of its name"),
        (RoomFault("gone"), "no frame of the motion capture on udpin://127.0.0.1:14595: none yet"),
    ],
)
def test_a_room_that_is_wrong_is_refused_before_anybody_arms(fault: RoomFault, words: str) -> None:
    flight = lab(fault, changes=("limits.preflight_s=6",))
    assert str(flight.runner.outcome) == "refused"
    assert words in flight.runner.reason
    assert not flight.world.truth.armed.any() or {p.mode_name() for p in flight.world.autopilots} == {"READY"}


def test_markers_without_names_fly_the_lab_cube() -> None:
    flight = lab(changes=("positioning.bodies=place",))
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    assert flight.world.min_distance_airborne_m >= 0.45
    assert not flight.texts("alarm")


_SEES = {"px4": {"EKF2_EV_CTRL": 15.0}, "arducopter": {"VISO_TYPE": 1.0, "EK3_SRC1_POSXY": 6.0}}
_EARTH = ("anchor={lat_deg: 47.4, lon_deg: 8.5, alt_m: 488.0}", "set_gps_origin=true")
_ROOM = ("positioning={source: mocap}", "vehicles.0.origin=team", "vehicles.1.origin=team", "rate_hz=50")


def test_px4_and_ardupilot_are_told_their_poses_and_fly_without_gps(tmp_path: Path) -> None:
    def sees(config: WorldConfig) -> WorldConfig:
        vehicles = [replace(v, params=(*v.params, *_SEES[v.autopilot].items())) for v in config.vehicles]
        return replace(config, vehicles=tuple(vehicles))

    flight = Flight(pair(*_ROOM, *_EARTH), change=sees, log=tmp_path / "a.tlog")
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    assert not any(vehicle.gps for vehicle in flight.world.config.vehicles)
    assert flight.world.min_distance_airborne_m > 4.0
    assert verify_log(tmp_path / "a.tlog").mismatches == 0


def test_what_their_estimators_need_is_asked_of_the_mission() -> None:
    with pytest.raises(UserError, match="arducopter takes no position from motion capture before it has an origin"):
        pair(*_ROOM)
    with pytest.raises(UserError, match="rate_hz: 20: px4 is told its pose once a tick"):
        pair(*_ROOM[:3], *_EARTH, "rate_hz=20")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("positioning.link=udpin://127.0.0.1:14588", "port 14588 is that of the vehicles"),
        ("positioning.link=serial:///dev/ttyUSB0", "expected udpin://HOST:PORT"),
        ("positioning.system=vicon", "system and host, the kind of the motion capture"),
        ("vehicles.0.body=cf2", "cf2 stands twice"),
    ],
)
def test_a_mission_whose_room_cannot_be_is_refused(change: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        mission("lab_cube8", change)
