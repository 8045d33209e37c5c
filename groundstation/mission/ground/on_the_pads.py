"""Who stands where: the right vehicle on the right pad, and far enough from the others.

Judges reported positions in the team frame. Refuses to see a vehicle whose local frame was declared to begin at its
pad stand on another one: such a vehicle reports to be at its pad wherever it stands.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.quick import norms, some
from groundstation.core.types import FloatArray


def wrong_pad(vehicle: int, pos_m: FloatArray, pads_m: FloatArray, limit_m: float) -> int | None:
    """The other vehicle on whose pad this one stands.

    Args:
        vehicle: which one.
        pos_m: where they report to stand, shape (n, 3), heights last; NaN where not known.
        pads_m: where they should, same axes.
        limit_m: how far from a pad a vehicle may report to stand on it.

    Returns:
        Index of the pad's vehicle, None when it stands on its own pad or on none.
    """
    away_m = np.linalg.norm(pads_m[:, :2] - pos_m[vehicle, :2], axis=1)
    if not np.isfinite(away_m).all() or away_m[vehicle] <= limit_m:
        return None
    nearest = int(np.argmin(away_m))
    return nearest if nearest != vehicle and away_m[nearest] <= limit_m else None


def pad_words(vehicle: int, ids: list[int], pos_m: FloatArray, pads_m: FloatArray, limit_m: float) -> str | None:
    """Says on whose pad a vehicle stands, and whether the two have changed places; the end of a sentence."""
    other = wrong_pad(vehicle, pos_m, pads_m, limit_m)
    if other is None:
        return None
    if wrong_pad(other, pos_m, pads_m, limit_m) == vehicle:
        return (
            f": it stands on the pad of vehicle {ids[other]}, and vehicle {ids[other]} on its pad; exchange them, or"
            " their pad_m"
        )
    return f": it stands on the pad of vehicle {ids[other]}; put it on its own pad, or correct pad_m"


def too_near(vehicle: int, pos_m: FloatArray, radius_m: float) -> tuple[int, float] | None:
    """The nearest other vehicle that is reported nearer than r, and how near; None when there is none."""
    apart_m = norms(pos_m - pos_m[vehicle])
    apart_m[vehicle] = np.inf
    near = apart_m < radius_m  # NaN is not
    if not some(near):
        return None
    nearest = int(np.where(near, apart_m, np.inf).argmin())
    return nearest, float(apart_m[nearest])
