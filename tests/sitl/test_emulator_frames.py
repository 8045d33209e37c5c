"""The emulator's own frame conversions against hand-computed values and against pymap3d."""

from __future__ import annotations

import math

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl import frames


def test_axes_by_hand() -> None:
    east, north, up = np.eye(3)
    assert frames.ned_from_enu(east).tolist() == [0.0, 1.0, 0.0]
    assert frames.ned_from_enu(north).tolist() == [1.0, 0.0, 0.0]
    assert frames.ned_from_enu(up).tolist() == [0.0, 0.0, -1.0]


@pytest.mark.parametrize(
    ("enu_deg", "ned_deg"), [(90.0, 0.0), (0.0, 90.0), (180.0, -90.0), (-90.0, 180.0), (45.0, 45.0), (270.0, 180.0)]
)
def test_headings_by_hand(enu_deg: float, ned_deg: float) -> None:
    assert math.degrees(float(frames.yaw_ned_from_enu(math.radians(enu_deg)))) == pytest.approx(ned_deg)


def _rotation(quat: np.ndarray) -> np.ndarray:
    """Matrix of a unit quaternion w x y z, written out independently of the module."""
    w, x, y, z = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_quaternions_by_hand() -> None:
    half = math.sqrt(0.5)
    zero = np.zeros(1)
    right_angle = np.full(1, math.pi / 2)
    assert frames.quat_from_euler(zero, zero, right_angle)[:, 0] == pytest.approx([half, 0, 0, half])
    assert frames.quat_from_euler(right_angle, zero, zero)[:, 0] == pytest.approx([half, half, 0, 0])
    assert frames.quat_from_euler(zero, right_angle, zero)[:, 0] == pytest.approx([half, 0, half, 0])


def test_tilt_by_hand() -> None:
    # facing north, thrust leaning north: nose down, so pitch is negative
    lean = math.radians(10.0)
    up = np.array([[0.0], [math.sin(lean)], [math.cos(lean)]])
    roll, pitch = frames.euler_from_thrust(up, np.zeros(1))
    assert (roll[0], pitch[0]) == pytest.approx((0.0, -lean))
    # facing north, leaning east: right side down, roll positive
    up = np.array([[math.sin(lean)], [0.0], [math.cos(lean)]])
    roll, pitch = frames.euler_from_thrust(up, np.zeros(1))
    assert (roll[0], pitch[0]) == pytest.approx((lean, 0.0))
    # facing east, leaning east: nose down again
    roll, pitch = frames.euler_from_thrust(up, np.full(1, math.pi / 2))
    assert (roll[0], pitch[0]) == pytest.approx((0.0, -lean))


@given(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.floats(-math.pi, math.pi))
def test_attitude_puts_the_thrust_where_it_acts(east: float, north: float, yaw: float) -> None:
    up = np.array([[east], [north], [1.0]])
    up /= np.linalg.norm(up)
    heading = np.full(1, yaw)
    roll, pitch = frames.euler_from_thrust(up, heading)
    quat = frames.quat_from_euler(roll, pitch, heading)
    assert quat[0, 0] >= 0.0
    matrix = _rotation(quat[:, 0])
    down_ned = matrix[:, 2]
    assert (-down_ned[1], -down_ned[0], down_ned[2]) == pytest.approx(tuple(up[:, 0]), abs=1e-9)
    assert math.atan2(matrix[1, 0], matrix[0, 0]) == pytest.approx(yaw, abs=1e-9)
    vector = np.array([[0.3], [-1.2], [0.7]])
    assert frames.frd_from_ned(quat, vector)[:, 0] == pytest.approx(matrix.T @ vector[:, 0], abs=1e-12)


@given(
    st.floats(-80.0, 80.0),
    st.floats(-179.0, 179.0),
    st.floats(-100.0, 3000.0),
    st.tuples(st.floats(-5000.0, 5000.0), st.floats(-5000.0, 5000.0), st.floats(-100.0, 500.0)),
)
def test_geodesy_agrees_with_pymap3d(lat: float, lon: float, alt: float, enu: tuple[float, float, float]) -> None:
    geodesy = frames.Geodesy(lat, lon, alt)
    mine = [float(value[0]) for value in geodesy.geodetic_from_enu(np.array([[c] for c in enu]))]
    theirs = pymap3d.enu2geodetic(*enu, lat, lon, alt)
    assert mine[0] == pytest.approx(theirs[0], abs=1e-10)
    assert mine[1] == pytest.approx(theirs[1], abs=1e-9)
    assert mine[2] == pytest.approx(theirs[2], abs=1e-5)
    back = geodesy.enu_from_geodetic(*mine)
    assert back == pytest.approx(enu, abs=1e-4)


def test_a_degree_of_latitude_by_hand() -> None:
    # 1 km north of the equator at sea level: the radius of curvature there is a (1 - e2) = 6335439.327 m
    lat, lon, _ = frames.Geodesy(0.0, 10.0, 0.0).geodetic_from_enu(np.array([[0.0], [1000.0], [0.0]]))
    assert lat[0] == pytest.approx(math.degrees(1000.0 / 6335439.327), rel=1e-6)
    assert lon[0] == pytest.approx(10.0, abs=1e-12)
