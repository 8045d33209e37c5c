"""Gains of a team with members missing: what Theorem 1 asks of gains holds for those that are left."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.app.resources import packaged_configs
from groundstation.core.control import ScaleFunction, formation_control
from groundstation.core.reduction import task_for_those_left, without_roles
from groundstation.core.views import local_views
from groundstation.design.store import load_formation, load_gains

CONFIGS = packaged_configs()
NAMES = sorted(path.stem for path in (CONFIGS / "gains").glob("*.npz") if path.stem != "pair2")
LOADED = {
    name: (
        load_formation(CONFIGS / "formations" / f"{name}.yaml"),
        load_gains(CONFIGS / "gains" / f"{name}.npz").gains,
    )
    for name in NAMES
}


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(NAMES), st.data())
def test_what_is_left_keeps_its_kernel_and_stays_negative(name: str, data: st.DataObject) -> None:
    formation, gains = LOADED[name]
    n = formation.size
    count = data.draw(st.integers(1, max(1, (n - 1) // 2)))
    gone = np.zeros(n, dtype=np.bool_)
    gone[data.draw(st.permutations(range(n)))[:count]] = True
    smaller, reduced, left = without_roles(formation, gains, gone)
    assert left.tolist() == np.flatnonzero(~gone).tolist()
    np.testing.assert_array_equal(smaller.points_enu_m, formation.points_enu_m[left])
    xy, z = smaller.points_enu_m[:, 0] + 1j * smaller.points_enu_m[:, 1], smaller.points_enu_m[:, 2]
    for vector in (np.ones(len(left)), xy):
        assert np.abs(reduced.xy @ vector).max() < 1e-4
    for vector in (np.ones(len(left)), z):
        assert np.abs(reduced.z @ vector).max() < 1e-4
    np.testing.assert_allclose(reduced.xy, reduced.xy.conj().T, atol=1e-9)
    assert np.linalg.eigvalsh(reduced.xy).max() < 1e-4
    assert np.linalg.eigvalsh(reduced.z).max() < 1e-4
    # Whoever has a gain has an edge to see it by.
    seen = smaller.adjacency | np.eye(len(left), dtype=np.bool_)
    assert np.abs(reduced.xy[~seen]).max(initial=0.0) < 1e-9
    assert np.abs(reduced.z[~seen]).max(initial=0.0) < 1e-9


def test_a_cube_without_a_corner_stands_still_under_the_law_and_would_not_without_the_reduction() -> None:
    formation, gains = LOADED["cube8"]
    roles = np.array([3, 1, 2, 0, 7, 5, 6, 4])
    gone = np.zeros(8, dtype=np.bool_)
    gone[2] = True
    task, smaller, _ = task_for_those_left(formation, gains, roles, gone)
    assert smaller.size == 7
    assert not task.neighbours[2].any()
    assert not task.neighbours[:, 2].any()
    points = formation.points_enu_m[roles]
    pos_ned = np.stack([points[:, 1], points[:, 0], -points[:, 2]], axis=1)
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (8, 1))
    views = local_views(pos_ned, np.zeros((8, 3)), quat, task.neighbours)
    wish = formation_control(views, task, ScaleFunction(), 1.0, upright_1_s=1.0)
    assert np.abs(wish).max() < 1e-4


def test_a_team_too_small_is_refused() -> None:
    formation, gains = LOADED["cube8"]
    gone = np.ones(8, dtype=np.bool_)
    gone[0] = False
    with pytest.raises(ValueError, match="1 of 8 roles are left, minimum is 2"):
        without_roles(formation, gains, gone)


def test_a_pyramid_without_its_top_is_a_flat_formation() -> None:
    formation, gains = LOADED["pyramid5"]
    top = int(np.argmax(formation.points_enu_m[:, 2]))
    smaller, reduced, _ = without_roles(formation, gains, np.arange(5) == top)
    assert np.ptp(smaller.points_enu_m[:, 2]) < 1e-9
    assert np.linalg.eigvalsh(reduced.z).max() < 1e-4
    assert np.linalg.eigvalsh(reduced.xy)[:2].max() < -0.1


def test_gains_that_come_along_are_there() -> None:
    assert len(NAMES) >= 8
    assert Path(CONFIGS / "gains" / f"{NAMES[0]}.npz").is_file()
