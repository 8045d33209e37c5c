"""The last word: what may be sent, whatever was wanted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from groundstation.core import limits
from groundstation.core.limits import Fence

FENCE = Fence.from_enu(np.array([-3.0, -2.0, 0.2]), np.array([3.0, 2.0, 2.5]))
rows = arrays(np.float64, (4, 3), elements=st.floats(-10, 10))


def test_fence_turns_heights_over() -> None:
    assert FENCE.min_team_ned_m.tolist() == [-2.0, -3.0, -2.5]
    assert FENCE.max_team_ned_m.tolist() == [2.0, 3.0, -0.2]
    outside = FENCE.outside_m(np.array([[0.0, 0, -1], [2.5, 0, -1], [0, -3.25, -1], [0, 0, -0.1], [0, 0, -3]]))
    np.testing.assert_allclose(outside, [0.0, 0.5, 0.25, 0.1, 0.5])


@pytest.mark.parametrize("corner", [[1.0, 0.0, 1.0], [1.0, 1.0, np.nan]])
def test_fence_without_inside_is_refused(corner: list[float]) -> None:
    with pytest.raises(ValueError, match="fence"):
        Fence.from_enu(np.zeros(3), np.array(corner))
    with pytest.raises(ValueError, match="shape"):
        Fence(np.zeros(2), np.ones(3))


def test_clamp_speed_by_hand() -> None:
    vel = np.array([[3.0, 4.0, 0.0], [0.1, 0.2, 0.3], [0.0, 0.0, 0.0]])
    out = limits.clamp_speed(vel, 1.0)
    np.testing.assert_allclose(out[0], [0.6, 0.8, 0.0])
    np.testing.assert_array_equal(out[1:], vel[1:])


def test_clamp_acceleration_by_hand() -> None:
    out = limits.clamp_acceleration(
        np.array([[1.0, 0, 0], [0.2, 0, 0]]), np.array([[0.0, 0, 0], [0.19, 0, 0]]), 2.0, 0.05
    )
    np.testing.assert_allclose(out, [[0.1, 0, 0], [0.2, 0, 0]])


def test_fence_by_hand() -> None:
    pos = np.array([[1.9, 0.0, -1.0], [0.0, 0.0, -0.1], [0.0, 0.0, -0.1]])
    vel = np.array([[0.5, 0.5, -0.5], [0.1, 0.0, 0.3], [0.1, 0.0, -0.3]])
    out = limits.clamp_to_fence(vel, pos, FENCE, 1.0)
    # 0.1 m from the north wall; below the floor sinking ends and climbing goes on.
    np.testing.assert_allclose(out, [[0.1, 0.5, -0.5], [0.1, 0.0, 0.0], [0.1, 0.0, -0.3]], atol=1e-12)


@given(rows, rows, rows)
def test_the_last_word_holds(vel: np.ndarray, previous: np.ndarray, pos: np.ndarray) -> None:
    previous = limits.clamp_speed(previous, 0.5)
    out = limits.apply_limits(
        vel, previous, pos, speed_max_m_s=0.5, accel_max_m_s2=4.0, period_s=0.02, fence=FENCE, fence_rate_1_s=1.0
    )
    assert np.linalg.norm(out, axis=1).max() <= 0.5 + 1e-12
    assert np.linalg.norm(out - previous, axis=1).max() <= 0.08 + 1e-12


@given(rows, rows)
def test_the_fence_only_takes_away(vel: np.ndarray, pos: np.ndarray) -> None:
    out = limits.clamp_to_fence(vel, pos, FENCE, 2.0)
    assert (np.abs(out) <= np.abs(vel)).all()
    assert (out * vel >= 0.0).all()
    beyond_high, beyond_low = pos >= FENCE.max_team_ned_m, pos <= FENCE.min_team_ned_m
    assert (out[beyond_high] <= 0.0).all()
    assert (out[beyond_low] >= 0.0).all()


@settings(deadline=None)
@given(arrays(np.float64, 3, elements=st.floats(-0.5, 0.5)), st.floats(0.1, 5.0))
def test_nobody_who_obeys_leaves_the_fence(wanted: np.ndarray, rate: float) -> None:
    pos = np.array([[0.0, 0.0, -1.0]])
    for _ in range(400):
        pos = pos + 0.05 * limits.clamp_to_fence(wanted[None] * 4, pos, FENCE, rate)
    assert FENCE.outside_m(pos)[0] == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_nothing_that_is_no_number_passes(bad: float) -> None:
    good, wrong = np.zeros((2, 3)), np.array([[0.0, 0, 0], [0.0, bad, 0]])

    def apply(vel: np.ndarray, previous: np.ndarray, pos: np.ndarray) -> np.ndarray:
        return limits.apply_limits(
            vel, previous, pos, speed_max_m_s=1.0, accel_max_m_s2=1.0, period_s=0.02, fence=FENCE, fence_rate_1_s=1.0
        )

    assert not apply(good, good, good).any()
    for arguments in ((wrong, good, good), (good, wrong, good), (good, good, wrong)):
        with pytest.raises(ValueError, match=r"rows \[1\]"):
            apply(*arguments)
    with pytest.raises(ValueError, match="finite"):
        limits.clamp_speed(wrong, 1.0)


def test_impossible_limits_are_refused() -> None:
    zero = np.zeros((1, 3))
    for value in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="positive"):
            limits.clamp_speed(zero, value)
        with pytest.raises(ValueError, match="positive"):
            limits.clamp_acceleration(zero, zero, value, 0.02)
        with pytest.raises(ValueError, match="positive"):
            limits.clamp_acceleration(zero, zero, 1.0, value)
        with pytest.raises(ValueError, match="positive"):
            limits.fence_bounds(zero, FENCE, value)
    with pytest.raises(ValueError, match="shape"):
        limits.clamp_speed(np.zeros(3), 1.0)
