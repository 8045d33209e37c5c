"""Gridlocks: found from each agent's own view, left by swaps or detours, without chattering, never at r's expense."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from groundstation.core.detour import back_off, way_round
from groundstation.core.gridlock import GridlockParams, Gridlocks, Sensed
from groundstation.core.places import Places, own_places
from groundstation.core.types import FloatArray
from tests.core.lag_team import CRAZYFLIE, Chain, Flight, cube, cube_gains, fly, random_start, with_damper

TICK_S = 0.02
PARAMS = GridlockParams(speed_limit_m_s=0.5, keep_out_m=0.5, tick_s=TICK_S, settle_s=0.25)
TIGHT = dataclasses.replace(
    Chain(cube(), cube_gains(), 0.2, radius_m=0.8, activation_m=0.85, upright_1_s=1.0), swaps=True, detours=True
)


def _random_roles(seed: int, *, swaps: bool, detours: bool, seconds: float = 40.0) -> Flight:
    """Random start and fixed random roles, r = 0.8 of the side."""
    chain = with_damper(CRAZYFLIE, dataclasses.replace(TIGHT, swaps=swaps, detours=detours), 0.03)
    rng = np.random.default_rng(seed)
    start = random_start(rng, 8, 3.0, 0.88, planar=seed % 2 == 0)
    return fly(chain, CRAZYFLIE, start, rng, roles=rng.permutation(8), seconds=seconds)


@pytest.mark.parametrize("seed", [1, 3])
def test_fixed_random_roles_gridlock_without_a_way_out_and_form_with_swaps(seed: int) -> None:
    assert np.isnan(_random_roles(seed, swaps=False, detours=False, seconds=12.0).formed_s)
    flight = _random_roles(seed, swaps=True, detours=True)
    assert flight.formed_s < 20.0
    assert flight.min_distance_m >= 0.8
    assert flight.swaps
    assert flight.gridlocks >= len(flight.swaps)


@pytest.mark.parametrize("seed", [4])
def test_vehicles_that_are_not_interchangeable_get_out_by_detours(seed: int) -> None:
    flight = _random_roles(seed, swaps=False, detours=True, seconds=60.0)
    assert np.isfinite(flight.formed_s)
    assert flight.min_distance_m >= 0.8
    assert not flight.swaps
    assert flight.detours > 0


@pytest.mark.parametrize("seed", [3])
def test_swaps_do_not_chatter(seed: int) -> None:
    flight = _random_roles(seed, swaps=True, detours=False)
    assert flight.swaps
    latest: dict[int, float] = {}
    pairs: dict[tuple[int, int], float] = {}
    for now_s, i, j in flight.swaps:
        for agent in (i, j):
            assert now_s - latest.get(agent, -np.inf) >= PARAMS.pause_s - 1e-6
            latest[agent] = now_s
        assert now_s - pairs.get((i, j), -np.inf) >= PARAMS.undo_s - 1e-6
        pairs[i, j] = now_s


def _head_on(wish_m_s: float = 0.5) -> Sensed:
    """Two agents half a metre apart, each wishing to be where the other is, and one farther off that stands by."""
    pos = np.array([[0.0, 0, 1], [0.5, 0, 1], [0, 3, 1]])
    seen = np.array([[False, True, True], [True, False, True], [True, True, False]])
    held = np.array([[False, True, False], [True, False, False], [False, False, False]])
    return Sensed(
        rel_m=pos[None] - pos[:, None],
        visible=seen,
        vel_m_s=np.zeros((3, 3)),
        wish_m_s=wish_m_s * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 0, 0]]),
        in_the_way=held,
        low_m=np.full((3, 3), -5.0),
        high_m=np.full((3, 3), 5.0),
    )


def _places(wanted_m: FloatArray) -> Places:
    return Places(np.zeros((3, 3)), np.zeros((3, 3)), wanted_m)


OPPOSED = -_head_on().rel_m
ALL = np.ones(3, dtype=np.bool_)


def _until_locked(locks: Gridlocks, sensed: Sensed) -> float:
    for tick in range(1000):
        locks.sense(sensed, ~ALL)
        if locks.locked.any():
            return tick * TICK_S
    raise AssertionError("never locked in")


def test_whoever_wishes_to_move_and_does_not_is_locked_in_after_its_patience() -> None:
    locks = Gridlocks(3, PARAMS)
    took_s = _until_locked(locks, _head_on())
    assert PARAMS.patience_s <= took_s <= PARAMS.patience_s + PARAMS.memory_s
    assert locks.locked.tolist() == [True, True, False]
    assert locks.begun.tolist() == [True, True, False]
    locks.sense(_head_on(), ~ALL)
    assert not locks.begun.any()


@pytest.mark.parametrize(
    "change",
    [
        {"vel_m_s": np.array([[0.3, 0, 0], [-0.3, 0, 0], [0, 0, 0]])},
        {"in_the_way": np.zeros((3, 3), dtype=np.bool_)},
        {"wish_m_s": np.full((3, 3), 0.01)},
    ],
    ids=["gets on", "nobody in the way", "noise"],
)
def test_whoever_gets_on_or_has_nobody_in_the_way_is_not_locked_in(change: dict[str, FloatArray]) -> None:
    locks = Gridlocks(3, PARAMS)
    for _ in range(500):
        locks.sense(dataclasses.replace(_head_on(), **change), ~ALL)  # type: ignore[arg-type]
        assert not locks.locked.any()


def test_a_swap_needs_both_to_agree_and_is_not_undone_at_once() -> None:
    locks, sensed = Gridlocks(3, PARAMS), _head_on()
    _until_locked(locks, sensed)
    one_sided = OPPOSED.copy()
    one_sided[1] *= -1.0
    assert locks.swaps(sensed, _places(one_sided), ALL) == []
    assert locks.swaps(sensed, _places(OPPOSED), np.array([True, False, True])) == []
    assert locks.swaps(sensed, _places(OPPOSED), ALL) == [(0, 1)]
    # The worst that a view can say afterwards: that the new roles are the wrong ones, again and again.
    swapped_s = []
    for tick in range(round(4 * PARAMS.undo_s / TICK_S)):
        locks.sense(sensed, ~ALL)
        if locks.swaps(sensed, _places(OPPOSED), ALL):
            swapped_s.append(tick * TICK_S)
    assert len(swapped_s) <= 4
    assert min(np.diff([0.0, *swapped_s])) >= PARAMS.undo_s - 2 * TICK_S


def test_lines_nearly_square_to_each_other_are_no_reason_to_swap() -> None:
    locks, sensed = Gridlocks(3, PARAMS), _head_on()
    _until_locked(locks, sensed)
    square = np.zeros((3, 3, 3))
    square[0, 1] = [-0.05, 0.5, 0]
    square[1, 0] = [0.05, -0.5, 0]
    assert locks.swaps(sensed, _places(square), ALL) == []


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.permutations(range(8)))
def test_every_swap_makes_the_ways_of_the_pair_shorter(seed: int, roles: list[int]) -> None:
    rng = np.random.default_rng(seed)
    pos, points = rng.uniform(-1.5, 1.5, (8, 3)), cube().points_enu_m[roles]
    seen = ~np.eye(8, dtype=np.bool_)
    rel = pos[None] - pos[:, None]
    everybody = np.ones(8, dtype=np.bool_)
    sensed = Sensed(rel, seen, np.zeros((8, 3)), rng.normal(0, 0.5, (8, 3)), seen, rel[0] - 9.0, rel[0] + 9.0)
    own = own_places(rel, seen, points)
    locks = Gridlocks(8, PARAMS)
    for _ in range(200):
        locks.sense(sensed, ~everybody)
    pairs = locks.swaps(sensed, own, everybody)
    agents = [agent for pair in pairs for agent in pair]
    assert len(agents) == len(set(agents))
    target = pos + own.to_own_m  # everybody sees everybody here: all have laid the formation over the same points
    for i, j in pairs:
        before = np.sum((pos[i] - target[i]) ** 2) + np.sum((pos[j] - target[j]) ** 2)
        after = np.sum((pos[i] - target[j]) ** 2) + np.sum((pos[j] - target[i]) ** 2)
        assert after < before


def test_one_of_those_who_hold_each_other_sets_out_and_the_other_waits() -> None:
    locks, sensed = Gridlocks(3, PARAMS), _head_on()
    _until_locked(locks, sensed)
    goals = np.array([[0.0, 1.5, 0], [0, -1.5, 0], [0, 0, 0]])
    first = locks.begin_detours(sensed, goals, ~ALL, PARAMS.patience_s, rarer=True)
    assert len(first) == 1
    locks.sense(sensed, ~ALL)
    assert locks.begin_detours(sensed, goals, ~ALL, PARAMS.patience_s, rarer=True) == []
    wish = locks.wishes(np.zeros((3, 3)))
    assert np.isfinite(wish[first[0]]).all()
    assert np.isnan(np.delete(wish, first[0], axis=0)).all()
    # Its way ends by itself when it does not get anywhere.
    for _ in range(2000):
        wish = locks.wishes(np.zeros((3, 3)))
    assert np.isnan(wish).all()


@pytest.mark.parametrize("rarer", [True, False])
def test_whoever_is_sent_off_again_and_again_waits_longer_each_time(*, rarer: bool) -> None:
    locks, sensed = Gridlocks(3, PARAMS), _head_on()
    goals = np.array([[0.0, 1.5, 0], [0, -1.5, 0], [0, 0, 0]])
    only_first = np.array([False, True, True])
    sent_s: list[float] = []
    for tick in range(10_000):
        locks.sense(sensed, only_first)
        locks.wishes(np.zeros((3, 3)))
        if not locks.detours[0] and locks.begin_detours(sensed, goals, only_first, PARAMS.patience_s, rarer=rarer):
            sent_s.append(tick * TICK_S)
    gaps_s = np.diff(sent_s).tolist()
    assert len(gaps_s) >= 12
    if rarer:
        assert all(gap_s >= PARAMS.patience_s * k - 1e-9 for k, gap_s in enumerate(gaps_s, start=1))
        assert gaps_s[-1] > 1.5 * max(gaps_s[:6])
    else:
        assert max(gaps_s[6:]) <= max(gaps_s[:6]) + TICK_S
    locks.forget()
    assert _until_locked(locks, sensed) <= PARAMS.patience_s + PARAMS.memory_s


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
@example(46167, 1)  # one alone in the way: points close around it are not enough
@example(302, 2)
def test_ways_round_keep_their_distance(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    goal = rng.uniform(-2, 2, 3)
    others = rng.uniform(-2, 2, (count, 3))
    others = others[(np.linalg.norm(others, axis=1) > 0.55) & (np.linalg.norm(others - goal, axis=1) > 0.55)]
    way = way_round(goal, others, 0.5, np.full(3, -4.0), np.full(3, 4.0))
    assert way is not None
    np.testing.assert_allclose(way[-1], goal)
    corners = np.concatenate([np.zeros((1, 3)), way])
    assert np.all(np.abs(corners) <= 4.0)
    if len(others) > 8:
        return  # only the nearest to the line are gone round; the others are met by the next plan
    share = np.linspace(0.0, 1.0, 60)[:, None]
    for start, end in itertools.pairwise(corners):
        line = start + share * (end - start)
        assert np.linalg.norm(line[:, None] - others[None], axis=2).min(initial=np.inf) >= 0.5 - 1e-9


def test_where_there_is_no_way_it_says_so() -> None:
    around = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)])
    walls = 0.6 * around[np.abs(around).sum(axis=1) == 1]
    assert way_round(np.array([0.0, 3, 0]), walls.astype(np.float64), 0.59, np.full(3, -5.0), np.full(3, 5.0)) is None
    np.testing.assert_allclose(back_off(np.array([[0.5, 0, 0]])), [-1, 0, 0])
    np.testing.assert_allclose(back_off(np.zeros((0, 3))), [0, 0, 1])


@given(st.floats(-np.pi, np.pi), st.tuples(*[st.floats(-20, 20)] * 3), st.permutations(range(8)), st.data())
def test_in_formation_every_agent_finds_its_own_place_from_what_it_sees(
    yaw: float, shift: tuple[float, float, float], roles: list[int], data: st.DataObject
) -> None:
    points = cube().points_enu_m[roles]
    cos, sin = np.cos(yaw), np.sin(yaw)
    turned = points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    pos = turned + np.array(shift)
    seen = cube().adjacency[np.ix_(roles, roles)]
    own = own_places(pos[None] - pos[:, None], seen, points)
    np.testing.assert_allclose(own.to_own_m, 0.0, atol=1e-9)
    np.testing.assert_allclose(own.from_centre_m, turned - turned.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(own.wanted_m, turned[None] - turned[:, None], atol=1e-9)
    agent = data.draw(st.integers(0, 7))
    alone = own_places((pos[None] - pos[:, None])[[agent]], seen[[agent]], points, slice(agent, agent + 1))
    np.testing.assert_array_equal(alone.from_centre_m[0], own.from_centre_m[agent])
    np.testing.assert_array_equal(alone.to_own_m[0], own.to_own_m[agent])
    twice = own_places(2.0 * (pos[None] - pos[:, None]), seen, points, free_scale=True)
    np.testing.assert_allclose(twice.from_centre_m, 2.0 * own.from_centre_m, atol=1e-9)


def test_agents_that_see_only_those_near_are_locked_in_as_with_a_column_for_everybody() -> None:
    rng, n = np.random.default_rng(5), 6
    who = np.array([[1, 2], [0, 2], [0, 1], [4, 5], [3, 5], [3, 4]])
    few, all_of_them = Gridlocks(n, PARAMS), Gridlocks(n, PARAMS)
    nobody = np.zeros(n, dtype=np.bool_)
    was_locked = nobody
    for _ in range(400):
        near = Sensed(
            rel_m=rng.normal(size=(n, 2, 3)),
            visible=rng.random((n, 2)) < 0.95,
            vel_m_s=np.zeros((n, 3)),
            wish_m_s=np.tile([0.4, 0.0, 0.0], (n, 1)),
            in_the_way=rng.random((n, 2)) < [[0.9, 0.1]],
            low_m=np.full((n, 3), -5.0),
            high_m=np.full((n, 3), 5.0),
            who=who,
        )
        full = near.of_all()
        assert full.visible.sum() == near.visible.sum()
        assert full.of_all() is full
        few.sense(near, nobody)
        all_of_them.sense(full, nobody)
        np.testing.assert_array_equal(few.locked, all_of_them.locked)
        was_locked = was_locked | few.locked
    assert was_locked.all()
    goals = np.tile([1.0, 0.0, 0.0], (n, 1))
    assert few.begin_detours(full, goals, nobody, 0.1, rarer=True) == all_of_them.begin_detours(
        full, goals, nobody, 0.1, rarer=True
    )
    places = Places(np.zeros((n, 3)), np.zeros((n, 3)), -full.rel_m)
    assert few.swaps(full, places, ~nobody) == all_of_them.swaps(full, places, ~nobody)
