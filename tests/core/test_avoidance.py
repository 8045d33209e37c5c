"""Algorithm 2 against Fig. 3, against a search over directions, and Proposition 1 on kinematic agents."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.core.avoidance import avoid
from groundstation.core.regions import SafetySphere
from groundstation.core.types import BoolArray, FloatArray
from groundstation.core.views import LocalViews
from tests.core.lag_team import KINEMATIC, Chain, cube, cube_gains, fly, random_start
from tests.core.ray_search import best_by_search, fibonacci_sphere
from tests.core.strategies import Team, teams

SPHERE = SafetySphere(0.45, 0.5)


def views_of(*others: object) -> LocalViews:
    """One agent's view of others at the given relative positions."""
    rel = np.array([others], dtype=np.float64).reshape(1, -1, 3)
    return LocalViews(rel, np.zeros_like(rel), np.ones(rel.shape[:2], dtype=np.bool_), np.zeros((1, 3)))


def angles_to_rims(direction: FloatArray, rel: FloatArray, radius: float) -> FloatArray:
    """Angle by which directions (k, 3) are outside the region of each other (n, 3), by trigonometry: (k, n)."""
    distance = np.linalg.norm(rel, axis=-1)
    cosine = direction @ (rel / distance[:, None]).T
    outside = np.arccos(np.clip(cosine, -1, 1)) - np.arcsin(np.minimum(radius / distance, 1.0))
    return np.asarray(outside, dtype=np.float64)


def test_example_1_meets_agent_3_and_only_agent_3() -> None:
    """Fig. 3: the caption names agent 3, the text agent 2; the caption is right."""
    result = avoid(views_of([2.0, 3, 1], [2.0, 1, 2]), np.array([[2.0, 1, 3]]), SafetySphere(1.0, 10.0))
    assert result.in_the_way.tolist() == [[False, True]]
    assert not result.blocked[0]
    # By hand: agent 3 is acos(11 / sqrt(14 * 9)) off the direction, its cap is asin(1 / 3) wide.
    assert result.angle_rad[0] == pytest.approx(np.arcsin(1 / 3) - np.arccos(11 / np.sqrt(126.0)), abs=1e-7)
    assert np.linalg.norm(result.vel_flu_m_s) == pytest.approx(np.sqrt(14.0))


def test_agents_beyond_the_activation_distance_are_not_avoided() -> None:
    wanted = np.array([[2.0, 1, 3]])
    result = avoid(views_of([2.0, 3, 1], [2.0, 1, 2]), wanted, SafetySphere(1.0, 2.9))
    np.testing.assert_array_equal(result.vel_flu_m_s, wanted)
    assert not result.in_the_way.any()


def test_an_obstacle_has_a_larger_sphere_and_is_avoided_from_farther() -> None:
    plain, wanted = views_of([1.2, 0, 0], [0, 1.2, 0]), np.array([[0.3, 0, 0]])
    obstacle = dataclasses.replace(plain, extra_m=np.array([[0.15, 0.0]]))
    sphere = SafetySphere(0.45, 1.1)
    assert not avoid(plain, wanted, sphere).in_the_way.any()  # beyond 1.1 m
    result = avoid(obstacle, wanted, sphere)
    assert result.in_the_way.tolist() == [[True, False]]
    assert result.angle_rad[0] == pytest.approx(np.arcsin(0.6 / 1.2), abs=1e-8)


def test_one_sphere_ahead_by_hand() -> None:
    """Straight at the centre at twice the radius: 30 degrees to the right, keeping the speed."""
    result = avoid(views_of([0.9, 0, 0]), np.array([[0.3, 0, 0]]), SafetySphere(0.45, 1.0))
    np.testing.assert_allclose(result.vel_flu_m_s, [[0.3 * np.cos(np.pi / 6), -0.15, 0]], atol=1e-9)
    assert result.angle_rad[0] == pytest.approx(np.pi / 6, abs=1e-8)


@pytest.mark.parametrize("centre", [[0, 0, 0.48], [0, 0, -0.48], [0.3, -0.3, 0.2], [-0.48, 0, 0]])
def test_head_on_turns_square_to_the_line_and_opposite_ends_pass(centre: list[float]) -> None:
    line = np.array(centre)
    first = avoid(views_of(line), np.array([0.5 * line]), SPHERE).vel_flu_m_s[0]
    second = avoid(views_of(-line), np.array([-0.5 * line]), SPHERE).vel_flu_m_s[0]
    across = np.cross(line, first)
    assert np.linalg.norm(across) > 0.1 * np.linalg.norm(line) * np.linalg.norm(first)
    np.testing.assert_allclose(second, -first, atol=1e-12)


def test_between_two_spheres_the_way_leads_through_a_crossing_of_rims() -> None:
    # Two agents left and right ahead whose caps overlap: nearest way out is over or under the overlap.
    others = np.array([[0.48, 0.1, 0.0], [0.48, -0.1, 0.0]])
    result = avoid(views_of(*others), np.array([[0.2, 0.0, 0.01]]), SPHERE)
    outside = angles_to_rims(result.vel_flu_m_s / 0.2002498439, others, 0.45)[0]
    np.testing.assert_allclose(outside, 0.0, atol=1e-6)
    assert result.vel_flu_m_s[0, 2] > 0.0


def test_inside_a_sphere_one_may_only_part() -> None:
    inside = views_of([0.2, 0, 0])
    towards = avoid(inside, np.array([[0.3, 0.1, 0]]), SPHERE)
    assert towards.vel_flu_m_s[0, 0] <= 0.0
    np.testing.assert_allclose(towards.vel_flu_m_s[0, 1], np.sqrt(0.1), rtol=1e-6)
    away = np.array([[-0.3, 0.1, 0]])
    np.testing.assert_array_equal(avoid(inside, away, SPHERE).vel_flu_m_s, away)
    straight = avoid(inside, np.array([[0.3, 0, 0]]), SPHERE)  # the nearest way out is at 90 degrees: too far
    assert straight.blocked[0]
    assert not straight.vel_flu_m_s.any()


def test_surrounded_stands() -> None:
    around = [np.array(v) * 0.46 for v in ([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1])]
    result = avoid(views_of(*around), np.array([[0.3, 0.2, 0.1]]), SPHERE)
    assert result.blocked[0]
    assert result.angle_rad[0] == pytest.approx(np.pi / 2)
    assert result.vel_flu_m_s.tolist() == [[0, 0, 0]]


def test_standing_still_is_never_blocked() -> None:
    result = avoid(views_of([0.2, 0, 0]), np.zeros((1, 3)), SPHERE)
    assert not result.blocked[0]
    assert result.vel_flu_m_s.tolist() == [[0, 0, 0]]


def test_coincident_agents_may_move() -> None:
    wanted = np.array([[0.1, 0.0, 0.0]])
    np.testing.assert_array_equal(avoid(views_of([0.0, 0, 0]), wanted, SPHERE).vel_flu_m_s, wanted)


def test_identical_and_opposite_caps() -> None:
    twice = avoid(views_of([0.48, 0, 0], [0.48, 0, 0]), np.array([[0.3, 0.1, 0]]), SPHERE)
    once = avoid(views_of([0.48, 0, 0]), np.array([[0.3, 0.1, 0]]), SPHERE)
    np.testing.assert_allclose(twice.vel_flu_m_s, once.vel_flu_m_s, atol=1e-12)
    both = avoid(views_of([0.48, 0, 0], [-0.48, 0, 0]), np.array([[0.3, 0.1, 0]]), SPHERE)
    np.testing.assert_allclose(both.vel_flu_m_s, once.vel_flu_m_s, atol=1e-12)


def test_caps_that_touch() -> None:
    """Two caps of 30 degrees, 60 degrees apart: through the touching point nobody fits; around it one does."""
    a = 0.9 * np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0])
    b = 0.9 * np.array([np.cos(np.pi / 6), -np.sin(np.pi / 6), 0.0])
    result = avoid(views_of(a, b), np.array([[1.0, 0.2, 0.05]]), SafetySphere(0.45, 1.0))
    assert not result.blocked[0]
    direction = result.vel_flu_m_s / np.linalg.norm(result.vel_flu_m_s)
    assert angles_to_rims(direction, np.array([a, b]), 0.45).min() >= 0.0


@pytest.mark.parametrize(("radius", "activation"), [(0.5, 0.45), (0.0, 1.0), (np.nan, 1.0)])
def test_impossible_radii_are_refused(radius: float, activation: float) -> None:
    with pytest.raises(ValueError, match="safety sphere"):
        SafetySphere(radius, activation)


def test_what_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        avoid(views_of([1.0, 0, 0]), np.array([[np.nan, 0, 0]]), SPHERE)


def free(direction: FloatArray, rel: FloatArray, radius: float) -> BoolArray:
    """Whether directions (k, 3) are outside the regions of all others (n, 3): shape (k,)."""
    return np.asarray((angles_to_rims(direction, rel, radius) >= 0.0).all(axis=1), dtype=np.bool_)


def test_never_enters_and_never_turns_more_than_a_search_finds() -> None:
    rng, spread, radius = np.random.default_rng(2019), fibonacci_sphere(2000), 0.45
    cases, near = 2000, 6
    rel = rng.normal(size=(cases, near, 3))
    rel *= (radius * rng.choice([0.7, 1.0, 1.05, 1.3, 2.0], (cases, near)) / np.linalg.norm(rel, axis=-1))[..., None]
    # Most agents near the way ahead: that is where caps overlap.
    wanted = rng.normal(size=(cases, 3))
    rel += 0.3 * (wanted / np.linalg.norm(wanted, axis=1, keepdims=True))[:, None] * rng.random((cases, near, 1))
    seen = rng.random((cases, near)) < rng.uniform(0.2, 1.0, (cases, 1))
    rel[~seen] = np.nan
    views = LocalViews(rel, 0.0 * rel, seen, np.zeros((cases, 3)))
    result = avoid(views, wanted, SafetySphere(radius, 10.0))
    turned, excess = 0, []
    for i in range(cases):
        others = rel[i, seen[i]]
        unit = wanted[i] / np.linalg.norm(wanted[i])
        found = best_by_search(partial(free, rel=others, radius=radius), unit, spread, kept=20, tried=100)
        if result.blocked[i]:
            assert not result.vel_flu_m_s[i].any()
            assert found >= np.pi / 2 - 1e-3, i
            continue
        speed = np.linalg.norm(result.vel_flu_m_s[i])
        assert speed == pytest.approx(np.linalg.norm(wanted[i]), rel=1e-9)
        direction = result.vel_flu_m_s[i] / speed
        assert (angles_to_rims(direction[None], others, radius) >= -1e-9).all(), i
        angle = np.arctan2(np.linalg.norm(np.cross(unit, direction)), unit @ direction)
        assert result.angle_rad[i] == pytest.approx(angle, abs=1e-7)
        assert angle <= found + 1e-3, i
        if result.in_the_way[i].any():
            turned += 1
            excess.append(found - angle)
    # The cases exercise both answers, and the search is good enough to be a judge.
    assert turned > 500
    assert result.blocked.sum() > 50
    assert np.quantile(excess, 0.9) < 1e-2


@given(teams, st.integers(0, 2**32 - 1))
def test_team_at_once_is_agent_by_agent_to_the_bit(team: Team, seed: int) -> None:
    wanted = np.random.default_rng(seed).normal(0.0, 0.3, (team.size, 3))
    together = avoid(team.views, wanted, SafetySphere(0.45, 1.5))
    for i in range(team.size):
        alone = avoid(team.views.agent(i), wanted[i : i + 1], SafetySphere(0.45, 1.5))
        for f in dataclasses.fields(alone):
            np.testing.assert_array_equal(getattr(alone, f.name)[0], getattr(together, f.name)[i])


@given(teams, st.integers(0, 2**32 - 1))
def test_a_second_pass_changes_nothing(team: Team, seed: int) -> None:
    wanted = np.random.default_rng(seed).normal(0.0, 0.3, (team.size, 3))
    once = avoid(team.views, wanted, SafetySphere(0.45, 1.5)).vel_flu_m_s
    np.testing.assert_array_equal(avoid(team.views, once, SafetySphere(0.45, 1.5)).vel_flu_m_s, once)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000))
def test_proposition_1_as_the_step_goes_to_zero(seed: int) -> None:
    """A direction kept for one step of speed v overshoots a tangent by at most (2 v step)^2 / (2 r)."""
    start = random_start(np.random.default_rng(seed), 8, 2.5, 0.5, planar=seed % 2 == 0)
    step, speed = 0.01, 0.5
    chain = Chain(cube(), cube_gains(), 1.0, tick_s=step, speed_m_s=speed, activation_m=0.5)
    flight = fly(chain, KINEMATIC, start, np.random.default_rng(seed), seconds=2.0)
    assert flight.min_distance_m >= 0.45 - (2 * speed * step) ** 2 / (2 * 0.45) * 4


@dataclasses.dataclass(frozen=True)
class _LevelBall(SafetySphere):
    """A shape that nobody has heard of: blocks what a sphere does, and wants level axes."""

    by_distance: ClassVar[bool] = False


@given(teams, st.integers(0, 2**32 - 1))
def test_a_region_of_a_new_shape_answers_for_itself(team: Team, seed: int) -> None:
    wanted = np.random.default_rng(seed).normal(0.0, 0.3, (team.size, 3))
    known = avoid(team.views, wanted, SafetySphere(0.45, 1.5))
    own = avoid(team.views, wanted, _LevelBall(0.45, 1.5))
    np.testing.assert_array_equal(own.in_the_way, known.in_the_way)
    np.testing.assert_allclose(own.angle_rad, known.angle_rad, atol=1e-6)
