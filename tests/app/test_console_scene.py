"""The team in three dimensions, without a browser: what is drawn of whom, and how many objects that takes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from nicegui import Client
from nicegui.page import page

from groundstation.app.console.charts import BLUE, GREEN, ORANGE, VERMILION
from groundstation.app.console.scene import TeamScene
from groundstation.app.console.snapshot import AIRBORNE, AVOIDS, FOREIGN, LOST, Snapshot
from groundstation.app.console.viewers import Viewers
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


@pytest.mark.usefixtures("browser")
def test_a_large_team_takes_three_objects_a_vehicle_and_a_line_an_edge() -> None:
    """A renderer without a graphics card pays for every object; those of a group and of a number are not drawn."""
    now = team(100)
    scene = TeamScene(now, dark=False)
    scene.show(now, slowly=True)
    kinds = [item.type for item in scene.view.objects.values()]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == {
        "group": 100,
        "text": 100,
        "box": 100,
        "sphere": 100,
        "point_cloud": 3,
        "line": 12 + 99,
    }
    assert TeamScene(team(8), dark=True).view.objects


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
    objects = list(scene.view.objects.values())
    bodies = [item.color for item in objects if item.type == "box"]
    assert bodies == [BLUE, BLUE, ORANGE, VERMILION]
    regions = [item for item in objects if item.type == "sphere"][:4]
    grown = 1.0 + 2.0 * 1.25 / now.words.radius_m
    assert regions[3].sx == pytest.approx(grown)
    assert regions[0].sx == 1.0
    edges = [item for item in objects if item.type == "line"][12:]
    assert [(item.color, item.visible_) for item in edges[:2]] == [(ORANGE, True), (GREEN, True)]
    assert not edges[2].visible_  # to who is lost
