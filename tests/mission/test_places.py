"""Which place is free: against a search by brute force, and what is given to whom where there is little."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.mission.flight.places import Box, allot, farthest, nearest_free, taken_at

BOX = Box(np.array([-1.0, -1.0]), np.array([1.0, 1.0]))
places = st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)), min_size=0, max_size=6)


@given(others=places, start=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)), clear_m=st.floats(0.1, 1.2))
@settings(max_examples=60, deadline=None)
def test_the_nearest_free_place_is_free_inside_and_hardly_farther_than_any_other(
    others: list[tuple[float, float]], start: tuple[float, float], clear_m: float
) -> None:
    at_m = np.array(others).reshape(-1, 2)
    taken = taken_at(np.arange(len(at_m)), at_m, clear_m)
    found = nearest_free(np.array(start), taken, BOX)
    axis = np.linspace(-1.0, 1.0, 81)
    every = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    away_m = np.linalg.norm(every[:, None] - at_m[None], axis=2).min(axis=1, initial=np.inf)
    free = every[away_m >= clear_m]
    if found is None:
        assert len(every[away_m >= clear_m + 0.06]) == 0
        assert farthest(np.array(start), taken, BOX)[1] < 0.0
        return
    assert (np.abs(found) <= 1.0).all()
    assert np.linalg.norm(found - at_m, axis=1).min(initial=np.inf) >= clear_m - 1e-5
    if len(every[away_m >= clear_m + 0.06]):
        roomy = every[away_m >= clear_m + 0.06]
        best_m = np.linalg.norm(roomy - start, axis=1).min()
        assert np.linalg.norm(found - start) <= best_m + 0.08
    assert len(free) or farthest(np.array(start), taken, BOX)[1] >= -1e-5


def test_what_is_not_known_takes_no_place() -> None:
    taken = taken_at([0, 1], np.array([[np.nan, 0.0], [0.5, 0.0]]), 0.4)
    assert taken.who.tolist() == [1]
    assert taken.in_the_way(np.array([0.2, 0.0])) == 1
    assert taken.in_the_way(np.array([0.0, 0.0])) is None


def _allotted(half_m: float, pads: list[list[float]]) -> tuple[list[list[float]], list[bool]]:
    """Three in a column above the middle, of which the lowest is the last one."""
    column = np.array([[0.0, 0.0, -3.0], [0.05, 0.0, -2.0], [0.0, 0.05, -1.0]])
    box = Box(np.array([-half_m, -half_m]), np.array([half_m, half_m]))
    movable = np.ones(3, dtype=np.bool_)
    nobody = taken_at([], column, 0.5)
    given_m, to_pad = allot(column, np.array(pads), movable, nobody, need_m=0.5, wish_m=0.7, box=box)
    return given_m.round(3).tolist(), to_pad.tolist()


def test_the_lowest_stays_the_others_move_aside() -> None:
    given_m, to_pad = _allotted(3.0, [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    assert given_m[2] == [0.0, 0.05]
    apart_m = [np.linalg.norm(np.subtract(given_m[i], given_m[j])) for i, j in ((0, 1), (0, 2), (1, 2))]
    assert min(apart_m) >= 0.7 - 1e-3
    assert to_pad == [False, False, False]


def test_who_finds_no_place_takes_its_pad_and_where_that_is_taken_all_do() -> None:
    given_m, to_pad = _allotted(0.1, [[0.6, 0.0, 0.0], [0.0, 0.6, 0.0], [-0.6, 0.0, 0.0]])
    assert given_m == [[0.6, 0.0], [0.0, 0.6], [0.0, 0.05]]
    assert to_pad == [True, True, False]
    pads = [[0.4, 0.0, 0.0], [-0.4, 0.0, 0.0], [0.0, 0.9, 0.0]]
    given_m, to_pad = _allotted(0.1, pads)
    assert given_m == [pad[:2] for pad in pads]
    assert to_pad == [True, True, True]
