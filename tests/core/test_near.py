"""Views of those near, for large teams: the same neighbours, the same answers as from all pairs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.core import frames
from groundstation.core.avoidance import avoid
from groundstation.core.control import ScaleFunction, Task, formation_control
from groundstation.core.damper import DamperParams, damp
from groundstation.core.near import near_views, views_of
from groundstation.core.places import own_places
from groundstation.core.regions import SafetySphere
from groundstation.core.views import LocalViews, local_views
from tests.core.strategies import Team, random_team

PARAMS = DamperParams(0.45, 0.03, 0.2, 0.05, 0.02, 0.5, 4.0)
crowds = st.builds(random_team, st.integers(0, 2**32 - 1), st.integers(1, 90), st.sampled_from([3.0, 5.0, 50.0]))


def all_pairs(team: Team, reach_m: float) -> LocalViews:
    offset = team.pos_ned_m[None] - team.pos_ned_m[:, None]
    near = np.asarray((offset**2).sum(axis=-1) < reach_m**2, dtype=np.bool_)
    return local_views(team.pos_ned_m, team.vel_ned_m_s, team.quat, near)


@settings(max_examples=30, deadline=None)
@given(crowds, st.floats(0.3, 3.0))
def test_the_same_are_seen_in_the_same_places(team: Team, reach_m: float) -> None:
    dense, near = all_pairs(team, reach_m), near_views(team.pos_ned_m, team.vel_ned_m_s, team.quat, reach_m)
    np.testing.assert_array_equal(near.spread(near.views.visible), dense.visible)
    rows, columns = np.nonzero(near.views.visible)
    who = near.who[rows, columns]
    np.testing.assert_array_equal(near.views.rel_pos_flu_m[rows, columns], dense.rel_pos_flu_m[rows, who])
    np.testing.assert_array_equal(near.views.rel_vel_flu_m_s[rows, columns], dense.rel_vel_flu_m_s[rows, who])
    np.testing.assert_array_equal(near.views.vel_flu_m_s, dense.vel_flu_m_s)
    np.testing.assert_array_equal(near.views.up_flu, dense.up_flu)
    assert np.isnan(near.views.rel_pos_flu_m[~near.views.visible]).all()


@settings(max_examples=10, deadline=None)
@given(crowds, st.integers(0, 2**32 - 1))
def test_avoidance_and_damper_answer_the_same(team: Team, seed: int) -> None:
    reach_m, sphere = 1.4, SafetySphere(0.48, 0.6)
    dense, near = all_pairs(team, reach_m), near_views(team.pos_ned_m, team.vel_ned_m_s, team.quat, reach_m)
    wanted = np.random.default_rng(seed).normal(0.0, 0.3, (team.size, 3))
    expected, got = avoid(dense, wanted, sphere), avoid(near.views, wanted, sphere)
    np.testing.assert_allclose(got.vel_flu_m_s, expected.vel_flu_m_s, atol=1e-12)
    np.testing.assert_array_equal(near.spread(got.in_the_way), expected.in_the_way)
    np.testing.assert_array_equal(got.blocked, expected.blocked)
    # Solved by columns in another arrangement: the same polyhedron, rounded otherwise.
    slowed, damped = damp(dense, wanted, PARAMS), damp(near.views, wanted, PARAMS)
    np.testing.assert_allclose(damped.vel_flu_m_s, slowed.vel_flu_m_s, atol=1e-6)
    np.testing.assert_array_equal(near.spread(damped.in_the_way), slowed.in_the_way)


def test_unknown_positions_see_nobody_and_further_pairs_are_added() -> None:
    pos = np.array([[0.0, 0, 0], [0.5, 0, 0], [9.0, 0, 0], [np.nan, 0, 0]])
    others = np.zeros((4, 4), dtype=np.bool_)
    others[0, 2] = others[0, 1] = others[1, 1] = others[1, 3] = True
    near = near_views(pos, np.zeros((4, 3)), np.tile([1.0, 0, 0, 0], (4, 1)), 1.0, others=others)
    assert near.spread(near.views.visible).tolist() == [
        [False, True, True, False],
        [True, False, False, False],
        [False, False, False, False],
        [False, False, False, False],
    ]
    nobody = near_views(pos[3:], np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), 1.0)
    assert not nobody.views.visible.any()
    with pytest.raises(ValueError, match="reach"):
        near_views(pos, np.zeros((4, 3)), np.tile([1.0, 0, 0, 0], (4, 1)), 0.0)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 30), free=st.booleans())
def test_the_law_and_places_are_the_same_with_columns_for_neighbours_alone(seed: int, n: int, *, free: bool) -> None:
    rng = np.random.default_rng(seed)
    team = random_team(seed, n, 5.0)
    graph = np.triu(rng.random((n, n)) < 0.3, 1)
    gains, points = rng.normal(size=(3, n, n)), rng.normal(size=(n, 3))
    task = Task(gains[0] + 1j * gains[1], gains[2], graph | graph.T, np.abs(gains[0]), gains[1])
    near, who = task.near
    dense = local_views(team.pos_ned_m, team.vel_ned_m_s, team.quat, task.neighbours)
    rot = frames.rot_ned_from_flu(team.quat)
    few = views_of(team.pos_ned_m, team.vel_ned_m_s, rot, who, near.neighbours)
    assert few.visible.sum() == dense.visible.sum()
    scale = ScaleFunction(kind="arctan", gain=2.5)
    by_few = formation_control(few, near, scale, lead_s=0.1, upright_1_s=0.5)
    by_all = formation_control(dense, task, scale, lead_s=0.1, upright_1_s=0.5)
    np.testing.assert_allclose(by_few, by_all, atol=1e-9)
    places = own_places(few.rel_pos_flu_m, few.visible, points, who=who, free_scale=free)
    expected = own_places(dense.rel_pos_flu_m, dense.visible, points, free_scale=free)
    np.testing.assert_allclose(places.to_own_m, expected.to_own_m, atol=1e-6)
    np.testing.assert_allclose(places.from_centre_m, expected.from_centre_m, atol=1e-6)
