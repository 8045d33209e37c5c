"""Views: the right numbers in the right frame, and nothing of what is not seen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given

from groundstation.core import frames
from groundstation.core.views import LocalViews, distances_m, local_views
from tests.core.strategies import Team, teams


def test_relative_position_in_the_own_frame_by_hand() -> None:
    # Agent 0 hovers at the origin facing east; agent 1 is 1 m north, 2 m east, 3 m above, flying down at 0.5 m/s.
    quat = frames.quat_ned_from_frd_of_euler(np.zeros(2), np.zeros(2), np.array([np.pi / 2, np.pi]))
    views = local_views(
        np.array([[0.0, 0, 0], [1, 2, -3]]), np.array([[0.1, 0, 0], [0, 0, 0.5]]), quat, np.ones((2, 2), dtype=np.bool_)
    )
    np.testing.assert_allclose(views.rel_pos_flu_m[0, 1], [2, 1, 3], atol=1e-12)  # ahead, left, above
    np.testing.assert_allclose(views.rel_vel_flu_m_s[0, 1], [0, -0.1, -0.5], atol=1e-12)
    np.testing.assert_allclose(views.vel_flu_m_s[0], [0, 0.1, 0], atol=1e-12)
    # Agent 1 faces south: agent 0 is south (ahead), west (right, so minus left) and below.
    np.testing.assert_allclose(views.rel_pos_flu_m[1, 0], [1, -2, -3], atol=1e-12)


@given(teams)
def test_what_is_not_seen_is_nan(team: Team) -> None:
    views = team.views
    assert not views.visible.diagonal().any()
    np.testing.assert_array_equal(views.visible, team.sensed & ~np.eye(team.size, dtype=np.bool_))
    assert np.isnan(views.rel_pos_flu_m[~views.visible]).all()
    assert np.isnan(views.rel_vel_flu_m_s[~views.visible]).all()
    assert np.isfinite(views.rel_pos_flu_m[views.visible]).all()


@given(teams)
def test_an_unknown_position_is_seen_by_nobody(team: Team) -> None:
    pos = team.pos_ned_m.copy()
    pos[0] = np.nan
    views = dataclasses.replace(team, pos_ned_m=pos).views
    assert not views.visible[0].any()
    assert not views.visible[:, 0].any()
    np.testing.assert_array_equal(views.visible[1:, 1:], team.views.visible[1:, 1:])


@given(teams)
def test_an_unknown_velocity_leaves_the_position_visible(team: Team) -> None:
    vel = team.vel_ned_m_s.copy()
    vel[0] = np.nan
    views = dataclasses.replace(team, vel_ned_m_s=vel).views
    np.testing.assert_array_equal(views.visible, team.views.visible)
    assert np.isnan(views.rel_vel_flu_m_s[1:, 0]).all()


@given(teams)
def test_distances_do_not_depend_on_the_frame(team: Team) -> None:
    seen = distances_m(team.views)
    true = np.linalg.norm(team.pos_ned_m[:, None] - team.pos_ned_m, axis=-1)
    np.testing.assert_allclose(seen[team.views.visible], true[team.views.visible], rtol=1e-12, atol=1e-12)


@given(teams)
def test_one_agents_view_is_its_row(team: Team) -> None:
    own = team.views.agent(1)
    assert (own.viewers, own.team_size) == (1, team.size)
    np.testing.assert_array_equal(own.rel_pos_flu_m[0], team.views.rel_pos_flu_m[1])
    np.testing.assert_array_equal(own.vel_flu_m_s[0], team.views.vel_flu_m_s[1])


def test_arrays_that_do_not_belong_together_are_refused() -> None:
    seen = np.zeros((2, 3), dtype=np.bool_)
    with pytest.raises(ValueError, match="do not fit"):
        LocalViews(np.zeros((2, 2, 3)), np.zeros((2, 3, 3)), seen, np.zeros((2, 3)))
    with pytest.raises(ValueError, match="own velocities"):
        LocalViews(np.zeros((2, 3, 3)), np.zeros((2, 3, 3)), seen, np.zeros((3, 3)))
    with pytest.raises(ValueError, match="sensed"):
        local_views(np.zeros((2, 3)), np.zeros((2, 3)), np.ones((2, 4)), seen)
    with pytest.raises(ValueError, match="poses"):
        local_views(np.zeros((2, 3)), np.zeros((3, 3)), np.ones((2, 4)), np.ones((2, 2), dtype=np.bool_))


def test_extra_radii_are_zeros_until_given_and_have_to_make_sense() -> None:
    seen = np.zeros((2, 3), dtype=np.bool_)
    bare = LocalViews(np.zeros((2, 3, 3)), np.zeros((2, 3, 3)), seen, np.zeros((2, 3)))
    np.testing.assert_array_equal(bare.extra_m, np.zeros((2, 3)))
    given = dataclasses.replace(bare, extra_m=np.array([[0.1, 0, 0], [0, 0.2, 0]]))
    assert given.agent(1).extra_m.tolist() == [[0, 0.2, 0]]
    for wrong in (np.zeros((3, 2)), np.full((2, 3), -0.1), np.full((2, 3), np.nan), np.full((2, 3), np.inf)):
        with pytest.raises(ValueError, match="extra radii"):
            dataclasses.replace(bare, extra_m=wrong)
