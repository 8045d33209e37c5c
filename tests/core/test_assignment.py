"""Assignment: found again when turned, moved and shuffled; never worse than trying everything."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.core import frames
from groundstation.core.assignment import assign_roles, fixed_roles, place
from groundstation.core.formation import Formation
from tests.core.lag_team import cube, random_start

IRREGULAR = Formation(
    "irregular", np.array([[0.0, 0, 0], [1, 0, 0.2], [1.5, 1, 0], [-0.3, 0.8, 0.7], [0.4, 2, 1], [2, 2, 0.1]]), ()
)


GRID = np.array([[x, y, z] for x in range(3) for y in range(3) for z in range(3)], dtype=np.float64)
MISSED = [25, 43, 48]


@settings(max_examples=40)
@given(st.floats(-np.pi, np.pi), st.tuples(*[st.floats(-50, 50)] * 3), st.permutations(range(6)))
def test_a_turned_moved_and_shuffled_formation_is_recognised(
    yaw: float, shift: tuple[float, float, float], order: list[int]
) -> None:
    pos = place(IRREGULAR.points_enu_m, yaw, np.array(shift))[order]
    found = assign_roles(pos, IRREGULAR)
    assert found.role_of_agent.tolist() == order
    assert found.cost_m2 == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(found.targets_team_enu_m(IRREGULAR), pos, atol=1e-6)
    np.testing.assert_allclose(frames.wrap_angle(np.array(found.yaw_enu_rad - yaw)), 0.0, atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_no_permutation_with_its_best_heading_is_better(seed: int) -> None:
    pos = np.random.default_rng(seed).uniform(-1.5, 1.5, (6, 3))
    least = min(fixed_roles(pos, IRREGULAR, np.array(order)).cost_m2 for order in permutations(range(6)))
    assert assign_roles(pos, IRREGULAR).cost_m2 == pytest.approx(least, rel=1e-9)


def _least_cost(pos: np.ndarray, points: np.ndarray) -> float:
    """The least sum of squares over all permutations, each with its best heading and place."""
    p, q = pos - pos.mean(axis=0), points - points.mean(axis=0)
    orders = np.array(list(permutations(range(len(p)))))
    level = np.abs((np.conj(p[:, 0] + 1j * p[:, 1]) * (q[:, 0] + 1j * q[:, 1])[orders]).sum(axis=1))
    upright = (p[:, 2] * q[:, 2][orders]).sum(axis=1)
    return float((p**2).sum() + (q**2).sum() - 2.0 * (level + upright).max())


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 7), st.booleans(), st.sampled_from(["any", "grid", "ring"]))
def test_trying_everything_finds_nothing_better(seed: int, n: int, level: bool, kind: str) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.5, 1.5, (n, 3))
    if kind == "grid":
        points = np.round(points)
    elif kind == "ring":
        turn = 2.0 * np.pi * np.arange(n) / n
        points = np.stack([np.cos(turn), np.sin(turn), 0.5 * (np.arange(n) % 2)], axis=1)
    pos = rng.uniform(-2.0, 2.0, (n, 3))
    if level:
        pos[:, 2] = 0.5
    found = assign_roles(pos, Formation(kind, points, ()))
    least = _least_cost(pos, points)
    assert found.cost_m2 <= least + 1e-6 * (1.0 + least)


@pytest.mark.parametrize("seed", MISSED)
def test_what_evenly_spread_headings_miss_is_found(seed: int) -> None:
    """Teams of 27 in which the best roles belong to a narrow range of headings between two of the 36 tried."""
    rng = np.random.default_rng(seed)
    points = GRID if seed % 2 == 0 else rng.uniform(-1.5, 1.5, (27, 3))
    pos = rng.uniform(-2.0, 2.0, (27, 3))
    if seed % 3 == 0:
        pos[:, 2] = 0.5
    formation = Formation("27", points, ())
    more = assign_roles(pos, formation, yaw_starts=360).cost_m2
    assert assign_roles(pos, formation).cost_m2 <= more * (1.0 + 1e-9)


@given(st.integers(0, 2**32 - 1), st.permutations(range(6)))
def test_fixed_roles_have_the_best_heading_and_place(seed: int, order: list[int]) -> None:
    rng = np.random.default_rng(seed)
    pos = rng.uniform(-1.5, 1.5, (6, 3))
    found = fixed_roles(pos, IRREGULAR, np.array(order))

    def cost(yaw: float, translation: np.ndarray) -> float:
        return float(((place(IRREGULAR.points_enu_m[order], yaw, translation) - pos) ** 2).sum())

    assert cost(found.yaw_enu_rad, found.translation_team_enu_m) == pytest.approx(found.cost_m2, abs=1e-9)
    for _ in range(20):
        yaw, translation = found.yaw_enu_rad + rng.normal(), found.translation_team_enu_m + rng.normal(0, 0.1, 3)
        assert cost(yaw, found.translation_team_enu_m) >= found.cost_m2 - 1e-9
        assert cost(found.yaw_enu_rad, translation) >= found.cost_m2 - 1e-9


def test_same_positions_same_answer() -> None:
    pos = frames.enu_from_ned(random_start(np.random.default_rng(1), 8, 3.0, 0.5, planar=True))
    first, second = assign_roles(pos, cube()), assign_roles(pos, cube())
    np.testing.assert_array_equal(first.role_of_agent, second.role_of_agent)
    assert first.yaw_enu_rad == second.yaw_enu_rad


def test_wrong_input_is_refused() -> None:
    with pytest.raises(ValueError, match="needs"):
        assign_roles(np.zeros((7, 3)), cube())
    with pytest.raises(ValueError, match="unknown"):
        assign_roles(np.full((8, 3), np.nan), cube())
    with pytest.raises(ValueError, match="headings"):
        assign_roles(np.zeros((8, 3)), cube(), yaw_starts=0)
    with pytest.raises(ValueError, match="no permutation"):
        fixed_roles(np.zeros((6, 3)), IRREGULAR, np.array([0, 1, 2, 3, 4, 4]))
