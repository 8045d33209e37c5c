"""The emulator's own frame conversions: ENU to NED, thrust direction to attitude, local to geodetic.

Independent of the ground station's on purpose: a sign error shared by both sides would cancel itself and pass every
test. Arrays are structures of arrays here, shape (3, n): one row for each axis, as the physics keeps them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WGS84_A_M = 6378137.0
WGS84_F = 1.0 / 298.257223563
_E2 = WGS84_F * (2.0 - WGS84_F)
# An operation on an array and a number takes half as long again as one on two arrays, and these arrays are small.
_ONE, _TWO, _HALF, _TWO_PI = np.array(1.0), np.array(2.0), np.array(0.5), np.array(2.0 * math.pi)
_PI, _HALF_PI = np.array(math.pi), np.array(math.pi / 2.0)
_E2_ROOM, _E2_ARRAY, _A = np.array(1.0 - _E2), np.array(_E2), np.array(WGS84_A_M)


def ned_from_enu(vec_enu: Array) -> Array:
    """Turns east-north-up components into north-east-down ones; its own inverse.

    Args:
        vec_enu: shape (3, ...), any unit.

    Returns:
        Same shape and unit.
    """
    out = np.empty_like(vec_enu)
    out[0] = vec_enu[1]
    out[1] = vec_enu[0]
    out[2] = -vec_enu[2]
    return out


def between(values: Array, low: Array | float, high: Array | float) -> Array:
    """``np.clip(values, low, high)`` at a third of its cost; what is not a number stays that."""
    return np.asarray(np.minimum(np.maximum(values, low), high))


def yaw_ned_from_enu(yaw_rad: Array | float) -> Array:
    """Turns a heading counted from east counter-clockwise into one from north clockwise; its own inverse.

    Args:
        yaw_rad: any shape.

    Returns:
        Same shape, within (-pi, pi].
    """
    return wrap_pi(_HALF_PI - np.asarray(yaw_rad, dtype=np.float64))


def wrap_pi(angle_rad: Array) -> Array:
    """Brings angles into (-pi, pi], shape kept."""
    wrapped: Array = _PI - np.mod(_PI - angle_rad, _TWO_PI)
    return wrapped


def euler_from_thrust(up_enu: Array, yaw_ned_rad: Array) -> tuple[Array, Array]:
    """Finds the roll and pitch under which the body's upward axis points along a direction.

    Args:
        up_enu: unit vectors of the thrust, shape (3, n), ENU.
        yaw_ned_rad: headings, shape (n,), from north clockwise.

    Returns:
        (roll, pitch) of the rotation from FRD to NED in the order yaw, pitch, roll, shape (n,) each, rad.
    """
    c, s = np.cos(yaw_ned_rad), np.sin(yaw_ned_rad)
    # the body's z axis (down) in NED is minus the thrust: north -up[1], east -up[0], down up[2]; turned by -yaw
    forward = -up_enu[1] * c - up_enu[0] * s
    right = up_enu[1] * s - up_enu[0] * c
    roll = -np.arcsin(np.minimum(np.maximum(right, -_ONE), _ONE))
    pitch = np.arctan2(forward, up_enu[2])
    return roll, pitch


def quat_from_euler(roll_rad: Array, pitch_rad: Array, yaw_rad: Array) -> Array:
    """Builds the unit quaternion that rotates FRD to NED, order yaw, pitch, roll.

    Returns:
        Shape (4, n), rows w x y z, w >= 0.
    """
    half = np.empty((3, *roll_rad.shape))
    half[0], half[1], half[2] = roll_rad, pitch_rad, yaw_rad
    half *= _HALF
    cosine, sine = np.cos(half), np.sin(half)
    cy, sy = cosine[2], sine[2]
    cr_cp, sr_sp = cosine[0] * cosine[1], sine[0] * sine[1]
    sr_cp, cr_sp = sine[0] * cosine[1], cosine[0] * sine[1]
    quat = np.empty((4, *roll_rad.shape))
    np.add(cr_cp * cy, sr_sp * sy, out=quat[0])
    np.subtract(sr_cp * cy, cr_sp * sy, out=quat[1])
    np.add(cr_sp * cy, sr_cp * sy, out=quat[2])
    np.subtract(cr_cp * sy, sr_sp * cy, out=quat[3])
    behind = quat[0] < 0.0
    return np.where(behind, -quat, quat) if b"\1" in behind.tobytes() else quat


def frd_from_ned(quat_ned_from_frd: Array, vec_ned: Array) -> Array:
    """Turns NED components into body components.

    Args:
        quat_ned_from_frd: shape (4, n), w x y z.
        vec_ned: shape (3, n).

    Returns:
        Shape (3, n).
    """
    # v' = v - 2 w (q x v) + 2 q x (q x v), the rotation by the conjugate; crosses of rows one and two further on
    axis = quat_ned_from_frd[1:]
    twice, q = np.concatenate([vec_ned, vec_ned]), np.concatenate([axis, axis])
    ahead, behind = q[1:4], q[2:5]
    turn = _TWO * (ahead * twice[2:5] - behind * twice[1:4])
    turns = np.concatenate([turn, turn])
    return np.asarray(vec_ned - quat_ned_from_frd[0] * turn + (ahead * turns[2:5] - behind * turns[1:4]))


def is_place(lat_deg: float, lon_deg: float, alt_m: float) -> bool:
    """Whether three numbers can be a position near the ground; not so for NaN, infinities and typing errors."""
    return abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0 and abs(alt_m) <= 100_000.0


class Geodesy:
    """WGS84 position of points near a reference, exact to below 0.1 mm within 100 km.

    Args:
        lat_deg: latitude of the reference.
        lon_deg: longitude of the reference.
        alt_m: its height above the ellipsoid (taken as above mean sea level too: the emulated geoid is the ellipsoid).
    """

    def __init__(self, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        slat, clat, slon, clon = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
        self._ecef_from_enu = np.array(
            [[-slon, -slat * clon, clat * clon], [clon, -slat * slon, clat * slon], [0.0, clat, slat]]
        )
        self._origin_ecef = _ecef(lat, lon, alt_m)

    def geodetic_from_enu(self, pos_enu_m: Array) -> tuple[Array, Array, Array]:
        """Latitude (deg), longitude (deg) and height (m) of points, shape (3, n) in, (n,) each out."""
        x, y, z = self._ecef_from_enu @ pos_enu_m + self._origin_ecef[:, None]
        p = np.sqrt(x * x + y * y)
        lat = np.arctan2(z, p * _E2_ROOM)
        for _ in range(3):  # near the surface every turn gains a factor of e2 = 0.0067 at least: 1e-14 rad at the end
            sin_lat = np.sin(lat)
            n = _A / np.sqrt(_ONE - _E2_ARRAY * sin_lat * sin_lat)
            lat = np.arctan2(z + _E2_ARRAY * n * sin_lat, p)
        sin_lat, cos_lat = np.sin(lat), np.cos(lat)
        n = _A / np.sqrt(_ONE - _E2_ARRAY * sin_lat * sin_lat)
        alt = p * cos_lat + (z + _E2_ARRAY * n * sin_lat) * sin_lat - n
        return np.degrees(lat), np.degrees(np.arctan2(y, x)), alt

    def enu_from_geodetic(self, lat_deg: float, lon_deg: float, alt_m: float) -> Array:
        """Position of one point relative to the reference, shape (3,), ENU m."""
        delta = _ecef(math.radians(lat_deg), math.radians(lon_deg), alt_m) - self._origin_ecef
        return np.asarray(self._ecef_from_enu.T @ delta)


def _ecef(lat_rad: float, lon_rad: float, alt_m: float) -> Array:
    n = WGS84_A_M / math.sqrt(1.0 - _E2 * math.sin(lat_rad) ** 2)
    return np.array(
        [
            (n + alt_m) * math.cos(lat_rad) * math.cos(lon_rad),
            (n + alt_m) * math.cos(lat_rad) * math.sin(lon_rad),
            (n * (1.0 - _E2) + alt_m) * math.sin(lat_rad),
        ]
    )
