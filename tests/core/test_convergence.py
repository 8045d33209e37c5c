"""What docs/avoidance.md says of convergence: (14) descends on W, and the damper alone never turns a wish around."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.avoidance import avoid
from groundstation.core.control import ScaleFunction, Task, formation_control, saturate, task_for_roles
from groundstation.core.damper import DamperParams, damp
from groundstation.core.formation import Formation
from groundstation.core.regions import SafetySphere
from groundstation.core.types import FloatArray
from groundstation.core.views import LocalViews, alone
from groundstation.mission.plan.reading import load_mission

PLAN = load_mission(packaged_configs() / "missions" / "paper_cube8.yaml")
SCALE = ScaleFunction("arctan", 2.5)
UPRIGHT_1_S = 1.0
SEED = 1518  # of the first crowd in which it comes about
PARAMS = DamperParams(radius_m=0.45, margin_m=0.0, lag_s=0.2, delay_s=0.05, tick_s=0.02, speed_limit_m_s=0.5)


def _views(pos_m: FloatArray, vel_m_s: FloatArray) -> LocalViews:
    """Level agents that face the same way and see everybody."""
    visible = np.asarray(~np.eye(len(pos_m), dtype=np.bool_), dtype=np.bool_)
    rel, rel_vel = (np.where(visible[..., None], item[None] - item[:, None], np.nan) for item in (pos_m, vel_m_s))
    return LocalViews(rel, rel_vel, visible, vel_m_s)


def _at_rest(pos_m: FloatArray) -> LocalViews:
    return _views(pos_m, np.zeros_like(pos_m))


def _height(formation: Formation, task: Task, pos_m: FloatArray) -> float:
    """W: its slope downwards is (14), by the page's own words and none of the program's sums."""
    p, z = pos_m[:, 0] + 1j * pos_m[:, 1], pos_m[:, 2]
    total = 0.0
    for i, j in formation.edges:
        a, c = task.gains_xy[i, j], task.gains_z[i, j]
        assert a == pytest.approx(np.conj(task.gains_xy[j, i]), abs=1e-9)
        total += 0.5 * (a.real * abs(p[j] - p[i]) ** 2 + c * (z[j] - z[i]) ** 2)
        # The imaginary part acts on the two ends with opposite signs: x_i y_j - x_j y_i.
        total += a.imag * (np.conj(p[i]) * p[j]).imag
        wanted = float(np.linalg.norm(formation.points_enu_m[j] - formation.points_enu_m[i]))
        s = np.linspace(wanted, float(np.linalg.norm(pos_m[j] - pos_m[i])), 4001)
        total += float(np.trapezoid(2.5 * np.arctan(s - wanted) * s, s))
        total += (
            0.5 * UPRIGHT_1_S * float(z[j] - z[i] - formation.points_enu_m[j, 2] + formation.points_enu_m[i, 2]) ** 2
        )
    return total


def test_the_law_is_the_steepest_descent_on_w() -> None:
    task = task_for_roles(PLAN.formation, PLAN.gains, np.arange(8))
    pos_m = np.random.default_rng(4).uniform(-1.0, 1.0, (8, 3))
    wish = formation_control(_at_rest(pos_m), task, SCALE, upright_1_s=UPRIGHT_1_S)
    step = 1e-5
    for agent in range(8):
        for axis in range(3):
            ends = []
            for sign in (1.0, -1.0):
                moved = pos_m.copy()
                moved[agent, axis] += sign * step
                ends.append(_height(PLAN.formation, task, moved))
            assert wish[agent, axis] == pytest.approx(-(ends[0] - ends[1]) / (2.0 * step), abs=1e-4)


def _apart(rng: np.random.Generator, least_m: float) -> FloatArray:
    """Eight agents, crowded, none of them nearer than that."""
    placed: list[FloatArray] = []
    while len(placed) < 8:
        one = rng.uniform(-0.7, 0.7, 3)
        if all(np.linalg.norm(one - other) >= least_m for other in placed):
            placed.append(one)
    return np.array(placed)


def test_outside_of_r_the_damper_alone_never_turns_a_wish_around() -> None:
    """u . v >= |v|^2 for every answer v of the damper to a wish u."""
    rng = np.random.default_rng(1)
    changed = 0
    for _ in range(200):
        views = _at_rest(_apart(rng, 0.47))
        wish = saturate(rng.normal(0.0, 0.5, (8, 3)), 0.5)
        after = damp(views, wish, PARAMS).vel_flu_m_s
        along, squared = (wish * after).sum(axis=1), (after**2).sum(axis=1)
        assert np.all(along >= squared - 1e-9)
        changed += int((np.linalg.norm(after - wish, axis=1) > 1e-6).sum())
    assert changed > 250


def test_after_algorithm_2_it_may_which_is_where_the_statement_ends() -> None:
    rng = np.random.default_rng(SEED)
    views = _at_rest(_apart(rng, 0.46))
    wish = saturate(rng.normal(0.0, 0.5, (8, 3)), 0.5)
    turned = avoid(views, wish, SafetySphere(0.45, 0.6)).vel_flu_m_s
    assert np.all((wish * turned).sum(axis=1) >= 0.0)
    assert np.any((wish * damp(views, turned, PARAMS).vel_flu_m_s).sum(axis=1) < 0.0)


def test_who_is_alone_is_bound_by_nobody() -> None:
    views = _at_rest(np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]))
    wish = np.array([[0.4, 0.0, 0.0], [-0.4, 0.0, 0.0]])
    assert np.all(np.abs(damp(views, wish, PARAMS).vel_flu_m_s[:, 0]) < 0.1)
    assert np.array_equal(damp(alone(views), wish, PARAMS).vel_flu_m_s, wish)
