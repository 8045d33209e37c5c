"""Frames and rotations: ENU and NED, quaternions, the tilted body frames.

Inside the ground station everything is NED (x north, y east, z down) and bodies are FRD (x forward, y right, z
down), as MAVLink has it. Files are ENU (x east, y north, z up). The control law of the paper wants frames whose z
points up, so agents act in their body frame FLU (x forward, y left, z up): with z down the sign of b_ij in equation
(3) would flip and the formation would not form. Both handednesses meet here and nowhere else.

Refuses: quaternions that are no rotation (zero or not finite), and to guess which frame an array is in.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.quick import every
from groundstation.core.types import FloatArray

_PAIRS = [one + other for one in "wxyz" for other in "wxyz"]
# Entries of a rotation matrix, row by row, as products of two parts of its quaternion: one, and plus or minus another.
_ONE = np.array([_PAIRS.index(pair) for pair in ("yy", "xy", "xz", "xy", "xx", "yz", "xz", "yz", "xx")])
_OTHER = np.array([_PAIRS.index(pair) for pair in ("zz", "wz", "wy", "wz", "zz", "wx", "wy", "wx", "yy")])
_SIGN = np.array([1.0, -1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])
_FRD_FROM_FLU = np.array([1.0, -1.0, -1.0])
"""Diagonal of the half turn about x that takes FLU to FRD; it is its own inverse."""


def ned_from_enu(vector_enu: FloatArray) -> FloatArray:
    """Turns ENU vectors into NED.

    Args:
        vector_enu: shape (..., 3), any unit.

    Returns:
        Shape (..., 3): (east, north, up) becomes (north, east, -up).
    """
    result = np.empty_like(vector_enu, dtype=np.float64)
    result[..., 0] = vector_enu[..., 1]
    result[..., 1] = vector_enu[..., 0]
    result[..., 2] = -vector_enu[..., 2]
    return result


def enu_from_ned(vector_ned: FloatArray) -> FloatArray:
    """Turns NED vectors into ENU; the same exchange of axes as `ned_from_enu`, which is its own inverse."""
    return ned_from_enu(vector_ned)


def wrap_angle(angle_rad: FloatArray) -> FloatArray:
    """Brings angles into [-pi, pi)."""
    return np.asarray((angle_rad + np.pi) % (2.0 * np.pi) - np.pi, dtype=np.float64)


def yaw_ned_from_enu(yaw_enu_rad: FloatArray) -> FloatArray:
    """Turns yaw counted from east, counterclockwise seen from above, into yaw from north, clockwise; and back."""
    return wrap_angle(np.pi / 2.0 - np.asarray(yaw_enu_rad, dtype=np.float64))


def quat_ned_from_frd_of_euler(roll_rad: FloatArray, pitch_rad: FloatArray, yaw_ned_rad: FloatArray) -> FloatArray:
    """Makes attitudes of Euler angles in the order of MAVLink's ATTITUDE: yaw about z, then pitch, then roll.

    Args:
        roll_rad: shape (...), positive with the right side down.
        pitch_rad: shape (...), positive with the nose up.
        yaw_ned_rad: shape (...), 0 facing north, positive towards east.

    Returns:
        Unit quaternions w x y z rotating body FRD to NED, shape (..., 4), w >= 0.
    """
    half = np.stack(np.broadcast_arrays(roll_rad, pitch_rad, yaw_ned_rad), axis=-1) / 2.0
    cos_r, cos_p, cos_y = np.moveaxis(np.cos(half), -1, 0)
    sin_r, sin_p, sin_y = np.moveaxis(np.sin(half), -1, 0)
    quat = np.stack(
        [
            cos_r * cos_p * cos_y + sin_r * sin_p * sin_y,
            sin_r * cos_p * cos_y - cos_r * sin_p * sin_y,
            cos_r * sin_p * cos_y + sin_r * cos_p * sin_y,
            cos_r * cos_p * sin_y - sin_r * sin_p * cos_y,
        ],
        axis=-1,
    )
    return np.asarray(np.where(quat[..., :1] < 0.0, -quat, quat), dtype=np.float64)


def rot_ned_from_frd(quat_ned_from_frd: FloatArray) -> FloatArray:
    """Makes rotation matrices of attitudes.

    Args:
        quat_ned_from_frd: w x y z, shape (..., 4); the length need not be exactly one (telemetry is rounded).

    Returns:
        Shape (..., 3, 3), so that ``vector_ned = rot @ vector_frd``.

    Raises:
        ValueError: shape, or a quaternion that is zero or not finite.
    """
    quat = np.asarray(quat_ned_from_frd, dtype=np.float64)
    if quat.shape[-1:] != (4,):
        raise ValueError(f"quaternions have shape {quat.shape}, expected (..., 4): w x y z")
    none = "a quaternion is zero or not finite, and so no attitude; leave that vehicle out"
    if not every(np.isfinite(quat)):
        raise ValueError(none)
    products = quat[..., :, None] * quat[..., None, :]
    square = products[..., 0, 0] + products[..., 1, 1] + products[..., 2, 2] + products[..., 3, 3]
    if not every((square > 1e-12) & (square < np.inf)):
        raise ValueError(none)
    flat = products.reshape(*quat.shape[:-1], 16)
    # 1 - s (yy + zz), s (xy - wz), s (xz + wy), and so on, all nine together
    rot = (2.0 / square)[..., None] * (flat.take(_ONE, axis=-1) + flat.take(_OTHER, axis=-1) * _SIGN)
    rot[..., ::4] = 1.0 - rot[..., ::4]
    return np.asarray(rot.reshape(*quat.shape[:-1], 3, 3), dtype=np.float64)


def down_ned(quat_ned_from_frd: FloatArray) -> FloatArray:
    """The vehicles' own downward axes: the last columns of ``rot_ned_from_frd``, to the bit.

    Args:
        quat_ned_from_frd: w x y z, shape (n, 4), none of them zero or not finite.

    Returns:
        Unit vectors, NED, shape (n, 3).
    """
    w, x, y, z = quat_ned_from_frd.T
    xx, yy = x * x, y * y
    twice = 2.0 / (w * w + xx + yy + z * z)
    down = np.empty((len(quat_ned_from_frd), 3))
    down[:, 0] = twice * (x * z + w * y)
    down[:, 1] = twice * (y * z - w * x)
    down[:, 2] = 1.0 - twice * (xx + yy)
    return down


def rot_ned_from_flu(quat_ned_from_frd: FloatArray) -> FloatArray:
    """Makes the matrices that take an agent's own tilted frame FLU (z up) to NED.

    Args:
        quat_ned_from_frd: w x y z, shape (..., 4), the attitude as MAVLink gives it.

    Returns:
        Shape (..., 3, 3), so that ``vector_ned = rot @ vector_flu``.

    Raises:
        ValueError: shape, or a quaternion that is zero or not finite.
    """
    # Right multiplication by diag(1, -1, -1) negates the columns of y and z.
    return np.asarray(rot_ned_from_frd(quat_ned_from_frd) * _FRD_FROM_FLU, dtype=np.float64)


def yaw_ned_from_quat(quat_ned_from_frd: FloatArray) -> FloatArray:
    """Reads the yaw off attitudes.

    Args:
        quat_ned_from_frd: w x y z, shape (..., 4).

    Returns:
        Heading of the body's x axis, shape (...), 0 facing north, positive towards east, in [-pi, pi].
    """
    w, x, y, z = np.moveaxis(np.asarray(quat_ned_from_frd, dtype=np.float64), -1, 0)
    return np.asarray(np.arctan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z), dtype=np.float64)


def rotate(rot_to_from: FloatArray, vector_from: FloatArray) -> FloatArray:
    """Applies rotations to vectors: ``vector_to = rot_to_from @ vector_from``.

    Written out term by term: every row is computed with the same operations however many rows there are, so that a
    team computed at once equals its agents computed one by one to the bit (BLAS does not promise that).

    Args:
        rot_to_from: shape (..., 3, 3).
        vector_from: shape (..., 3), broadcast against the matrices.

    Returns:
        Shape (..., 3).
    """
    x, y, z = vector_from[..., 0:1], vector_from[..., 1:2], vector_from[..., 2:3]
    vector_to: FloatArray = rot_to_from[..., 0] * x + rot_to_from[..., 1] * y + rot_to_from[..., 2] * z
    return vector_to


def rotate_back(rot_to_from: FloatArray, vector_to: FloatArray) -> FloatArray:
    """Applies the inverse rotations: ``vector_from = rot_to_from.T @ vector_to``; shapes as in `rotate`."""
    x, y, z = vector_to[..., 0:1], vector_to[..., 1:2], vector_to[..., 2:3]
    vector_from: FloatArray = rot_to_from[..., 0, :] * x + rot_to_from[..., 1, :] * y + rot_to_from[..., 2, :] * z
    return vector_from
