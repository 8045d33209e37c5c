"""Frames against values worked out by hand: a sign error here would cancel itself everywhere else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.core import frames
from groundstation.core.types import FloatArray

HALF = np.sqrt(0.5)


def quat(roll: float, pitch: float, yaw: float) -> FloatArray:
    return frames.quat_ned_from_frd_of_euler(np.float64(roll), np.float64(pitch), np.float64(yaw))  # type: ignore[arg-type]


def test_enu_and_ned_exchange_axes() -> None:
    enu = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, -6.0]])
    np.testing.assert_array_equal(frames.ned_from_enu(enu), [[2.0, 1.0, -3.0], [5.0, -4.0, 6.0]])
    np.testing.assert_array_equal(frames.enu_from_ned(frames.ned_from_enu(enu)), enu)


def test_euler_quaternions_by_hand() -> None:
    np.testing.assert_allclose(quat(0, 0, np.pi / 2), [HALF, 0, 0, HALF], atol=1e-15)  # facing east
    np.testing.assert_allclose(quat(np.pi / 2, 0, 0), [HALF, HALF, 0, 0], atol=1e-15)
    np.testing.assert_allclose(quat(0, np.pi / 2, 0), [HALF, 0, HALF, 0], atol=1e-15)
    assert quat(0.1, 0.2, 1.9 * np.pi)[0] >= 0.0


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw", "frd", "ned"),
    [
        (0, 0, 0, [1, 2, 3], [1, 2, 3]),
        (0, 0, np.pi / 2, [1, 0, 0], [0, 1, 0]),  # facing east, forward is east
        (0, 0, np.pi / 2, [0, 1, 0], [-1, 0, 0]),  # ... and right is south
        (0, np.pi / 2, 0, [1, 0, 0], [0, 0, -1]),  # nose up, forward is up
        (np.pi / 2, 0, 0, [0, 1, 0], [0, 0, 1]),  # right side down, right is down
        (0, np.pi / 6, np.pi / 2, [1, 0, 0], [0, np.sqrt(0.75), -0.5]),  # east and 30 degrees up
    ],
)
def test_rotation_from_frd_by_hand(roll: float, pitch: float, yaw: float, frd: list[float], ned: list[float]) -> None:
    rot = frames.rot_ned_from_frd(quat(roll, pitch, yaw))
    np.testing.assert_allclose(rot @ np.array(frd, dtype=np.float64), ned, atol=1e-15)


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw", "flu", "ned"),
    [
        (0, 0, 0, [1, 2, 3], [1, -2, -3]),  # facing north: left is west, up is -down
        (0, 0, np.pi / 2, [0, 1, 0], [1, 0, 0]),  # facing east, left is north
        (0, 0, np.pi / 2, [0, 0, 1], [0, 0, -1]),
        (np.pi / 6, 0, 0, [0, 0, 1], [0, 0.5, -np.sqrt(0.75)]),  # right side down: up leans to the right, east
        (0, -np.pi / 6, 0, [0, 0, 1], [0.5, 0, -np.sqrt(0.75)]),  # nose down: up leans forward, and it flies forward
    ],
)
def test_rotation_from_flu_by_hand(roll: float, pitch: float, yaw: float, flu: list[float], ned: list[float]) -> None:
    rot = frames.rot_ned_from_flu(quat(roll, pitch, yaw))
    np.testing.assert_allclose(rot @ np.array(flu, dtype=np.float64), ned, atol=1e-15)


angles = st.floats(-3.0, 3.0)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_rotations_are_proper_and_yaw_is_read_back(roll: float, pitch: float, yaw: float) -> None:
    attitude = quat(roll, pitch, yaw)
    for rot in (frames.rot_ned_from_frd(attitude), frames.rot_ned_from_flu(attitude)):
        np.testing.assert_allclose(rot @ rot.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rot) == pytest.approx(1.0)
    np.testing.assert_allclose(frames.wrap_angle(frames.yaw_ned_from_quat(attitude) - yaw), 0.0, atol=1e-9)


@given(st.lists(st.tuples(angles, angles, angles), min_size=1, max_size=5), st.floats(0.9, 1.1))
def test_batches_and_rounded_lengths(eulers: list[tuple[float, float, float]], length: float) -> None:
    batch = np.array([quat(*euler) for euler in eulers])
    vectors = np.arange(3.0 * len(batch)).reshape(-1, 3)
    rot = frames.rot_ned_from_flu(batch * length)
    turned = frames.rotate(rot, vectors)
    for i, attitude in enumerate(batch):
        np.testing.assert_allclose(turned[i], frames.rot_ned_from_flu(attitude) @ vectors[i], atol=1e-12)
    np.testing.assert_allclose(frames.rotate_back(rot, turned), vectors, atol=1e-12)


def test_yaw_between_enu_and_ned() -> None:
    np.testing.assert_allclose(frames.yaw_ned_from_enu(np.array([0.0, np.pi / 2, np.pi])), [np.pi / 2, 0, -np.pi / 2])


@pytest.mark.parametrize("bad", [[0.0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_no_attitude_is_refused(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="no attitude"):
        frames.rot_ned_from_frd(np.array([bad]))


def test_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match="w x y z"):
        frames.rot_ned_from_frd(np.zeros((2, 3)))


def test_the_downward_axes_are_the_last_columns_of_the_rotations_to_the_bit() -> None:
    quats = np.random.default_rng(3).normal(size=(64, 4))
    np.testing.assert_array_equal(frames.down_ned(quats), frames.rot_ned_from_frd(quats)[..., 2])
    matrices, vectors = frames.rot_ned_from_frd(quats), quats[:, 1:]
    there = frames.rotate(np.swapaxes(matrices, -1, -2), vectors)
    np.testing.assert_array_equal(frames.rotate_back(matrices, vectors), there)
