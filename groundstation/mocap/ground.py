"""What is wrong with a room while the vehicles stand on their pads: unit, axes, names, places; in words.

Each guess is tried on all bodies at once: one that brings everybody to its pad is what is wrong. Refuses to correct
anything by itself.
"""

from __future__ import annotations

import itertools

import numpy as np

from groundstation.core import frames
from groundstation.core.types import FloatArray
from groundstation.mocap.bodies import MM, RoomConfig

_AT_PAD_M = 0.35
_LEAST_M = 0.05  # what tells one guess from another has to be larger


def pads_words(config: RoomConfig, pos_ned_m: FloatArray) -> list[str | None]:
    """What is wrong with each vehicle's body; None for who stands on its pad.

    Args:
        config: pads.
        pos_ned_m: bodies by vehicle, NaN for who is not seen, shape (n, 3).
    """
    away = np.linalg.norm(pos_ned_m - config.pads_ned_m, axis=1)
    seen = np.isfinite(away)
    wrong = seen & (away > _AT_PAD_M)
    words: list[str | None] = [None] * len(away)
    if not wrong.any():
        return words
    common = _of_all(config.pads_ned_m[seen], pos_ned_m[seen])
    for vehicle in wrong.nonzero()[0].tolist():
        words[vehicle] = common or _of_one(config, pos_ned_m, vehicle, float(away[vehicle]))
    return words


def _of_all(pads_ned_m: FloatArray, pos_ned_m: FloatArray) -> str | None:
    """A mistake of the whole room that explains where everybody is."""
    raw = frames.enu_from_ned(pos_ned_m)
    x, y, z = raw.T
    axes = {
        "": raw,
        "y": np.stack([x, -z, y], axis=1),
        "y, x forward": np.stack([z, x, y], axis=1),
    }
    pads = frames.enu_from_ned(pads_ned_m)
    for (up, places), (unit, scale) in itertools.product(axes.items(), (("m", 1.0), ("mm", MM))):
        if (up, unit) != ("", "m") and np.linalg.norm(scale * places - pads, axis=1).max() <= _AT_PAD_M:
            parts = []
            if unit == "mm":
                parts.append("its unit is millimetres; write unit: mm under positioning")
            if up == "y":
                parts.append("its y axis points up; write up: y under positioning, or let the system stream z up")
            elif up:
                parts.append("its y axis points up and its axes are turned; let the system stream z up")
            return f"the motion capture's frames are not as the mission says: {', and '.join(parts)}"
    return None


def _of_one(config: RoomConfig, pos_ned_m: FloatArray, vehicle: int, away_m: float) -> str:
    ids = config.ids
    near = np.linalg.norm(pos_ned_m[vehicle] - config.pads_ned_m, axis=1)
    other = int(near.argmin())
    if other != vehicle and near[other] <= _AT_PAD_M:
        back = np.linalg.norm(pos_ned_m[other] - config.pads_ned_m[vehicle])
        both = ", and the other way round" if back <= _AT_PAD_M else ""
        return (
            f"its body stands on the pad of vehicle {ids[other]}{both}; correct the names (vehicles[].body), or put the"
            " vehicles on their own pads"
        )
    east, north, up = frames.enu_from_ned(pos_ned_m[vehicle])
    return (
        f"its body is seen at {east:.2f} {north:.2f} {up:.2f} m, {away_m:.2f} m from its pad, limit {_AT_PAD_M} m;"
        " put it there, correct pad_m, or the room's origin"
    )
