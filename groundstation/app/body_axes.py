"""Attitudes as other programs draw bodies: x forward, y left, z up, in axes east, north, up."""

from __future__ import annotations

import numpy as np

from groundstation.core.types import FloatArray

_HALF = np.sqrt(0.5)
_ENU_FROM_NED = np.array([0.0, _HALF, _HALF, 0.0])
_FRD_FROM_FLU = np.array([0.0, 1.0, 0.0, 0.0])


def enu_from_flu(quat_ned_from_frd: FloatArray) -> FloatArray:
    """The same attitude between ENU and forward, left, up; unit quaternion, scalar first, shape (4,)."""
    return _product(_product(_ENU_FROM_NED, quat_ned_from_frd), _FRD_FROM_FLU)


def _product(first: FloatArray, second: FloatArray) -> FloatArray:
    w, vector, w2, vector2 = first[0], first[1:], second[0], second[1:]
    return np.concatenate([[w * w2 - vector @ vector2], w * vector2 + w2 * vector + np.cross(vector, vector2)])
