"""Algorithm 2 around upright ellipsoids and cylinders, against a search over directions."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.core.avoidance import avoid
from groundstation.core.regions import SafetyCylinder, SafetyEllipsoid, SafetySphere, build_region, rot_level_from_flu
from groundstation.core.types import FloatArray
from groundstation.core.views import LocalViews
from tests.core.ray_search import Shape, best_by_search, fibonacci_sphere
from tests.core.strategies import Team, teams

upright = st.builds(
    build_region, st.sampled_from(["cylinder", "ellipsoid"]), st.just(0.45), st.just(1.5), st.floats(0.1, 2.0)
)


def views_of(*others: object) -> LocalViews:
    """One level agent's view of others at the given relative positions."""
    rel = np.array([others], dtype=np.float64).reshape(1, -1, 3)
    return LocalViews(rel, np.zeros_like(rel), np.ones(rel.shape[:2], dtype=np.bool_), np.zeros((1, 3)))


def test_over_a_cylinder_by_hand() -> None:
    """A cylinder ahead and below: just over the near edge of its upper face is nearer than around it."""
    wanted = np.array([[0.3, 0.0, -0.05]])
    result = avoid(views_of([1.0, 0.0, -0.9]), wanted, SafetyCylinder(0.4, 1.5, 0.8))
    direction = result.vel_flu_m_s[0] / np.linalg.norm(result.vel_flu_m_s)
    # Seen from above the face's far edge hides nothing: the way leads over it, 0.1 m down in 1.4 m.
    assert direction == pytest.approx(np.array([1.4, 0.0, -0.1]) / np.hypot(1.4, 0.1), abs=1e-6)


def test_around_a_high_cylinder_by_hand() -> None:
    """So high that the way leads around it: to the right, in the plane that touches its side."""
    result = avoid(views_of([1.0, 0.0, 0.0]), np.array([[0.3, 0.0, 0.1]]), SafetyCylinder(0.5, 1.5, 5.0))
    x, y, z = result.vel_flu_m_s[0]
    assert y / x == pytest.approx(-np.tan(np.radians(30.0)), rel=1e-6)
    assert z / np.hypot(x, y) == pytest.approx(0.1 / (0.3 * np.cos(np.radians(30.0))), rel=1e-6)
    assert np.hypot(np.hypot(x, y), z) == pytest.approx(np.hypot(0.3, 0.1))


def test_an_ellipsoid_blocks_more_above_than_aside() -> None:
    ellipsoid = SafetyEllipsoid(0.4, 1.5, 1.0)
    under = avoid(views_of([0.0, 0.0, 2.0]), np.array([[0.0, 0.0, 0.3]]), ellipsoid)
    beside = avoid(views_of([2.0, 0.0, 0.0]), np.array([[0.3, 0.0, 0.0]]), ellipsoid)
    # From the pole of the scaled ball: its cap is asin(0.4 / 0.8) wide where a metre up counts 0.4 m.
    assert under.angle_rad[0] == pytest.approx(np.arctan(np.tan(np.pi / 6) * 0.4), abs=1e-6)
    assert not beside.in_the_way.any()  # 2 m are beyond 1.5 m, and 2 m up are not beyond 3.75 m
    aside = avoid(views_of([1.4, 0.0, 0.0]), np.array([[0.3, 0.0, 0.0]]), ellipsoid)
    assert aside.angle_rad[0] == pytest.approx(np.arcsin(0.4 / 1.4), abs=1e-6)


@pytest.mark.parametrize("shape", ["cylinder", "ellipsoid"])
@pytest.mark.parametrize("line", [[0.7, 0.1, 0.0], [0.5, -0.5, 0.4], [0.3, 0.6, -0.9]])
def test_head_on_agents_pass_each_other(shape: str, line: list[float]) -> None:
    region, way = build_region(shape, 0.45, 1.5, 0.6), np.array(line)
    first = avoid(views_of(way), np.array([0.5 * way]), region).vel_flu_m_s[0]
    second = avoid(views_of(-way), np.array([-0.5 * way]), region).vel_flu_m_s[0]
    assert np.linalg.norm(np.cross(way, first)) > 0.05 * np.linalg.norm(way) * np.linalg.norm(first)
    np.testing.assert_allclose(second, -first, atol=1e-6)


@pytest.mark.parametrize("half_height_m", [0.3, 0.9])
def test_inside_one_may_only_part(half_height_m: float) -> None:
    cylinder = SafetyCylinder(0.45, 0.5, half_height_m)
    beside = avoid(views_of([0.4, 0.0, 0.0]), np.array([[0.2, 0.0, 0.3]]), cylinder)
    assert beside.vel_flu_m_s[0, 0] <= 1e-9
    above = avoid(views_of([0.05, 0.0, -0.95 * half_height_m]), np.array([[0.2, 0.1, -0.3]]), cylinder)
    assert above.vel_flu_m_s[0, 2] >= -1e-9
    assert not above.blocked[0]
    straight = avoid(views_of([0.0, 0.0, -0.95 * half_height_m]), np.array([[0.0, 0.0, -0.3]]), cylinder)
    assert straight.blocked[0]
    assert not straight.vel_flu_m_s.any()
    centre = avoid(views_of([0.0, 0.0, 0.0]), np.array([[0.0, 0.1, -0.3]]), cylinder)
    np.testing.assert_array_equal(centre.vel_flu_m_s, [[0.0, 0.1, -0.3]])


def test_an_obstacle_has_a_larger_region() -> None:
    plain = views_of([1.0, 0.0, 0.0])
    obstacle = dataclasses.replace(plain, extra_m=np.array([[0.1]]))
    for shape in ("cylinder", "ellipsoid"):
        region = build_region(shape, 0.4, 1.5, 3.0)
        angles = [avoid(views, np.array([[0.3, 0, 0]]), region).angle_rad[0] for views in (plain, obstacle)]
        assert angles == pytest.approx([np.arcsin(0.4), np.arcsin(0.5)], abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(teams, st.integers(0, 2**32 - 1))
def test_an_ellipsoid_that_is_a_ball_turns_as_a_sphere_does(team: Team, seed: int) -> None:
    wanted = np.random.default_rng(seed).normal(0.0, 0.3, (team.size, 3))
    ball = avoid(team.views, wanted, SafetySphere(0.45, 1.5))
    same = avoid(team.views, wanted, SafetyEllipsoid(0.45, 1.5, 0.45))
    np.testing.assert_array_equal(same.blocked, ball.blocked)
    np.testing.assert_allclose(same.angle_rad, ball.angle_rad, atol=1e-5)


@settings(max_examples=25, deadline=None)
@given(teams, st.integers(0, 2**32 - 1), upright)
def test_team_at_once_is_agent_by_agent_to_the_bit(
    team: Team, seed: int, region: SafetyCylinder | SafetyEllipsoid
) -> None:
    wanted = np.random.default_rng(seed).normal(0.0, 0.3, (team.size, 3))
    together = avoid(team.views, wanted, region)
    for i in range(team.size):
        alone = avoid(team.views.agent(i), wanted[i : i + 1], region)
        for f in dataclasses.fields(alone):
            np.testing.assert_array_equal(getattr(alone, f.name)[0], getattr(together, f.name)[i])


def random_cases(rng: np.random.Generator, count: int, near: int, shape: Shape) -> tuple[FloatArray, FloatArray]:
    """Wanted velocities, some level and some straight up or down, and offsets to others, NaN where nobody is seen."""
    wanted = rng.normal(size=(count, 3))
    wanted[rng.random(count) < 0.15, 2] = 0.0
    wanted[(rng.random(count) < 0.05) & (wanted[:, 2] != 0.0), :2] = 0.0
    rel = rng.normal(size=(count, near, 3))
    rel *= (rng.choice([0.6, 0.95, 1.0, 1.02, 1.1, 1.4, 2.0, 3.0], (count, near)) / shape.norm(rel))[..., None]
    # Most agents near the way ahead: that is where regions overlap.
    rel += 0.3 * (wanted / np.linalg.norm(wanted, axis=1, keepdims=True))[:, None] * rng.random((count, near, 1))
    hidden = rng.random((count, near)) >= rng.uniform(0.2, 1.0, (count, 1))
    rel = np.where(hidden[..., None], np.nan, rel)
    return wanted, rel


@pytest.mark.parametrize(
    ("kind", "half_m"),
    [("ellipsoid", 1.1), ("ellipsoid", 0.25), ("cylinder", 0.6), ("cylinder", 0.2), ("cylinder", 1.5)],
)
def test_never_enters_and_never_turns_more_than_a_search_finds(kind: str, half_m: float) -> None:
    rng, spread, shape = np.random.default_rng(2019), fibonacci_sphere(1500), Shape(kind, 0.45, half_m)
    cases = 150
    wanted, rel = random_cases(rng, cases, 6, shape)
    up = rng.normal(0.0, 0.3, (cases, 3)) + np.array([0.0, 0.0, 1.0])
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    level = rot_level_from_flu(up)
    seen = np.asarray(np.isfinite(rel).all(axis=-1), dtype=np.bool_)
    views = LocalViews(np.einsum("mji,mkj->mki", level, rel), 0.0 * rel, seen, np.zeros((cases, 3)), up_flu=up)
    result = avoid(views, np.einsum("mji,mj->mi", level, wanted), build_region(kind, 0.45, 10.0, half_m))
    # The cases exercise both answers.
    assert result.blocked.any() or half_m > 1.0  # around cylinders that high there is nearly always a way
    turned = 0
    for i in range(cases):
        others, unit = rel[i, seen[i]], wanted[i] / np.linalg.norm(wanted[i])
        free = partial(shape.free, offset=others)
        found = best_by_search(free, unit, spread, kept=16, tried=80) if len(others) else 0.0
        if result.blocked[i]:
            assert not result.vel_flu_m_s[i].any()
            assert found >= np.pi / 2 - 1e-3, i
            continue
        velocity = level[i] @ result.vel_flu_m_s[i]
        assert np.linalg.norm(velocity) == pytest.approx(np.linalg.norm(wanted[i]), rel=1e-9)
        direction = velocity / np.linalg.norm(velocity)
        angle = np.arctan2(np.linalg.norm(np.cross(unit, direction)), unit @ direction)
        assert result.angle_rad[i] == pytest.approx(angle, abs=1e-6)
        assert angle <= found + 1e-3, i
        outside = others[shape.norm(others) >= 1.0]
        if len(outside):  # walking along the ray, which is not how it was found
            assert shape.nearest_along(direction[None], outside).min() >= 1.0 - 1e-9, i
        inside = others[shape.norm(others) < 1.0]
        assert shape.free(direction[None], inside, slack=1e-7).all(), i
        turned += bool(result.in_the_way[i].any())
    assert turned > 75
