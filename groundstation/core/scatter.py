"""Apart from each other and down, by velocities alone: for a team of which nobody knows any more where it is.

Positions are those that were known last. Everybody flies straight away from the middle, each in a direction of its own,
two that stood one above the other as well, while it sinks; so distances grow with time, and errors that grow with its
square catch up later. Directions are evenly spread; which turn of them, and who gets which, is tried out.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from groundstation.core.types import FloatArray

_TURNS = 24
_STEP_S = 0.1
_TINY_M = 1e-3


def scatter(pos_ned_m: FloatArray, sink_m_s: FloatArray, seconds: float, speed_m_s: float) -> FloatArray:
    """Velocities that part a team, NED.

    Args:
        pos_ned_m: where they were last, shape (n, 3).
        sink_m_s: of each, downwards, shape (n,).
        seconds: how long they fly so.
        speed_m_s: of each, horizontally.

    Returns:
        Shape (n, 3): of the turns that were tried, the one with the largest smallest distance on the way.
    """
    n = len(pos_ned_m)
    away = pos_ned_m[:, :2] - pos_ned_m[:, :2].mean(axis=0)
    far = np.linalg.norm(away, axis=1)
    unit = away / np.maximum(far, _TINY_M)[:, None]
    at_s = np.arange(0.0, seconds + _STEP_S, _STEP_S)
    best: FloatArray = np.zeros((n, 3))
    found_m = -np.inf
    for turn in np.arange(_TURNS) * (2.0 * np.pi / (n * _TURNS)):
        angle = turn + 2.0 * np.pi * np.arange(n) / n
        rays = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        row, ray = linear_sum_assignment(-(unit @ rays.T))
        vel = np.zeros((n, 3))
        vel[row, :2], vel[:, 2] = speed_m_s * rays[ray], sink_m_s
        smallest_m = _smallest_m(pos_ned_m, vel, at_s)
        if smallest_m > found_m + 1e-9:
            best, found_m = vel, smallest_m
    return best


def _smallest_m(pos: FloatArray, vel: FloatArray, at_s: FloatArray) -> float:
    """Smallest distance of two on their ways."""
    place = pos + vel * at_s[:, None, None]
    apart = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1)
    first, second = np.triu_indices(len(pos), 1)
    return float(apart[:, first, second].min(initial=np.inf))
