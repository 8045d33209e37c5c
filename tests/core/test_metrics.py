"""Numbers that monitors and reports stand on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.core import metrics
from groundstation.core.formation import Formation
from groundstation.core.regions import SafetyCylinder, SafetySphere
from tests.core.lag_team import cube


def test_formation_error_by_hand() -> None:
    roles = np.array([3, 1, 0, 2, 7, 6, 5, 4])
    pos = cube().points_enu_m[roles]
    assert metrics.formation_error_m(pos, cube().distances_m, roles) == pytest.approx(0.0, abs=1e-12)
    pos[2] -= [0.0, 0.0, 0.3]  # role 0 sinks by 0.3: the edge above it grows from 1 to 1.3
    assert metrics.formation_error_m(pos, cube().distances_m, roles) == pytest.approx(0.3)
    pos[2, 0] = np.nan
    assert np.isnan(metrics.formation_error_m(pos, cube().distances_m, roles))
    assert metrics.formation_error_m(np.zeros((1, 3)), np.zeros((1, 1)), np.array([0])) == 0.0


def test_clearance_is_in_the_norm_of_the_region() -> None:
    pos = np.array([[0.0, 0, 0], [0, 0, 0.9], [2, 0, 0], [np.nan, 0, 0]])
    counted = np.array([True, False, True, True])
    assert metrics.min_clearance(pos, SafetySphere(0.5, 0.5)) == 1.8
    assert metrics.min_clearance(pos, SafetyCylinder(0.5, 0.5, 1.0)) == 0.9
    assert metrics.min_clearance(pos, SafetyCylinder(0.5, 0.5, 1.0), counted) == 4.0
    assert metrics.min_clearance(pos[:1], SafetyCylinder(0.5, 0.5, 1.0)) == np.inf
    assert metrics.min_clearance(pos[:1], SafetySphere(0.5, 0.5)) == np.inf


def test_min_distance_counts_who_counts() -> None:
    pos = np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 1], [np.nan, 0, 0]])
    assert metrics.min_distance_m(pos) == 1.0
    assert metrics.min_distance_m(pos, np.array([True, True, False, True])) == 5.0
    assert metrics.min_distance_m(pos, np.array([True, False, False, True])) == float("inf")


def test_whoever_flies_counts_against_those_that_stand() -> None:
    pos = np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 1], [np.nan, 0, 0]])
    nobody, one = np.zeros(4, dtype=np.bool_), np.array([True, False, False, False])
    assert metrics.min_distance_m(pos, flying=nobody) == float("inf")
    assert metrics.min_distance_m(pos, flying=one) == 5.0  # the two that stand 1 m apart are as they were put
    assert metrics.min_distance_m(pos, flying=np.array([False, False, True, True])) == 1.0
    assert metrics.min_distance_m(pos, ~one, flying=one) == float("inf")
    assert metrics.min_clearance(pos, SafetyCylinder(0.5, 0.5, 1.0), flying=one) == 10.0
    assert metrics.min_clearance(pos, SafetySphere(0.5, 0.5), flying=one) == 10.0


def test_pair_distances_of_a_whole_log_at_once() -> None:
    log = np.random.default_rng(0).normal(size=(5, 3, 3))
    distances = metrics.pair_distances_m(log)
    assert distances.shape == (5, 3, 3)
    assert distances[4, 0, 2] == pytest.approx(np.linalg.norm(log[4, 0] - log[4, 2]))


@given(st.permutations(range(8)), st.floats(-10, 10), st.floats(0.1, 3))
def test_upside_down_is_told_from_upright(order: list[int], shift: float, size: float) -> None:
    roles, heights = np.array(order), cube().points_enu_m[:, 2]
    upright = size * heights[roles] + shift
    assert metrics.vertical_orientation(upright, heights, roles) == pytest.approx(1.0)
    assert metrics.vertical_orientation(-upright, heights, roles) == pytest.approx(-1.0)
    assert metrics.vertical_orientation(np.zeros(8), heights, roles) == 0.0


def test_sizes_are_told_level_and_upright_whoever_stands_where() -> None:
    points = cube().points_enu_m
    pos = np.random.default_rng(1).permutation(points) * [0.7, -0.7, -1.3] + [5.0, 6.0, 7.0]
    assert metrics.size_ratios(pos, points) == pytest.approx((0.7, 1.3))
    level, upright = metrics.size_ratios(pos, points * [1.0, 1.0, 0.0])
    assert level == pytest.approx(0.7)
    assert np.isnan(upright)
    pos[0, 2] = np.nan
    assert np.isnan(metrics.size_ratios(pos, points)[1])


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(64, 90))
def test_in_large_teams_a_search_finds_what_all_pairs_would(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    pos, region = rng.uniform(-2.0, 2.0, (n, 3)).round(1), SafetySphere(0.5, 0.5)  # some stand in one place
    pos[rng.random(n) < 0.1] = np.nan
    counted, flying = rng.random(n) < 0.7, rng.random(n) < 0.5
    here = np.isfinite(pos[:, 0]) & counted
    wanted = here[:, None] & here[None] & (flying[:, None] | flying[None]) & ~np.eye(n, dtype=np.bool_)
    expected = metrics.pair_distances_m(pos)[wanted].min(initial=np.inf)
    assert metrics.min_distance_m(pos, counted, flying=flying) == pytest.approx(expected, abs=1e-12)
    first, second = metrics.near_pairs(pos, region.reach_m(0.0))
    found = set(zip(first.tolist(), second.tolist(), strict=True))
    near = np.argwhere(np.triu(metrics.pair_distances_m(pos) < region.reach_m(0.0), 1))
    assert {(int(i), int(j)) for i, j in near} <= found
    assert sorted(found) == list(zip(first.tolist(), second.tolist(), strict=True))


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.05, 1.0]), st.sampled_from([1.0, 1.3]))
def test_the_error_of_a_large_team_is_that_of_all_its_pairs(seed: int, noise_m: float, size: float) -> None:
    rng, n = np.random.default_rng(seed), 70
    points = np.stack(np.meshgrid(range(5), range(5), range(3), indexing="ij"), axis=-1).reshape(-1, 3)[:n] * 1.0
    formation = Formation("grid", points, ())
    roles, turn = rng.permutation(n), np.linalg.qr(rng.normal(size=(3, 3)))[0]  # a mirror, half of the time
    pos = size * points[roles] @ turn + rng.normal(0.0, 1.0, (n, 3)) * noise_m + 7.0
    expected = metrics.formation_error_m(pos, formation.distances_m, roles)
    assert metrics.team_error_m(pos, formation, roles) == pytest.approx(expected, abs=1e-9)
    pos[3, 1] = np.nan
    assert np.isnan(metrics.team_error_m(pos, formation, roles))
