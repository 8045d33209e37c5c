"""The map of a mission by GPS, without a browser and without the internet."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from nicegui import Client
from nicegui.page import page

from groundstation.app.console.charts import BLUE, PURPLE, VERMILION
from groundstation.app.console.map_view import TeamMap, Tiles
from groundstation.app.console.snapshot import AVOIDS, LOST, Snapshot
from groundstation.app.console.viewers import Viewers
from groundstation.core.errors import UserError
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
    shown = TeamMap(team, None)
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
    layers = [layer.to_dict() for layer in TeamMap(team, ("/tiles/{z}/{x}/{y}", 17)).view.layers]
    assert layers[0]["args"][0] == "/tiles/{z}/{x}/{y}"
