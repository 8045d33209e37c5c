"""Velocities that part a team: everybody away from the middle and from everybody else, stacked ones as well."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.core.scatter import scatter
from groundstation.core.types import FloatArray


def _apart_m(pos: FloatArray) -> float:
    away = np.linalg.norm(pos[:, None] - pos[None], axis=-1)
    return float(away[np.triu_indices(len(pos), 1)].min())


def test_two_that_stand_one_above_the_other_part() -> None:
    pos = np.array([[0.0, 0.0, -0.5], [0.0, 0.0, -1.3]])
    vel = scatter(pos, np.array([0.2, 1.0]), 1.0, 1.0)
    assert vel[:, 2].tolist() == [0.2, 1.0]
    assert np.linalg.norm(vel[:, :2], axis=1) == pytest.approx([1.0, 1.0])
    assert vel[0, :2] == pytest.approx(-vel[1, :2])


def test_a_cube_parts_by_columns_and_comes_no_nearer_than_it_was() -> None:
    x, y, z = np.meshgrid([-0.4, 0.4], [-0.4, 0.4], [-0.4, -1.2])
    pos = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    sink = (-pos[:, 2] - 0.3) / 1.2
    vel = scatter(pos, sink, 1.2, 1.0)
    outward = (vel[:, :2] * pos[:, :2]).sum(axis=1)
    assert (outward > 0.0).all()
    nearest = [_apart_m(pos + vel * t) for t in np.linspace(0.0, 1.2, 25)]
    assert min(nearest) > 0.55
    assert nearest[-1] > 0.9


@given(st.integers(1, 12), st.integers(0, 1000))
def test_all_have_the_speed_and_a_direction_of_their_own(n: int, seed: int) -> None:
    pos = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 3))
    vel = scatter(pos, np.full(n, 0.5), 1.0, 0.8)
    assert np.linalg.norm(vel[:, :2], axis=1) == pytest.approx(np.full(n, 0.8))
    directions = np.sort(np.arctan2(vel[:, 1], vel[:, 0]))
    gaps = np.diff(np.append(directions, directions[0] + 2.0 * np.pi))
    assert gaps == pytest.approx(np.full(n, 2.0 * np.pi / n))
