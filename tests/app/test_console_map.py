"""The map of a mission by GPS, without a browser and without the internet."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from nicegui import Client
from nicegui.page import page

from groundstation.app.console.charts import BLUE, PURPLE, VERMILION
from groundstation.app.console.map_view import TeamMap, Tiles
from groundstation.app.console.recorded import Recorded
from groundstation.app.console.snapshot import AVOIDS, LOST, Snapshot
from groundstation.app.console.viewers import Viewers
from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Encoder
from groundstation.records.manifest import manifest_path
from groundstation.records.replay import load_flight
from groundstation.records.tlog import TlogWriter
from tests.app.flights import Flight, pair
from tests.app.test_console_replay import _unpacked
from tests.app.test_order_socket import Desk

LAT_DEG, LON_DEG = 47.0, 8.0
EAST_100_M_DEG = np.degrees(100.0 / (6_389_500.0 * np.cos(np.radians(LAT_DEG))))  # radius across the meridian


@pytest.fixture(scope="module")
def team() -> Snapshot:
    desk = Desk(Path("/nowhere"))
    one = Viewers(Path("/nowhere"), desk.session.runner.plan).snapshot(desk.session, desk.now_ns)
    return replace(
        one,
        anchor_deg_m=np.array([LAT_DEG, LON_DEG, 400.0]),
        pos_team_enu_m=np.array([[0.0, 0.0, 1.0], [100.0, 0.0, 1.0]]),
    )


@pytest.fixture
def browser() -> Iterator[None]:
    """A place for elements; nobody looks at it."""
    with Client(page(""), request=None):
        yield


def _vehicles(team_map: TeamMap) -> list[tuple[list[float], dict[str, object]]]:
    drawn = [layer.to_dict() for layer in team_map.view.layers]
    return [tuple(item["args"]) for item in drawn if item["type"] == "circle"][-2:]


@pytest.mark.usefixtures("browser")
def test_vehicles_are_where_they_are_on_earth_and_nothing_is_asked_of_the_internet(team: Snapshot) -> None:
    shown = TeamMap(team, None, dark=False)
    shown.show(team)
    (here, _), (there, style) = _vehicles(shown)
    np.testing.assert_allclose(here, [LAT_DEG, LON_DEG], atol=1e-7)
    np.testing.assert_allclose(there, [LAT_DEG, LON_DEG + EAST_100_M_DEG], atol=2e-7)
    assert style["color"] == BLUE
    assert "http" not in str([layer.to_dict() for layer in shown.view.layers])
    moved = replace(
        team,
        pos_team_enu_m=np.array([[0.0, 100.0, 1.0], [np.nan, np.nan, np.nan]]),
        state=np.array([AVOIDS, LOST]),
        extra_radius_m=np.array([0.0, 0.5]),
    )
    shown.show(moved)
    (here, style), (kept, other) = _vehicles(shown)
    assert here[0] > LAT_DEG + 8e-4
    assert style["color"] == PURPLE
    assert (kept, other["color"]) == (there, BLUE)  # of whom nothing is known, nothing is said
    shown.show(replace(moved, pos_team_enu_m=team.pos_team_enu_m))
    _, (_, other) = _vehicles(shown)
    assert (other["color"], other["radius"]) == (VERMILION, team.words.radius_m / 2 + 0.5)


@pytest.mark.usefixtures("browser")
def test_tiles_come_from_a_folder(team: Snapshot, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no tiles in it"):
        Tiles(tmp_path)
    (tmp_path / "17" / "3").mkdir(parents=True)
    (tmp_path / "17" / "3" / "4.jpg").write_bytes(b"a picture")
    tiles = Tiles(tmp_path)
    assert tiles.zoom_max == 17
    assert getattr(tiles.tile(17, 3, 4), "path", None) == tmp_path / "17" / "3" / "4.jpg"
    nothing = tiles.tile(17, 3, 5)
    assert (nothing.media_type, bytes(nothing.body)[1:4]) == ("image/png", b"PNG")
    layers = [layer.to_dict() for layer in TeamMap(team, ("/tiles/{z}/{x}/{y}", 17), dark=True).view.layers]
    assert layers[0]["args"][0] == "/tiles/{z}/{x}/{y}"


def test_a_recorded_flight_by_gps_is_where_the_emulator_had_it_on_earth(tmp_path: Path) -> None:
    log = tmp_path / "pair.tlog"
    truth: list[tuple[int, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]] = []

    def look(flight: Flight) -> bool:
        truth.append((flight.now_ns, np.array(flight.world.truth.pos_enu_m)))
        return False

    flight = Flight(pair("steps.1.hold.seconds=1"), log=log, interrupt_when=look, chatter=True)
    recorded = Recorded(load_flight(log))
    home = flight.world.config
    for t_ns, pos_m in truth[:: len(truth) // 7]:
        snapshot = recorded.at(t_ns / 1e9 - recorded.flight.start_ns / 1e9)
        if np.isfinite(snapshot.pos_team_enu_m).all():
            told = pymap3d.enu2geodetic(*snapshot.pos_team_enu_m.T, *snapshot.anchor_deg_m)
            there = pymap3d.geodetic2enu(*told, home.home_lat_deg, home.home_lon_deg, home.home_alt_m)
            np.testing.assert_allclose(np.array(there).T, pos_m, atol=1.5)  # GPS


def test_only_who_flies_by_gps_is_on_a_map(tmp_path: Path) -> None:
    """Indoors vehicles tell places on earth too, where somebody has set them an origin."""
    for name, on_earth in (("completed", True), ("room", False)):
        assert (load_flight(_unpacked(name, tmp_path)).anchor_deg_m is not None) is on_earth


def test_the_mission_says_where_its_frame_begins(tmp_path: Path) -> None:
    log = _unpacked("completed", tmp_path)
    path = manifest_path(log)
    manifest = json.loads(path.read_text())
    manifest["mission"]["anchor"] = {"lat_deg": 47.5, "lon_deg": 8.25, "alt_m": 400.0}
    path.write_text(json.dumps(manifest))
    np.testing.assert_array_equal(load_flight(log).anchor_deg_m, [47.5, 8.25, 400.0])
    manifest["mission"]["anchor"]["lat_deg"] = "north"
    path.write_text(json.dumps(manifest))
    with pytest.raises(UserError, match=r"mission\.anchor: .*the manifest is damaged"):
        load_flight(log)


def test_one_foreign_vehicle_alone_is_shown_in_its_own_frame_and_on_earth(tmp_path: Path) -> None:
    log = tmp_path / "one.tlog"
    with TlogWriter(log, 1_700_000_000_000_000) as writer:
        own = Encoder(1)
        for second in range(1, 5):
            frames = (
                own.encode("LOCAL_POSITION_NED", time_boot_ms=1000 * second, x=10.0, y=20.0 + second, z=-3.0),
                own.encode(
                    "GLOBAL_POSITION_INT", time_boot_ms=1000 * second, lat=470_000_000, lon=80_000_000, alt=403_000
                ),
            )
            for frame in frames:
                writer.received(0, "p", frame, 1_000_000_000 * second)
    recorded = Recorded(load_flight(log))
    snapshot = recorded.at(0.0)
    np.testing.assert_allclose(snapshot.pos_team_enu_m, [[21.0, 10.0, 3.0]])
    lat, lon, alt = pymap3d.enu2geodetic(21.0, 10.0, 3.0, *snapshot.anchor_deg_m)
    np.testing.assert_allclose([lat, lon, alt], [47.0, 8.0, 403.0], atol=1e-3)
