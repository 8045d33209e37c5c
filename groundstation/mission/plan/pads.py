"""Pads at different heights, as on posts or stairs: which of them lie above which."""

from __future__ import annotations

import numpy as np

from groundstation.core.types import BoolArray, FloatArray


def pads_above(pads_enu_m: FloatArray, beside_m: float) -> BoolArray:
    """Which pads are so near and higher that whoever is over one of the two is not clear of the other at any height.

    Of such a pair the upper one has to take off first and to land last: in that order each one's height above its pad
    only adds to what keeps the two apart.

    Args:
        pads_enu_m: shape (n, 3).
        beside_m: horizontal distance from which on two vehicles are clear of each other at any heights.

    Returns:
        Element [i, j]: pad j is above pad i, shape (n, n).
    """
    away_m = pads_enu_m[None] - pads_enu_m[:, None]
    return np.asarray((np.hypot(away_m[..., 0], away_m[..., 1]) < beside_m) & (away_m[..., 2] > 0.0), dtype=np.bool_)
