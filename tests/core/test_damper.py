"""The approach damper: bounds by hand, projection against its optimality conditions, distances kept in motion."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from groundstation.core import frames
from groundstation.core.damper import DamperParams, approach_bounds, damp, fitting_margin_m, project, walls
from groundstation.core.types import FloatArray
from groundstation.core.views import LocalViews
from tests.core.lag_team import (
    CRAZYFLIE,
    KINEMATIC,
    PX4_QUAD,
    Chain,
    Profile,
    cube,
    cube_gains,
    damper_for,
    fly,
    random_start,
    with_damper,
)
from tests.core.strategies import Team, teams

PARAMS = DamperParams(
    radius_m=0.45, margin_m=0.05, lag_s=1.0, delay_s=0.1, tick_s=0.02, speed_limit_m_s=0.5, accel_limit_m_s2=3.0
)


def view_of(rel: list[list[float]], rel_vel: list[list[float]]) -> LocalViews:
    pos = np.array([rel], dtype=np.float64)
    seen = np.asarray(np.isfinite(pos).all(axis=-1), dtype=np.bool_)
    return LocalViews(pos, np.array([rel_vel], dtype=np.float64), seen, np.zeros((1, 3)))


def test_horizon_and_rate_follow_the_vehicle() -> None:
    assert PARAMS.horizon_s == pytest.approx(1.0)
    assert PARAMS.rate_1_s == pytest.approx(1.0 / (3 * 0.12 + 1.0))
    weak = dataclasses.replace(PARAMS, lag_s=0.1, accel_limit_m_s2=1.0)
    assert weak.horizon_s == pytest.approx(0.5)  # to lose 0.5 m/s


@pytest.mark.parametrize("profile", [CRAZYFLIE, PX4_QUAD, KINEMATIC])
def test_the_argument_holds_for_the_profiles(profile: Profile) -> None:
    assert damper_for(profile, Chain(cube(), cube_gains(), 1.0), 0.03).delay_product <= np.exp(-1.0)


@given(
    lag_s=st.one_of(st.just(0.0), st.floats(1e-6, 10.0)),
    delay_s=st.floats(0.0, 5.0),
    tick_s=st.floats(1e-3, 1.0),
    speed_m_s=st.floats(1e-3, 20.0),
    accel_m_s2=st.one_of(st.just(np.inf), st.floats(1e-2, 100.0)),
)
def test_the_argument_holds_for_every_setting(
    *, lag_s: float, delay_s: float, tick_s: float, speed_m_s: float, accel_m_s2: float
) -> None:
    """No delay is too long: the distance left is used up more slowly instead, and no more slowly than is needed."""
    params = DamperParams(0.45, 0.05, lag_s, delay_s, tick_s, speed_m_s, accel_m_s2)
    swift_1_s = 1.0 / (3.0 * (delay_s + tick_s) + lag_s)
    assert 0.0 < params.rate_1_s <= swift_1_s
    assert params.delay_product <= np.exp(-1.0) * (1.0 + 1e-12)
    stretch = params.horizon_s / lag_s if lag_s > 0.0 else 1.0
    if swift_1_s * stretch * (delay_s + tick_s) < np.exp(-1.0) * (1.0 - 1e-9):
        assert params.rate_1_s == swift_1_s  # to the last bit
    elif params.rate_1_s < swift_1_s:
        assert params.delay_product == pytest.approx(np.exp(-1.0))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_pair_that_uses_all_it_may_keeps_what_is_left_not_negative(seed: int) -> None:
    """Head on, at exactly the bound, whatever lag and delay: h, and with it the distance, never gets below zero."""
    rng = np.random.default_rng(seed)
    tick_s = 0.02
    params = DamperParams(
        0.45, 0.0, rng.uniform(0.1, 1.2), tick_s * int(rng.integers(0, 31)), tick_s, rng.uniform(0.2, 1.5), 4.0
    )
    keep, steps = np.exp(-tick_s / params.lag_s), round(params.delay_s / tick_s)
    left_m, rate_m_s, least = rng.uniform(0.5, 2.0), 0.0, np.inf
    waiting = [0.0] * steps
    for _ in range(1500):
        h = left_m + params.horizon_s * min(rate_m_s, 0.0)
        least = min(least, h)
        waiting.append(-params.rate_1_s * h)
        told = waiting.pop(0)
        left_m += told * tick_s + (rate_m_s - told) * params.lag_s * (1.0 - keep)  # exact, between two setpoints
        rate_m_s = told + (rate_m_s - told) * keep
    assert least >= 0.0
    assert left_m >= 0.0


def test_what_is_already_moving_enters_the_bound() -> None:
    at_rest = view_of([[0.8, 0, 0]], [[0.0, 0, 0]])
    closing = view_of([[0.8, 0, 0]], [[-0.2, 0.3, 0]])
    parting = view_of([[0.8, 0, 0]], [[0.2, 0, 0]])
    half = 0.5 * PARAMS.rate_1_s
    assert approach_bounds(at_rest, PARAMS)[1][0, 0] == pytest.approx(half * 0.3)
    assert approach_bounds(closing, PARAMS)[1][0, 0] == pytest.approx(half * (0.3 - 1.0 * 0.2))
    assert approach_bounds(parting, PARAMS)[1][0, 0] == pytest.approx(half * 0.3)  # no bonus


def test_unknown_velocity_counts_as_closing() -> None:
    views = view_of([[1.8, 0, 0]], [[np.nan] * 3])
    assert approach_bounds(views, PARAMS)[1][0, 0] == pytest.approx(0.5 * PARAMS.rate_1_s * (1.3 - 1.0 * 0.5))


def test_both_halves_are_done_around_an_obstacle() -> None:
    """The whole of what the pair may close, from the larger radius; what the obstacle itself closes is taken off."""
    extra = {"extra_m": np.array([[0.2]])}
    at_rest = dataclasses.replace(view_of([[0.9, 0, 0]], [[0.0, 0, 0]]), **extra)
    assert approach_bounds(at_rest, PARAMS)[1][0, 0] == pytest.approx(PARAMS.rate_1_s * (0.9 - 0.5 - 0.2))
    # Both approach: 0.1 m/s of the closing speed is its own, 0.2 m/s the obstacle's.
    closing = dataclasses.replace(
        view_of([[1.3, 0, 0]], [[-0.3, 0, 0]]), vel_flu_m_s=np.array([[0.1, 0.0, 0.0]]), **extra
    )
    left = 1.3 - 0.7 - 1.0 * 0.3
    assert approach_bounds(closing, PARAMS)[1][0, 0] == pytest.approx(PARAMS.rate_1_s * left - 0.2)
    # It goes away: nobody runs after it.
    parting = dataclasses.replace(view_of([[0.9, 0, 0]], [[0.4, 0, 0]]), **extra)
    assert approach_bounds(parting, PARAMS)[1][0, 0] == pytest.approx(PARAMS.rate_1_s * 0.2)
    unknown = dataclasses.replace(view_of([[1.9, 0, 0]], [[np.nan] * 3]), **extra)
    assert approach_bounds(unknown, PARAMS)[1][0, 0] == pytest.approx(PARAMS.rate_1_s * (1.2 - 1.0 * 0.5))


@pytest.mark.parametrize("profile", [CRAZYFLIE, PX4_QUAD])
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_an_obstacle_that_does_nothing_is_kept_away_from(profile: Profile, seed: int) -> None:
    """It flies straight at, past or away from an agent that wants to be where it is."""
    rng = np.random.default_rng(seed)
    params = dataclasses.replace(damper_for(profile, Chain(cube(), cube_gains(), 1.0), 0.02), radius_m=0.45)
    extra_m, dt = 0.25, 0.004
    keep_m = params.radius_m + extra_m
    rel = rng.normal(size=3)
    rel *= rng.uniform(keep_m + 0.7, 2.5) / np.linalg.norm(rel)
    obstacle_vel = rng.normal(size=3)
    obstacle_vel *= rng.uniform(0.0, 0.3) / np.linalg.norm(obstacle_vel)
    if rng.random() < 0.5:
        obstacle_vel = -rel / np.linalg.norm(rel) * np.linalg.norm(obstacle_vel)
    vel, nearest = np.zeros(3), np.inf
    late = [np.zeros(3)] * (round(profile.delay_s / dt) + 1)
    for step in range(2500):
        if step % 5 == 0:
            views = LocalViews(
                rel[None, None],
                (obstacle_vel - vel)[None, None],
                np.ones((1, 1), np.bool_),
                vel[None],
                np.array([[extra_m]]),
            )
            command = damp(views, 0.5 * rel[None] / np.linalg.norm(rel), params).vel_flu_m_s[0]
        late.append(command)
        vel = vel + (late.pop(0) - vel) * dt / profile.tau_s
        rel = rel + (obstacle_vel - vel) * dt
        nearest = min(nearest, float(np.linalg.norm(rel)))
    assert nearest >= keep_m


def test_nobody_in_sight_and_coincident_agents_bound_nothing() -> None:
    views = view_of([[np.nan] * 3, [0.0, 0, 0]], [[np.nan] * 3, [0.0, 0, 0]])
    wanted = np.array([[0.4, 0.1, 0.0]])
    result = damp(views, wanted, PARAMS)
    np.testing.assert_array_equal(result.vel_flu_m_s, wanted)
    assert not result.changed[0]


def test_only_the_part_along_the_line_is_taken() -> None:
    result = damp(view_of([[0.5, 0, 0]], [[0.0, 0, 0]]), np.array([[0.3, 0.2, -0.1]]), PARAMS)
    np.testing.assert_allclose(result.vel_flu_m_s, [[0.0, 0.2, -0.1]], atol=1e-12)
    assert result.in_the_way.tolist() == [[True]]


def test_too_near_means_part() -> None:
    result = damp(view_of([[0.3, 0, 0]], [[0.0, 0, 0]]), np.zeros((1, 3)), PARAMS)
    np.testing.assert_allclose(result.vel_flu_m_s, [[-0.5 * PARAMS.rate_1_s * 0.2, 0, 0]], atol=1e-12)


def test_squeezed_from_both_sides_gives_way_evenly() -> None:
    """Left and right demand the opposite: as far from both as possible is to stand, along the line."""
    result = damp(view_of([[0.3, 0, 0], [-0.3, 0, 0]], [[0.0] * 3] * 2), np.array([[0.1, 0.2, 0.0]]), PARAMS)
    assert result.infeasible[0]
    np.testing.assert_allclose(result.vel_flu_m_s, [[0.0, 0.2, 0.0]], atol=1e-3)


def test_walls_are_met_together_with_agents() -> None:
    """An agent ahead, a wall ahead and left: cut one after the other, the second cut would break the first."""
    views = view_of([[0.5, 0, 0]], [[0.0, 0, 0]])
    slant = np.sqrt(0.5)
    normals = np.array([[[slant, slant, 0.0]]])
    result = damp(views, np.array([[0.5, 0.0, 0.1]]), PARAMS, normals, np.array([[-0.1]]))
    # On both planes: x = 0 and (x + y) / sqrt(2) = -0.1.
    np.testing.assert_allclose(result.vel_flu_m_s, [[0.0, -0.1 / slant, 0.1]], atol=1e-9)
    assert result.in_the_way.shape == (1, 1)


def test_walls_of_the_fence_in_the_own_frame() -> None:
    # Facing east and leaning; 0.1 m/s allowed towards north, 0.2 towards east, 0.3 downwards, 9 elsewhere.
    quat = frames.quat_ned_from_frd_of_euler(np.array([0.3]), np.array([-0.2]), np.array([np.pi / 2]))
    rot = frames.rot_ned_from_flu(quat)
    normals, bounds = walls(rot, np.full((1, 3), 9.0), np.array([[0.1, 0.2, 0.3]]))
    wanted = frames.rotate_back(rot, np.array([[0.4, 0.5, 0.6]]))
    far = view_of([[9.0, 0, 0]], [[0.0, 0, 0]])
    result = damp(far, wanted, dataclasses.replace(PARAMS, speed_limit_m_s=2.0), normals, bounds)
    np.testing.assert_allclose(frames.rotate(rot, result.vel_flu_m_s), [[0.1, 0.2, 0.3]], atol=1e-9)


def test_held_back_is_told() -> None:
    ahead = view_of([[0.5, 0, 0]], [[0.0, 0, 0]])
    assert damp(ahead, np.array([[0.3, 0.0, 0.0]]), PARAMS).held[0]
    assert not damp(ahead, np.array([[0.3, 0.2, 0.0]]), PARAMS).held[0]
    assert not damp(ahead, np.zeros((1, 3)), PARAMS).held[0]


def test_the_margin_leaves_room_for_the_formation() -> None:
    assert fitting_margin_m(0.05, 0.55) == 0.05
    assert fitting_margin_m(0.05, 0.056) == 0.05
    assert fitting_margin_m(0.05, 0.05) == pytest.approx(0.045)
    with pytest.raises(ValueError, match="room"):
        fitting_margin_m(0.05, -0.15)


@pytest.mark.parametrize("name", ["radius_m", "tick_s", "speed_limit_m_s", "accel_limit_m_s2", "margin_m", "delay_s"])
def test_impossible_parameters_are_refused(name: str) -> None:
    for value in (-0.1, np.nan):
        with pytest.raises(ValueError, match=name):
            dataclasses.replace(PARAMS, **{name: value})  # type: ignore[arg-type]


def test_what_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        damp(view_of([[1.0, 0, 0]], [[0.0] * 3]), np.array([[np.inf, 0, 0]]), PARAMS)


def random_polyhedron(seed: int, count: int, lowest: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return rng.normal(0.0, 0.3, 3), normals, rng.uniform(lowest, 0.2, count)


@given(st.integers(0, 2**32 - 1), st.integers(1, 15))
def test_projection_is_the_nearest_point(seed: int, count: int) -> None:
    """Against the definition: every point inside lies behind the plane square to the step there."""
    wanted, normals, bounds = random_polyhedron(seed, count, 0.0)
    got, infeasible = project(wanted, normals, bounds)
    assert not infeasible
    assert (normals @ got <= bounds + 1e-9).all()
    assert np.linalg.norm(got) <= np.linalg.norm(wanted) + 1e-9
    rng = np.random.default_rng(seed + 1)
    others = rng.normal(0.0, 0.5, (2000, 3)) * rng.random((2000, 1))
    others = others[(others @ normals.T <= bounds).all(axis=1)]
    assert ((others - got) @ (wanted - got) <= 1e-9).all()


@given(st.integers(0, 2**32 - 1), st.integers(3, 10))
def test_contradicting_bounds_are_violated_least(seed: int, count: int) -> None:
    wanted, normals, bounds = random_polyhedron(seed, count, -0.3)
    got, infeasible = project(wanted, normals, bounds)
    violation = float((normals @ got - bounds).max())
    if not infeasible:
        assert violation <= 1e-8
        return
    # Smallest common violation by linear programming.
    a = np.concatenate([normals, -np.ones((count, 1))], axis=1)
    least = linprog([0, 0, 0, 1], A_ub=a, b_ub=bounds, bounds=[(None, None)] * 4)
    assert least.x is not None
    smallest = float(least.x[3])
    assert smallest >= -1e-9
    assert violation <= smallest + 0.02


@given(teams, st.integers(0, 2**32 - 1))
def test_team_at_once_is_agent_by_agent_to_the_bit(team: Team, seed: int) -> None:
    wanted = np.random.default_rng(seed).normal(0.0, 0.3, (team.size, 3))
    together = damp(team.views, wanted, PARAMS)
    for i in range(team.size):
        alone = damp(team.views.agent(i), wanted[i : i + 1], PARAMS)
        for f in dataclasses.fields(alone):
            np.testing.assert_array_equal(getattr(alone, f.name)[0], getattr(together, f.name)[i])


@given(teams, st.integers(0, 2**32 - 1))
def test_every_bound_holds_where_the_bounds_agree(team: Team, seed: int) -> None:
    wanted = np.random.default_rng(seed).normal(0.0, 0.3, (team.size, 3))
    views = team.views
    result = damp(views, wanted, PARAMS)
    normals, bounds = approach_bounds(views, PARAMS)
    broken = (normals * result.vel_flu_m_s[:, None]).sum(axis=-1) - bounds
    fast = np.linalg.norm(result.vel_flu_m_s, axis=1) > PARAMS.speed_limit_m_s - 1e-9
    assert broken[~result.infeasible & ~fast].max(initial=-1.0) <= 1e-8
    np.testing.assert_array_equal(result.vel_flu_m_s[~result.changed], wanted[~result.changed])


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.02, 0.05]), st.booleans())
def test_kinematic_agents_stay_apart_at_any_step(seed: int, tick_s: float, rotate: bool) -> None:
    """Proposition 1 for sampled control: a pair uses at most a quarter of the distance left in a step."""
    rng = np.random.default_rng(seed)
    start = random_start(rng, 8, 2.2, 0.5, planar=seed % 2 == 0)
    chain = with_damper(KINEMATIC, Chain(cube(), cube_gains(), 1.0, tick_s=tick_s, rotate=rotate), 0.0)
    flight = fly(chain, KINEMATIC, start, rng, seconds=3.0, roles=rng.permutation(8))
    assert flight.min_distance_m >= 0.45 - 1e-9
