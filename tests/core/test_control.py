"""The control law: Example 1, the symmetries that the paper claims, and agents that act on their own view alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.core import control, frames
from groundstation.core.control import ScaleFunction, Task
from groundstation.core.formation import Formation, Gains
from groundstation.core.types import BoolArray, FloatArray
from groundstation.core.views import LocalViews, local_views
from tests.core.lag_team import cube, cube_gains
from tests.core.strategies import Team, level_teams, teams

FREE = ScaleFunction("free")
ARCTAN = ScaleFunction("arctan", 2.5)


def example_1(visible: BoolArray | None = None) -> tuple[LocalViews, Task]:
    """Agent 1 of Example 1 and its two neighbours, equation (4)."""
    rel = np.array([[[np.nan] * 3, [2.0, 3.0, 1.0], [2.0, 1.0, 2.0]]])
    visible = np.array([[False, True, True]]) if visible is None else visible
    rel[~visible] = np.nan
    views = LocalViews(rel, 0.0 * rel, visible, np.zeros((1, 3)))
    task = Task(
        gains_xy=np.array([[0, 2 + 1j, -1 - 3j]]),
        gains_z=np.array([[0.0, -1.0, 2.0]]),
        neighbours=np.array([[False, True, True]]),
        distances_m=np.array([[0.0, 1.0, 1.0]]),
        rise_m=np.array([[0.0, 0.5, -0.5]]),
    )
    return views, task


def test_example_1_to_the_digit() -> None:
    views, task = example_1()
    assert control.formation_control(views, task, FREE).tolist() == [[2.0, 1.0, 3.0]]


def test_the_scale_function_pulls_when_too_far() -> None:
    views, task = example_1()
    rest = control.formation_control(views, task, ARCTAN) - control.formation_control(views, task, FREE)
    q2, q3 = np.array([2.0, 3, 1]), np.array([2.0, 1, 2])
    wanted = 2.5 * np.arctan(np.sqrt(14.0) - 1.0) * q2 + 2.5 * np.arctan(3.0 - 1.0) * q3
    np.testing.assert_allclose(rest[0], wanted, rtol=1e-12)


@given(st.floats(-50, 50), st.floats(0.1, 10), st.sampled_from(["arctan", "tanh"]))
def test_scale_functions_have_the_form_of_section_vii(error: float, gain: float, kind: control.ScaleKind) -> None:
    value = float(ScaleFunction(kind, gain)(np.array([error]))[0])
    assert value == 0.0 if error == 0.0 else value * error >= 0.0
    assert abs(value) <= gain * np.pi / 2
    assert float(ScaleFunction(kind, gain)(np.array([1e-3]))[0]) == pytest.approx(gain * 1e-3, rel=1e-3)


@pytest.mark.parametrize(("kind", "gain"), [("arctan", 0.0), ("tanh", -1.0), ("arctan", np.nan), ("cubic", 1.0)])
def test_other_scale_functions_are_refused(kind: control.ScaleKind, gain: float) -> None:
    with pytest.raises(ValueError, match="scale function"):
        ScaleFunction(kind, gain)


def test_a_neighbour_that_is_not_visible_is_left_out() -> None:
    views, task = example_1(np.array([[False, True, False]]))
    assert control.formation_control(views, task, FREE).tolist() == [[1.0, 8.0, -1.0]]  # A12 [2, 3, 1]
    assert control.missing_neighbours(views, task).tolist() == [[False, False, True]]


def test_the_upright_term_by_hand() -> None:
    """Neighbours 0.5 m too high and 2.5 m too high: climb, and only climb."""
    views, task = example_1()
    rest = control.formation_control(views, task, FREE, upright_1_s=2.0) - control.formation_control(views, task, FREE)
    np.testing.assert_allclose(rest, [[0.0, 0.0, 2.0 * (0.5 + 2.5)]])
    views, task = example_1(np.array([[False, True, False]]))  # whom one does not see does not count
    rest = control.formation_control(views, task, FREE, upright_1_s=2.0) - control.formation_control(views, task, FREE)
    np.testing.assert_allclose(rest, [[0.0, 0.0, 1.0]])


def test_an_agent_that_sees_nobody_stands() -> None:
    views, task = example_1(np.zeros((1, 3), dtype=np.bool_))
    assert control.formation_control(views, task, ARCTAN).tolist() == [[0.0, 0.0, 0.0]]


@given(
    teams,
    st.sampled_from([FREE, ARCTAN, ScaleFunction("tanh", 0.7)]),
    st.sampled_from([0.0, 0.8]),
    st.sampled_from([0.0, 0.5]),
)
def test_team_at_once_is_agent_by_agent_to_the_bit(
    team: Team, scale: ScaleFunction, lead_s: float, upright: float
) -> None:
    together = control.formation_control(team.views, team.task, scale, 0.3, lead_s=lead_s, upright_1_s=upright)
    for i in range(team.size):
        alone = control.formation_control(
            team.views.agent(i), team.task.agent(i), scale, 0.3, lead_s=lead_s, upright_1_s=upright
        )
        np.testing.assert_array_equal(alone[0], together[i])


@given(teams, st.integers(0, 2**32 - 1))
def test_positions_of_those_not_seen_have_no_influence(team: Team, seed: int) -> None:
    """Agent 0 is deaf to everybody: whatever the others do, its velocity stays zero."""
    sensed = team.sensed.copy()
    sensed[0] = False
    moved = np.random.default_rng(seed).uniform(-9, 9, team.pos_ned_m.shape)
    views = local_views(moved, team.vel_ned_m_s, team.quat, sensed)
    assert not control.formation_control(views, team.task, ARCTAN)[0].any()


def setpoints_ned(team: Team) -> np.ndarray:
    vel = control.formation_control(team.views, team.task, ARCTAN, 1.0)
    return frames.rotate(frames.rot_ned_from_flu(team.quat), vel)


@given(level_teams, st.lists(st.floats(-np.pi, np.pi), min_size=12, max_size=12))
def test_headings_of_level_agents_do_not_matter(team: Team, yaws: list[float]) -> None:
    zero = np.zeros(team.size)
    turned = frames.quat_ned_from_frd_of_euler(zero, zero, np.array(yaws[: team.size]))
    other = dataclasses.replace(team, quat=turned)
    np.testing.assert_allclose(setpoints_ned(other), setpoints_ned(team), atol=1e-9)


@given(level_teams, st.floats(-np.pi, np.pi), st.tuples(*[st.floats(-100, 100)] * 3))
def test_turning_about_z_and_moving_the_team_turns_the_velocities(
    team: Team, yaw: float, shift: tuple[float, float, float]
) -> None:
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    moved = dataclasses.replace(team, pos_ned_m=team.pos_ned_m @ turn.T + np.array(shift))
    np.testing.assert_allclose(setpoints_ned(moved), setpoints_ned(team) @ turn.T, atol=1e-8)


@given(teams, st.randoms(use_true_random=False))
def test_renumbering_agents_renumbers_velocities(team: Team, random: object) -> None:
    order = np.arange(team.size)
    random.shuffle(order)  # type: ignore[attr-defined]
    pick = np.ix_(order, order)
    task = Task(*(getattr(team.task, f.name)[pick] for f in dataclasses.fields(Task)))
    renumbered = Team(team.pos_ned_m[order], team.vel_ned_m_s[order], team.quat[order], team.sensed[pick], task)
    np.testing.assert_allclose(setpoints_ned(renumbered), setpoints_ned(team)[order], atol=1e-9)


def test_the_closed_loop_is_the_matrix_of_equation_7() -> None:
    gains, rng = cube_gains(), np.random.default_rng(3)
    enu = rng.normal(size=(8, 3))
    yaw_enu = rng.uniform(-np.pi, np.pi, 8)
    quat = frames.quat_ned_from_frd_of_euler(np.zeros(8), np.zeros(8), frames.yaw_ned_from_enu(yaw_enu))
    views = local_views(frames.ned_from_enu(enu), np.zeros((8, 3)), quat, np.ones((8, 8), dtype=np.bool_))
    task = control.task_for_roles(cube(), gains, np.arange(8))
    vel_flu = control.formation_control(views, task, FREE)
    vel_enu = frames.enu_from_ned(frames.rotate(frames.rot_ned_from_flu(quat), vel_flu))
    p = gains.xy @ (enu[:, 0] + 1j * enu[:, 1])
    np.testing.assert_allclose(vel_enu, np.stack([p.real, p.imag, gains.z @ enu[:, 2]], axis=1), atol=1e-12)


def test_the_formation_is_at_rest_in_any_roles() -> None:
    rng = np.random.default_rng(5)
    for _ in range(5):
        roles = rng.permutation(8)
        task = control.task_for_roles(cube(), cube_gains(), roles)
        pos = frames.ned_from_enu(cube().points_enu_m[roles])
        views = local_views(pos, np.zeros((8, 3)), np.tile([1.0, 0, 0, 0], (8, 1)), np.ones((8, 8), dtype=np.bool_))
        np.testing.assert_allclose(control.formation_control(views, task, ARCTAN, upright_1_s=1.0), 0.0, atol=1e-12)


def test_the_test_gains_are_those_of_a_cube() -> None:
    gains, formation = cube_gains(), cube()
    assert control.largest_rate_1_s(gains) == pytest.approx(10.0)
    for block in (gains.xy, gains.z):
        np.testing.assert_allclose(block, np.conj(block.T))
        eigenvalues = np.linalg.eigvalsh(block)
        assert np.sum(np.abs(eigenvalues) < 1e-9) == 2
        assert eigenvalues[eigenvalues < -1e-9].max() == pytest.approx(-5.0)
        assert not block[~formation.adjacency & ~np.eye(8, dtype=np.bool_)].any()


def test_roles_that_are_no_permutation_are_refused() -> None:
    for roles in ([0, 1, 2, 3, 4, 5, 6, 6], [0, 1, 2], [1, 2, 3, 4, 5, 6, 7, 8]):
        with pytest.raises(ValueError, match="no permutation"):
            control.gains_for_roles(cube_gains(), np.array(roles))
    with pytest.raises(ValueError, match="gains are for 2 agents"):
        control.task_for_roles(cube(), Gains(np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2))), np.arange(8))


def test_misfitting_arguments_are_refused() -> None:
    views, task = example_1()
    with pytest.raises(ValueError, match="task is for"):
        control.formation_control(views, Task(*(np.zeros((2, 3)),) * 5), FREE)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="control gain"):
        control.formation_control(views, task, FREE, 0.0)
    with pytest.raises(ValueError, match="expected one"):
        dataclasses.replace(task, gains_z=np.zeros((1, 2)))
    with pytest.raises(ValueError, match="speed limit"):
        control.saturate(np.zeros((1, 3)), 0.0)


@given(st.lists(st.floats(-100, 100), min_size=3, max_size=3), st.floats(0.01, 10))
def test_saturation_keeps_direction_and_short_vectors(vector: list[float], limit: float) -> None:
    vel = np.array([vector])
    out = control.saturate(vel, limit)
    assert np.linalg.norm(out) <= limit * (1 + 1e-12)
    np.testing.assert_allclose(np.cross(out, vel), 0.0, atol=1e-9)
    assert float((out * vel).sum()) >= 0.0
    if np.linalg.norm(vel) <= limit * (1 - 1e-12):
        np.testing.assert_allclose(out, vel, rtol=1e-15)


@pytest.mark.parametrize(
    ("tau", "delay", "lead", "gain"),
    [
        (1.0, 0.1, 0.0, 0.6 / 11.0),
        (0.2, 0.05, 0.0, 0.24),
        (0.0, 0.0, 0.0, 1.0),
        (0.01, 0.01, 0.0, 1.0),
        (1.0, 0.1, 1.0, 1.2 / 7.0),
    ],
)
def test_auto_gain_follows_the_lag(tau: float, delay: float, lead: float, gain: float) -> None:
    assert control.auto_control_gain(10.0, tau, delay, lead) == pytest.approx(gain)


def test_a_view_that_tilts_asks_for_what_the_limit_of_the_gain_reckons_with() -> None:
    """In the formation, where nothing is wanted: an agent leans as it does when it accelerates by v', and is misled."""
    acc_m_s2, tau_s, everybody = 0.2, 0.3, np.ones((8, 8), dtype=np.bool_)
    tilted = frames.quat_ned_from_frd_of_euler(np.zeros(8), np.full(8, -acc_m_s2 / 9.81), np.zeros(8))
    views = local_views(frames.ned_from_enu(cube().points_enu_m), np.zeros((8, 3)), tilted, everybody)
    task = control.task_for_roles(cube(), cube_gains(), np.arange(8))
    misled_m_s = np.linalg.norm(control.formation_control(views, task, FREE)[:, :2], axis=1)
    most = control.most_for_tilted_views(cube(), cube_gains(), tau_s)
    # k times that, over a lag tau: six tenths of what made it lean.
    assert most * misled_m_s.max() / tau_s == pytest.approx(0.6 * acc_m_s2, rel=1e-2)
    assert control.most_for_tilted_views(cube(), cube_gains(), 0.0) == np.inf


@pytest.mark.parametrize("upright", [0.0, 0.7])
@pytest.mark.parametrize("scale", [FREE, ARCTAN, ScaleFunction("tanh", 1.3)])
def test_the_stiffest_mode_is_that_of_the_linearised_law(scale: ScaleFunction, upright: float) -> None:
    """Differences of the law itself around the formation, in level frames that face east (FLU = ENU)."""
    step, task = 1e-6, control.task_for_roles(cube(), cube_gains(), np.arange(8))
    east = np.tile(frames.quat_ned_from_frd_of_euler(np.zeros(1), np.zeros(1), np.array([np.pi / 2])), (8, 1))

    def law(pos_enu: FloatArray) -> FloatArray:
        views = local_views(frames.ned_from_enu(pos_enu), np.zeros((8, 3)), east, np.ones((8, 8), dtype=np.bool_))
        return control.formation_control(views, task, scale, upright_1_s=upright).ravel()

    points = cube().points_enu_m
    columns = [
        (law(points + step * unit.reshape(8, 3)) - law(points - step * unit.reshape(8, 3))) / (2 * step)
        for unit in np.eye(24)
    ]
    rates = np.linalg.eigvals(np.array(columns).T)
    assert rates.real.max() < 1e-6  # Proposition 2
    assert control.stiffest_rate_1_s(cube(), cube_gains(), scale, upright) == pytest.approx(-rates.real.min(), rel=1e-6)


def test_the_rate_for_the_auto_gain() -> None:
    assert control.rate_for_auto_gain_1_s(cube(), cube_gains(), ARCTAN) == pytest.approx(10.0)
    steep = ScaleFunction("arctan", 25.0)
    stiffest = control.stiffest_rate_1_s(cube(), cube_gains(), steep)
    assert control.rate_for_auto_gain_1_s(cube(), cube_gains(), steep) == pytest.approx(stiffest / 2)
    assert stiffest > 50.0


@given(st.floats(0.1, 20.0))
def test_an_f_that_fits_pulls_as_hard_at_any_size(size: float) -> None:
    larger = Formation(cube().name, size * cube().points_enu_m, cube().edges)
    gain = control.fitting_scale_gain(larger, cube_gains(), "arctan")
    assert gain * size == pytest.approx(2.5)  # as flown, on edges of 1 m
    rates = [
        control.stiffest_rate_1_s(formation, cube_gains(), ScaleFunction("arctan", each))
        for formation, each in ((larger, gain), (cube(), 2.5))
    ]
    assert rates[0] == pytest.approx(rates[1])


@given(st.integers(0, 100), st.integers(4, 12), st.floats(0.3, 5.0), st.floats(0.0, 2.0))
def test_an_f_that_fits_doubles_the_fastest_mode_at_most_however_many_edges(
    seed: int, n: int, size: float, upright: float
) -> None:
    points = size * np.random.default_rng(seed).normal(size=(n, 3))
    formation = Formation("random", points, tuple((i, j) for i in range(n) for j in range(i + 1, n)))
    laplacian = np.ones((n, n)) - n * np.eye(n)
    gains = Gains(xy=laplacian.astype(np.complex128), z=laplacian)
    gain = control.fitting_scale_gain(formation, gains, "tanh", upright)
    without = control.stiffest_rate_1_s(formation, gains, FREE, upright)
    most = 2.0 * max(control.largest_rate_1_s(gains), without)
    with_f = control.stiffest_rate_1_s(formation, gains, ScaleFunction("tanh", gain), upright)
    assert with_f <= most * (1.0 + 1e-9)
    assert gain > 0.0


@pytest.mark.parametrize("arguments", [(0.0, 1.0, 0.1), (10.0, -1.0, 0.1), (10.0, 1.0, np.nan)])
def test_auto_gain_refuses_nonsense(arguments: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match=r"must|nothing pulls"):
        control.auto_control_gain(*arguments)
