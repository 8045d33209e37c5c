"""Moving formations: from rest to rest, as fast as told, and without changing a distance that was not to change."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.core import damper
from groundstation.core.motion import MovePlan, least_seconds
from groundstation.core.places import own_places
from groundstation.core.types import FloatArray
from groundstation.core.views import local_views
from tests.core.lag_team import cube

MOVES = st.builds(
    MovePlan,
    by_enu_m=st.tuples(*[st.floats(-5, 5)] * 3).map(np.array),
    turn_rad=st.floats(-6, 6),
    scale=st.floats(0.5, 2.0),
    seconds=st.floats(2.0, 30.0),
)


def _positions(move: MovePlan, points_m: FloatArray, time_s: float) -> FloatArray:
    share = move.share(time_s)
    angle = share * move.turn_rad
    cos, sin = np.cos(angle), np.sin(angle)
    turned = points_m @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    return np.asarray(share * move.by_enu_m + move.scale**share * turned, dtype=np.float64)


@given(MOVES, st.floats(0.05, 0.95))
def test_agents_that_follow_their_own_views_go_where_the_formation_goes(move: MovePlan, at: float) -> None:
    points = cube().points_enu_m - 0.5
    time_s, step_s = at * move.seconds, 1e-4
    pos = _positions(move, points, time_s)
    truth = (_positions(move, points, time_s + step_s) - _positions(move, points, time_s - step_s)) / (2 * step_s)
    motion = move.at(time_s)
    own = own_places(pos[None] - pos[:, None], cube().adjacency, motion.scale * points)
    told = motion.rigid(own.from_centre_m) + motion.growth_1_s * own.from_centre_m
    np.testing.assert_allclose(told, truth, atol=1e-5)
    relative = truth[None] - truth[:, None]
    np.testing.assert_allclose(motion.relative(pos[None] - pos[:, None]), relative, atol=1e-5)


@given(MOVES)
def test_it_begins_and_ends_at_rest_and_arrives(move: MovePlan) -> None:
    assert move.share(0.0) == 0.0
    assert move.share(move.seconds) == 1.0
    for end in (0.0, move.seconds):
        motion = move.at(end)
        np.testing.assert_allclose(motion.vel_enu_m_s, 0.0, atol=1e-12)
        assert motion.turn_rad_s == pytest.approx(0.0, abs=1e-12)
        assert motion.growth_1_s == pytest.approx(0.0, abs=1e-12)
    assert move.at(move.seconds).scale == pytest.approx(move.scale)
    still = move.at(0.5 * move.seconds, pace=0.0, ahead_s=1.0)
    np.testing.assert_array_equal(still.vel_enu_m_s, 0.0)


@given(MOVES, st.floats(0.1, 2.0), st.floats(0.2, 5.0))
def test_the_least_time_keeps_speed_and_acceleration(move: MovePlan, speed: float, acceleration: float) -> None:
    points = cube().points_enu_m - 0.5
    level, radius = np.sqrt(0.5), np.sqrt(0.75)
    least = least_seconds(move, level, radius, speed, acceleration)
    if least < 0.1:
        return
    move = MovePlan(move.by_enu_m, move.turn_rad, move.scale, least)
    times = np.linspace(0.0, least, 200)
    step_s = 1e-3 * least
    pos = np.array([[_positions(move, points, t + k * step_s) for k in (-1, 0, 1)] for t in times])
    velocity = (pos[:, 2] - pos[:, 0]) / (2 * step_s)
    second = (pos[:, 2] - 2 * pos[:, 1] + pos[:, 0]) / step_s**2
    assert np.linalg.norm(velocity, axis=-1).max() <= speed * 1.001
    assert np.linalg.norm(second, axis=-1).max() <= acceleration * 1.02


LEVEL = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
PARAMS = damper.DamperParams(0.5, 0.0, 0.2, 0.05, 0.02, 0.5, 4.0)


def _pair(rear_m_s: float, front_m_s: float, told_m_s: float) -> FloatArray:
    """Two agents in line, 0.6 m apart with r = 0.5 m, both told to go forward (north): what the damper leaves."""
    pos = np.array([[0.0, 0, -1], [0.6, 0, -1]])
    vel = np.array([[rear_m_s, 0, 0], [front_m_s, 0, 0]])
    views = local_views(pos, vel, LEVEL, np.ones((2, 2), dtype=np.bool_))
    told = np.tile([told_m_s, 0.0, 0.0], (2, 1))
    return damper.damp(views, told, PARAMS, common_flu_m_s=told).vel_flu_m_s[:, 0]


def test_who_follows_keeps_up_with_who_moves_and_does_not_run_into_who_does_not() -> None:
    alone = damper.damp(
        local_views(
            np.array([[0.0, 0, -1], [0.6, 0, -1]]), np.full((2, 3), [0.4, 0, 0]), LEVEL, np.ones((2, 2), dtype=np.bool_)
        ),
        np.tile([0.4, 0.0, 0.0], (2, 1)),
        PARAMS,
    ).vel_flu_m_s[:, 0]
    assert alone[0] < 0.2  # without a common motion the one behind is held back, and the formation torn apart
    assert _pair(0.4, 0.4, 0.4) == pytest.approx([0.4, 0.4])
    assert _pair(0.4, 0.0, 0.4)[0] < 0.25
    assert _pair(0.0, 0.0, 0.4)[0] < 0.2
    # Motion that was not told does not count: nobody is carried along by another one's mistake.
    assert _pair(0.4, 0.4, 0.0)[0] == pytest.approx(0.0, abs=1e-9)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.integers(0, 2**32 - 1))
def test_what_one_bound_gains_the_other_loses(rear: float, front: float, told: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pos = np.array([[0.0, 0, -1], rng.normal(0.0, 1.0, 3)])
    vel = np.array([[rear, 0.1, 0], [front, 0, 0.1]])
    views = local_views(pos, vel, LEVEL, np.ones((2, 2), dtype=np.bool_))
    normals, _ = damper.approach_bounds(views, PARAMS)
    shared = damper._shared_m_s(views, normals, np.tile([told, 0.0, 0.0], (2, 1)))
    assert shared[0, 1] == pytest.approx(-shared[1, 0], abs=1e-9)
