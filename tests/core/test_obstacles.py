"""Obstacles: distances against points found by search, ways round them, and the damper's bound in flight by truth."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.core.detour import way_round
from groundstation.core.obstacles import BoxObstacle, CylinderObstacle, Obstacle, Obstacles, SphereObstacle
from groundstation.core.types import BoolArray, FloatArray

BODIES: list[Obstacle] = [
    SphereObstacle("ball", np.array([0.5, -0.2, 1.0]), 0.7),
    CylinderObstacle("pole", np.array([0.5, -0.2, 1.0]), 0.4, 1.8),
    BoxObstacle("crate", np.array([0.5, -0.2, 1.0]), np.array([1.0, 0.6, 1.4])),
]


def _within(body: Obstacle, pos_m: FloatArray) -> BoolArray:
    """Whether points are inside, by the shape's own words and none of its code."""
    x, y, z = (pos_m - body.centre_m).T
    if isinstance(body, SphereObstacle):
        return np.asarray(x * x + y * y + z * z <= body.radius_m**2)
    if isinstance(body, CylinderObstacle):
        return np.asarray((x * x + y * y <= body.radius_m**2) & (abs(z) <= body.height_m / 2))
    assert isinstance(body, BoxObstacle)
    return np.asarray((2 * np.abs(np.stack([x, y, z], axis=1)) <= body.size_m).all(axis=1))


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.kind)
def test_distances_are_those_to_the_nearest_point_that_is_inside(body: Obstacle) -> None:
    rng = np.random.default_rng(1)
    cloud = body.centre_m + rng.uniform(-1.0, 1.0, (60_000, 3))
    cloud = cloud[_within(body, cloud)]
    points = body.centre_m + rng.uniform(-2.5, 2.5, (40, 3))
    distance, away = body.distance(points)
    assert ((distance < 0.0) == _within(body, points)).all()
    outside = ~_within(body, points)
    found = np.linalg.norm(points[outside, None] - cloud[None], axis=2).min(axis=1)
    np.testing.assert_allclose(distance[outside], found, atol=0.08)
    assert (found >= distance[outside] - 1e-9).all()
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 1.0)
    on_surface = points - distance[:, None] * away
    np.testing.assert_allclose(body.distance(on_surface)[0], 0.0, atol=1e-9)


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.kind)
@given(seed=st.integers(0, 10_000))
def test_distances_are_convex_and_never_change_faster_than_one_moves(body: Obstacle, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = body.centre_m + rng.uniform(-3.0, 3.0, (2, 1, 3))
    da, db, middle = (float(body.distance(point)[0][0]) for point in (a, b, 0.5 * (a + b)))
    assert middle <= 0.5 * (da + db) + 1e-9
    assert abs(da - db) <= float(np.linalg.norm(a - b)) + 1e-9


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.kind)
def test_whoever_keeps_out_of_a_grown_obstacle_keeps_its_distance_along_the_whole_line(body: Obstacle) -> None:
    rng = np.random.default_rng(2)
    start, end = body.centre_m + rng.uniform(-2.5, 2.5, (2, 400, 3))
    crossed = body.crossed(start, end, 0.3)
    along = np.linspace(0.0, 1.0, 200)[:, None, None]
    nearest = body.distance((start + along * (end - start)).reshape(-1, 3))[0].reshape(200, 400).min(axis=0)
    assert (nearest[~crossed] >= 0.3 - 0.02).all()
    assert crossed[nearest < 0.25].all()
    assert 20 < crossed.sum() < 380


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.kind)
def test_a_way_round_is_found_and_keeps_its_distance(body: Obstacle) -> None:
    keep_m, here = 0.5, body.centre_m + np.array([-2.5, 0.03, 0.1])
    goal = body.centre_m + np.array([2.5, 0.0, -0.1]) - here
    obstacles = Obstacles((body,), keep_m)
    low, high = np.full(3, -6.0), np.full(3, 6.0)
    way = way_round(goal, np.zeros((0, 3)), 0.5, low, high, obstacles=obstacles.seen_from(here))
    assert way is not None
    assert len(way) >= 2
    nodes = np.concatenate([np.zeros((1, 3)), way]) + here
    for start, end in itertools.pairwise(nodes):
        line = start + np.linspace(0.0, 1.0, 200)[:, None] * (end - start)
        assert body.distance(line)[0].min() >= keep_m
    wall = BoxObstacle("wall", np.zeros(3), np.array([0.2, 20.0, 20.0]))
    seen = Obstacles((wall,), keep_m).seen_from(np.array([-2.0, 0.0, 0.0]))
    assert way_round(np.array([4.0, 0.0, 0.0]), np.zeros((0, 3)), 0.5, low, high, obstacles=seen) is None


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.kind)
def test_from_above_it_covers_what_is_under_or_over_it(body: Obstacle) -> None:
    over = body.centre_m + np.array([[0.0, 0.0, 5.0], [3.0, 0.0, 0.0]])
    beside = Obstacles((body,), 0.3).beside_m(over)
    assert beside[0] < 0.0
    assert beside[1] == pytest.approx(float(body.distance(over[1:])[0][0]))


def test_sizes_that_are_not_positive_are_refused() -> None:
    with pytest.raises(ValueError, match="obstacle ball: sizes are"):
        SphereObstacle("ball", np.zeros(3), 0.0)
