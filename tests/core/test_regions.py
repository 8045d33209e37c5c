"""Safety regions: their norm, their distance and what the damper's argument needs of it, and how they grow."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.core.regions import (
    REGIONS,
    SafetyCylinder,
    SafetyEllipsoid,
    SafetyRegion,
    SafetySphere,
    build_region,
    rot_level_from_flu,
)
from groundstation.core.types import FloatArray

regions = st.builds(
    build_region, st.sampled_from(sorted(REGIONS)), st.floats(0.2, 1.0), st.floats(1.0, 2.0), st.floats(0.1, 2.0)
)
seeds = st.integers(0, 2**32 - 1)


def offsets(seed: int, count: int = 200) -> FloatArray:
    return np.random.default_rng(seed).normal(0.0, 1.0, (count, 3))


def distances(region: SafetyRegion, offset: FloatArray, extra_m: float = 0.0) -> FloatArray:
    return region.distance(offset, np.full(len(offset), extra_m))[0]


def test_cylinder_by_hand() -> None:
    cylinder = SafetyCylinder(0.5, 0.6, 1.0)
    offset = np.array([[0.9, 0, 0.2], [0, 0.2, -1.5], [0.8, 0, 1.4], [0, 0.4, 0.5], [0.1, 0.0, 0.8]])
    np.testing.assert_allclose(cylinder.clearance(offset), [1.8, 1.5, 1.6, 0.8, 0.8])
    distance, gradient = cylinder.distance(offset, np.zeros(5))
    np.testing.assert_allclose(distance, [0.4, 0.5, 0.5, -0.1, -0.2])  # aside, below, off the edge, inside twice
    np.testing.assert_allclose(gradient, [[1.0, 0, 0], [0, 0, -1.0], [0.6, 0, 0.8], [0, 1.0, 0], [0, 0, 1.0]])
    np.testing.assert_allclose(cylinder.distance(offset, np.full(5, 0.1))[0], [0.3, 0.4, np.sqrt(0.13), -0.2, -0.3])


def test_ellipsoid_by_hand() -> None:
    ellipsoid = SafetyEllipsoid(0.5, 0.6, 1.5)
    offset = np.array([[1.0, 0, 0], [0, 0, 3.0], [0.3, 0.4, 0.0], [0, 0, -0.75]])
    np.testing.assert_allclose(ellipsoid.clearance(offset), [2.0, 2.0, 1.0, 0.5])
    distance, gradient = ellipsoid.distance(offset, np.zeros(4))
    np.testing.assert_allclose(distance, [0.5, 0.5, 0.0, -0.25], atol=1e-12)  # a third of the metres up and down
    np.testing.assert_allclose(gradient, [[1.0, 0, 0], [0, 0, 1 / 3], [0.6, 0.8, 0], [0, 0, -1 / 3]])
    assert ellipsoid.reach_m(1.0) == pytest.approx(4.5)


@given(regions, seeds, st.floats(0.0, 0.5))
def test_distance_is_zero_on_the_surface_and_never_more_than_the_way_there(
    region: SafetyRegion, seed: int, extra_m: float
) -> None:
    offset = offsets(seed)
    surface = offset / region.clearance(offset)[:, None]
    np.testing.assert_allclose(distances(region, surface), 0.0, atol=1e-9)
    assert (np.sign(distances(region, offset)) == np.sign(region.clearance(offset) - 1.0)).all()
    other = offsets(seed + 1)
    change = distances(region, offset, extra_m) - distances(region, other, extra_m)
    assert (np.abs(change) <= np.linalg.norm(offset - other, axis=1) + 1e-9).all()
    assert (distances(region, offset, extra_m) <= distances(region, offset) + 1e-12).all()


@given(regions, seeds)
def test_distance_is_convex_and_its_gradient_is_its_slope(region: SafetyRegion, seed: int) -> None:
    offset, other = offsets(seed), offsets(seed + 1)
    distance, gradient = region.distance(offset, np.zeros(len(offset)))
    # A convex function lies above each of its tangents; that is all the damper's argument needs of it.
    assert (distances(region, other) >= distance + ((other - offset) * gradient).sum(axis=1) - 1e-9).all()
    assert (np.linalg.norm(gradient, axis=1) <= 1.0 + 1e-12).all()
    assert (np.linalg.norm(gradient, axis=1) > 1e-3).all()


@given(regions, seeds, st.floats(0.0, 0.3))
def test_what_is_outside_of_the_grown_region_may_be_off_by_so_much(
    region: SafetyRegion, seed: int, by_m: float
) -> None:
    grown = region.grown(by_m)
    offset = offsets(seed)
    surface = offset / grown.clearance(offset)[:, None]
    off = offsets(seed + 1)
    off *= by_m / np.linalg.norm(off, axis=1, keepdims=True)
    assert (region.clearance(surface + off) >= 1.0 - 1e-9).all()
    assert grown.activation_m - grown.radius_m == pytest.approx(region.activation_m - region.radius_m)


@given(regions, seeds)
def test_room_is_how_much_a_region_may_grow(region: SafetyRegion, seed: int) -> None:
    offset = offsets(seed, 5) + np.array([2.5, 0, 0])
    outside = offset[region.clearance(offset) > 1.0]
    if not len(outside):
        return
    room_m = region.room_m(outside)
    assert region.grown(0.999 * room_m).clearance(outside).min() > 1.0
    if not isinstance(region, SafetyEllipsoid):  # a grown ellipsoid's own growth is a little less
        assert region.grown(room_m).clearance(outside).min() == pytest.approx(1.0)
    inside = offset / region.clearance(offset)[:, None] * 0.9
    assert region.room_m(inside) < 0.0


@given(regions, seeds, st.floats(0.0, 2.0))
def test_who_is_out_of_reach_is_farther_outside(region: SafetyRegion, seed: int, beyond_m: float) -> None:
    offset = offsets(seed)
    offset *= (region.reach_m(beyond_m) * 1.001 / np.linalg.norm(offset, axis=1))[:, None]
    assert (distances(region, offset) > beyond_m).all()


@given(seeds)
def test_level_axes_have_z_up_and_turn_nothing_else(seed: int) -> None:
    up = offsets(seed, 20)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    up[0], up[1] = [0, 0, 1], [1, 0, 0]
    rot = rot_level_from_flu(up)
    np.testing.assert_allclose(rot @ np.swapaxes(rot, 1, 2), np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rot), 1.0)
    np.testing.assert_allclose(np.einsum("mij,mj->mi", rot, up), np.tile([0.0, 0, 1], (20, 1)), atol=1e-12)
    np.testing.assert_array_equal(rot[0], np.eye(3))


@pytest.mark.parametrize("shape", ["cylinder", "ellipsoid"])
@pytest.mark.parametrize("half_height_m", [0.0, -1.0, np.nan, np.inf])
def test_impossible_heights_are_refused(shape: str, half_height_m: float) -> None:
    with pytest.raises(ValueError, match=f"safety {shape}: half height"):
        build_region(shape, 0.4, 0.5, half_height_m)


def test_a_sphere_takes_no_notice_of_a_half_height() -> None:
    assert build_region("sphere", 0.4, 0.5, np.nan) == SafetySphere(0.4, 0.5)
