"""The team in three dimensions, without a browser: what is drawn of whom, and how many objects that takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from nicegui import Client
from nicegui.elements.scene.objects.text import Text
from nicegui.page import page

from groundstation.app.console.charts import BLUE, GREEN, ORANGE, PURPLE, VERMILION
from groundstation.app.console.common import Bodies, Segments
from groundstation.app.console.scene import TeamScene, ground_lines_m
from groundstation.app.console.snapshot import AIRBORNE, AVOIDS, FOREIGN, LOST, Snapshot
from groundstation.app.console.viewers import Viewers
from groundstation.core.types import FloatArray
from tests.app.test_order_socket import Desk


@pytest.fixture
def browser() -> Iterator[None]:
    """A place for elements; nobody looks at it."""
    with Client(page(""), request=None):
        yield


def team(n: int) -> Snapshot:
    """So many on a grid, 2 m apart and 1 m up, each joined to the next."""
    desk = Desk(Path("/nowhere"))
    one = Viewers(Path("/nowhere"), desk.session.runner.plan).snapshot(desk.session, desk.now_ns)
    grown: dict[str, object] = {}
    for item in fields(Snapshot):
        value = getattr(one, item.name)
        if isinstance(value, np.ndarray) and item.name not in ("fence_enu_m", "figures", "edges", "anchor_deg_m"):
            grown[item.name] = np.resize(value, (n, *value.shape[1:]))
    side = int(np.ceil(np.sqrt(n)))
    place = np.array([[2.0 * (row % side), 2.0 * (row // side), 0.0] for row in range(n)])
    words = replace(one.words, modes=("",) * n, said=("",) * n)
    grown |= {
        "ids": np.arange(1, n + 1),
        "pads_enu_m": place,
        "goal_enu_m": place,
        "pos_team_enu_m": np.add(place, [0.0, 0.0, 1.0]),
        "state": np.full(n, AIRBORNE),
        "extra_radius_m": np.zeros(n),
    }
    return replace(one, words=words, edges=np.array([[row, row + 1] for row in range(n - 1)]), **grown)  # type: ignore[arg-type]


def kinds(scene: TeamScene) -> Counter[str]:
    return Counter(type(item).__name__ for item in scene.view.objects.values())


@pytest.mark.usefixtures("browser")
def test_a_hundred_vehicles_take_no_more_objects_than_eight_but_for_their_labels() -> None:
    """A renderer without a graphics card pays for every object; a label is none of its."""
    scene = TeamScene(team(100), dark=False)
    scene.show(team(100), slowly=True)
    assert kinds(scene) == {"Bodies": 5, "Segments": 3, "PointCloud": 1, "Text": 100}
    assert kinds(TeamScene(team(8), dark=True)) == kinds(scene) - Counter(Text=92)


@pytest.mark.usefixtures("browser")
def test_colours_regions_and_edges_tell_of_whom_something_is_wrong() -> None:
    now = team(4)
    scene = TeamScene(now, dark=False)
    later = replace(
        now,
        state=np.array([AIRBORNE, AIRBORNE | AVOIDS, AIRBORNE | FOREIGN, LOST]),
        extra_radius_m=np.array([0.0, 0.0, 0.0, 1.25]),
        pos_team_enu_m=np.add(now.pos_team_enu_m, [[0.3, 0.0, 0.0], [0.0] * 3, [0.0] * 3, [0.0] * 3]),
    )
    scene.show(later, slowly=True)
    _, bodies, calm, told, _ = (item for item in scene.view.objects.values() if isinstance(item, Bodies))
    assert bodies.colours == [BLUE, BLUE, ORANGE, VERMILION]
    assert (calm.colours, told.colours) == ([BLUE], [PURPLE, ORANGE, VERMILION])
    np.testing.assert_allclose(places(calm), [[0.3, 0.0, 1.0]])
    np.testing.assert_allclose(places(told), later.pos_team_enu_m[1:])
    sizes = np.array(told.places).reshape(-1, 3, 4)[:, :, :3]
    grown = 1.0 + 2.0 * 1.25 / now.words.radius_m
    np.testing.assert_allclose(sizes, np.array([1.0, 1.0, grown])[:, None, None] * np.eye(3), atol=1e-4)
    edges = [item for item in scene.view.objects.values() if isinstance(item, Segments)][-1]
    assert edges.colours == [ORANGE, GREEN]  # none to who is lost
    np.testing.assert_allclose(
        np.array(edges.ends).reshape(-1, 2, 3), later.pos_team_enu_m[[[0, 1], [1, 2]]], atol=1e-4
    )


@pytest.mark.usefixtures("browser")
def test_a_body_is_turned_as_its_vehicle_and_not_seen_where_nothing_is_known() -> None:
    now = team(3)
    half = np.sqrt(0.5)
    quats = np.array([[1.0, 0.0, 0.0, 0.0], [half, 0.0, 0.0, half], [np.nan] * 4])  # heads north, east, somewhere
    places_m = np.array(now.pos_team_enu_m)
    places_m[2] = np.nan
    scene = TeamScene(now, dark=False)
    scene.show(replace(now, quat_ned_from_frd=quats, pos_team_enu_m=places_m), slowly=True)
    _, bodies, calm, _, _ = (item for item in scene.view.objects.values() if isinstance(item, Bodies))
    noses = np.array(bodies.places).reshape(-1, 3, 4)[:, :, 0]
    np.testing.assert_allclose(noses, [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], atol=1e-4)
    np.testing.assert_allclose(places(calm), places_m[:2])
    assert [item.visible_ for item in scene.view.objects.values() if isinstance(item, Text)] == [True, True, False]


def places(bodies: Bodies) -> FloatArray:
    """Middles of those that are seen."""
    return np.array(bodies.places).reshape(-1, 3, 4)[:, :, 3]


@pytest.mark.parametrize(("size_m", "step_m"), [(6.0, 1.0), (60.0, 10.0), (300.0, 100.0)])
def test_the_grid_on_the_ground_reaches_beyond_the_fence(size_m: float, step_m: float) -> None:
    low, high = np.array([-1.0, 2.0, 0.0]), np.array([-1.0 + size_m, 2.0 + size_m / 2, 9.0])
    lines = ground_lines_m(low, high)
    assert np.all(lines[:, :, 2] == 0.0)
    assert np.all(lines.reshape(-1, 3).min(axis=0)[:2] <= low[:2])
    assert np.all(lines.reshape(-1, 3).max(axis=0)[:2] >= high[:2])
    np.testing.assert_allclose(np.diff(np.unique(lines[:, :, 0])), step_m)
