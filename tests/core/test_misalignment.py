"""Theorem 2 and what lag leaves of it: wishes that are turned by a constant angle, by the program and by a witness.

The witness shares no code with the program: it reads the gains file with numpy, flies (2) and (14) in complex numbers,
and its bounds are worked out by hand.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.control import ScaleFunction, formation_control, task_for_roles
from groundstation.core.formation import Gains
from groundstation.core.types import ComplexArray, FloatArray
from groundstation.core.views import local_views
from groundstation.design.store import load_formation

CONFIGS = packaged_configs()
STORED = np.load(CONFIGS / "gains" / "cube8.npz")
FREE, FIXED = ScaleFunction("free"), ScaleFunction("arctan", 2.5)
LEVEL = np.tile([1.0, 0.0, 0.0, 0.0], (8, 1))


def _start(seed: int) -> FloatArray:
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (8, 3))


# -- the witness


def _full(blocks: ComplexArray) -> ComplexArray:
    off = blocks - np.diag(np.diag(blocks))
    return np.asarray(off - np.diag(off.sum(axis=1)))


A_XY, A_Z = _full(STORED["xy"]), _full(STORED["z"].astype(complex)).real


def _away_m(pos_m: FloatArray) -> float:
    """How far from the kernel of A: the formation in any place, at any heading and any size."""
    flat, cube = pos_m[:, 0] + 1j * pos_m[:, 1], STORED["points"]
    level, upright = np.stack([np.ones(8), cube[:, 0] + 1j * cube[:, 1]]).T, np.stack([np.ones(8), cube[:, 2]]).T
    rest = flat - level @ np.linalg.lstsq(level, flat, rcond=None)[0]
    return float(np.hypot(np.abs(rest).max(), _rest(pos_m[:, 2], upright)))


def _rest(z_m: FloatArray, basis: FloatArray) -> float:
    return float(np.abs(z_m - basis @ np.linalg.lstsq(basis, z_m, rcond=None)[0]).max())


def _fly(pos_m: FloatArray, bias_rad: FloatArray, seconds: float, step_s: float = 0.002) -> FloatArray:
    """Points under (2) whose level motion is turned by constant angles, shape (8,)."""
    flat, z, turn = pos_m[:, 0] + 1j * pos_m[:, 1], pos_m[:, 2].copy(), np.exp(1j * bias_rad)
    for _ in range(round(seconds / step_s)):
        flat = flat + step_s * turn * (A_XY @ flat)
        z = z + step_s * (A_Z @ z)
    return np.stack([flat.real, flat.imag, z], axis=1)


def _grows_with_lag(bias_rad: float, k_lambda_tau: float) -> bool:
    """Whether tau s^2 + s + k lambda e^(i bias) = 0 has a root to the right, for tau = 1."""
    roots = np.roots([1.0, 1.0, k_lambda_tau * np.exp(1j * bias_rad)])
    return bool(roots.real.max() > 0.0)


def _grows_in_time(bias_rad: float, gain: float, lag_s: float) -> bool:
    """Whether the team of points with a first-order lag flies apart under (2), all turned alike."""
    flat = _start(2)[:, 0] + 1j * _start(2)[:, 1]
    velocity, turn, step_s, sizes = np.zeros(8, dtype=complex), np.exp(1j * bias_rad), 0.001, []
    for number in range(24_000):
        velocity = velocity + step_s / lag_s * (gain * turn * (A_XY @ flat) - velocity)
        flat = flat + step_s * velocity
        if number % 8_000 == 7_999:
            sizes.append(float(np.abs(A_XY @ flat).max()))
    return sizes[-1] > sizes[0]


# -- the program


def _program(
    pos_m: FloatArray, turn: Callable[[FloatArray], FloatArray], scale: ScaleFunction, steps: int
) -> FloatArray:
    """The same points under the program's views and law, level, facing north; NED."""
    shape = load_formation(CONFIGS / "formations" / "cube8.yaml")
    task = task_for_roles(shape, Gains(xy=STORED["xy"], z=STORED["z"]), np.arange(8))
    everybody = np.ones((8, 8), dtype=np.bool_)
    pos_ned_m = pos_m[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    for _ in range(steps):
        views = local_views(pos_ned_m, np.zeros((8, 3)), LEVEL, everybody)
        wish_enu = formation_control(views, task, scale)[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]  # forward is north, left west
        pos_ned_m = pos_ned_m + 0.002 * turn(wish_enu)[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    return pos_ned_m[:, [1, 0, 2]] * [1.0, 1.0, -1.0]


def _by(bias_rad: FloatArray) -> Callable[[FloatArray], FloatArray]:
    c, s, one, zero = np.cos(bias_rad), np.sin(bias_rad), np.ones(8), np.zeros(8)
    rot = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    return lambda wish: np.asarray(np.einsum("nij,nj->ni", rot, wish))


def test_the_program_and_the_witness_fly_the_same_way() -> None:
    bias_rad = np.random.default_rng(5).uniform(-1.2, 1.2, 8)
    flown = _program(_start(1), _by(bias_rad), FREE, 500)
    assert flown == pytest.approx(_fly(_start(1), bias_rad, 1.0), abs=1e-9)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("alike", [True, False])
def test_below_a_right_angle_points_form_and_beyond_it_they_fly_apart(seed: int, alike: bool) -> None:
    sides = np.ones(8) if alike else np.random.default_rng(seed).choice([-1.0, 1.0], 8)
    start = _start(seed)
    for bias_deg in (0.0, 45.0, 80.0):
        assert _away_m(_fly(start, math.radians(bias_deg) * sides, 8.0)) < 0.02 * _away_m(start), bias_deg
    assert _away_m(_fly(start, math.radians(95.0) * np.ones(8), 8.0)) > 5.0 * _away_m(start)


@pytest.mark.parametrize("bias_deg", [20.0, 60.0])
def test_with_a_fixed_scale_they_come_to_the_size_that_was_asked_for(bias_deg: float) -> None:
    """Of Theorem 2's free scale and rotation (14) leaves the rotation: distances are right, from near the formation."""
    near = STORED["points"] + np.random.default_rng(1).normal(0.0, 0.15, (8, 3))
    flown = _program(near, _by(math.radians(bias_deg) * np.ones(8)), FIXED, 3000)
    wanted, found = (np.linalg.norm(x[:, None] - x[None], axis=2) for x in (STORED["points"], flown))
    assert np.abs(wanted - found).max() < 0.01


def test_lag_leaves_65_degrees_of_the_right_angle() -> None:
    """With k lambda tau = 0.5, what `gain: auto` allows, the bound is cos b = 0.5 sin^2 b, which is sqrt(2) - 1."""
    bound = math.acos(math.sqrt(2.0) - 1.0)
    assert math.degrees(bound) == pytest.approx(65.5, abs=0.05)
    for off_deg, grows in ((-0.5, False), (0.5, True)):
        assert _grows_with_lag(bound + math.radians(off_deg), 0.5) is grows
    rate = float(np.abs(np.linalg.eigvalsh(A_XY)).max())
    assert rate == pytest.approx(10.0, rel=1e-3)
    for off_deg, grows in ((-3.0, False), (3.0, True)):
        assert _grows_in_time(bound + math.radians(off_deg), 0.5 / (rate * 0.4), 0.4) is grows, off_deg


def test_a_turn_of_view_and_motion_together_changes_nothing() -> None:
    """Why the bias has to lie between the setpoint and the motion: a heading that view and motion share cancels."""
    shape = load_formation(CONFIGS / "formations" / "cube8.yaml")
    task = task_for_roles(shape, Gains(xy=STORED["xy"], z=STORED["z"]), np.arange(8))
    pos_ned_m, everybody = _start(4), np.ones((8, 8), dtype=np.bool_)
    yaw = np.random.default_rng(2).uniform(-3.0, 3.0, 8)
    turned = np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], axis=1)
    level = formation_control(local_views(pos_ned_m, np.zeros((8, 3)), LEVEL, everybody), task, FREE)
    own = formation_control(local_views(pos_ned_m, np.zeros((8, 3)), turned, everybody), task, FREE)
    assert _by(-yaw)(own) == pytest.approx(level)


def _switched(pos_m: FloatArray, *, waits: bool, both_ways: bool) -> FloatArray:
    """Points under (2) whose edges are lost a third of the time, anew every 0.2 s; who lacks one waits, or goes on."""
    rng, edges = np.random.default_rng(8), np.abs(A_XY) + np.abs(A_Z) > 1e-9
    flat, z = pos_m[:, 0] + 1j * pos_m[:, 1], pos_m[:, 2].copy()
    for _ in range(150):
        there = rng.random((8, 8)) > 1.0 / 3.0
        if both_ways:
            there = np.triu(there, 1) | np.triu(there, 1).T
        there = np.asarray(there & edges & ~np.eye(8, dtype=bool))
        moves = np.asarray((there == (edges & ~np.eye(8, dtype=bool))).all(axis=1)) if waits else np.ones(8, dtype=bool)
        a_xy, a_z = _full(np.where(there, A_XY, 0.0)), _full(np.where(there, A_Z, 0.0).astype(complex)).real
        for _ in range(100):
            flat = flat + 0.002 * moves * (a_xy @ flat)
            z = z + 0.002 * moves * (a_z @ z)
    return np.stack([flat.real, flat.imag, z], axis=1)


@pytest.mark.parametrize("both_ways", [True, False])
def test_with_edges_lost_and_found_who_waits_comes_to_the_formation_and_who_goes_on_does_not(both_ways: bool) -> None:
    """Why agents wait: c_i = 0 for a while is within Theorem 2 and Remark 3, a sum that lacks a term is not."""
    waited, went_on = (_switched(_start(3), waits=waits, both_ways=both_ways) for waits in (True, False))
    assert _away_m(waited) < 0.01 * float(waited[:, :2].std(axis=0).max())
    assert _away_m(went_on) > 0.2 * float(went_on[:, :2].std(axis=0).max())  # of its size, which it loses as well
