"""What is measured on a team: distances, formation error, and which way up the formation came out.

Refuses nothing and decides nothing: numbers for monitors, reports and tests.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from groundstation.core.formation import Formation
from groundstation.core.quick import every, finite_rows, mean, norms, pairs
from groundstation.core.regions import SafetyRegion
from groundstation.core.types import BoolArray, FloatArray, IntArray

_FARTHEST = 8  # agents that are looked at first
_MANY = 64  # agents; for as many a search is quicker than all pairs


def near_pairs(pos_m: FloatArray, within_m: float) -> tuple[IntArray, IntArray]:
    """Pairs of agents among which are all that are within a distance: all pairs of a few, those near of many.

    Args:
        pos_m: shape (n, 3), any one frame; unknown positions (NaN) are in no pair of many.
        within_m: how near those are at most that matter, > 0.

    Returns:
        First and second of each pair, shape (k,), the first before the second, pairs in ascending order.
    """
    if len(pos_m) < _MANY:
        return pairs(len(pos_m))
    index = finite_rows(pos_m).nonzero()[0]
    found = cKDTree(pos_m[index]).query_pairs(within_m * (1.0 + 1e-9), output_type="ndarray")
    first, second = index[found.reshape(-1, 2)].T
    order = np.lexsort((second, first))
    return first[order], second[order]


def pair_distances_m(pos_m: FloatArray) -> FloatArray:
    """Distances between all pairs, shape (..., n, n) for positions (..., n, 3) in any one frame; NaN stays NaN."""
    return norms(pos_m[..., :, None, :] - pos_m[..., None, :, :])


def formation_error_m(pos_m: FloatArray, distances_m: FloatArray, role_of_agent: IntArray) -> float:
    """Largest |d_ij - d*_ij| over all pairs, for the roles that the agents have.

    Args:
        pos_m: shape (n, 3), any one frame.
        distances_m: desired distances by role, shape (n, n) (`Formation.distances_m`).
        role_of_agent: shape (n,).

    Returns:
        Metres; NaN when a position is unknown; 0 for a single agent.
    """
    wanted = distances_m[role_of_agent[:, None], role_of_agent]
    return float(np.maximum.reduce(np.abs(pair_distances_m(pos_m) - wanted), axis=None))


def team_error_m(pos_m: FloatArray, formation: Formation, role_of_agent: IntArray) -> float:
    """``formation_error_m`` of a formation, in teams of any size: where there are many not all pairs are looked at.

    The formation is laid over the positions as well as a turn and a mirror can. No distance of a pair is then wrong by
    more than both of its agents are off their points, so that those farthest off are enough, with everybody.

    Args:
        pos_m: shape (n, 3), any one frame.
        formation: its points say what distances are wanted.
        role_of_agent: shape (n,).

    Returns:
        Metres; NaN when a position is unknown.
    """
    n = len(pos_m)
    if n < _MANY:
        return formation_error_m(pos_m, formation.distances_m, role_of_agent)
    if not every(np.isfinite(pos_m)):
        return math.nan
    points_m = formation.points_enu_m[role_of_agent]
    pos, points = pos_m - pos_m.mean(axis=0), points_m - points_m.mean(axis=0)
    left, _, right = np.linalg.svd(points.T @ pos)
    off = norms(pos - points @ (left @ right))
    order, count = np.argsort(-off, kind="stable"), _FARTHEST
    while True:
        some_of = order[:count, None]
        error_m = float(np.abs(norms(pos[some_of] - pos) - norms(points[some_of] - points)).max())
        if count >= n or 2.0 * off[order[count]] <= error_m:
            return error_m
        count *= 2


def free_scale_error_m(pos_m: FloatArray, points_m: FloatArray, role_of_agent: IntArray) -> float:
    """Largest error of a distance for the law (2), which fixes neither the horizontal nor the vertical scale.

    The formation is laid over the positions by the best turn about z and the best of both scales (Theorem 1).

    Args:
        pos_m: shape (n, 3), any one frame with a vertical third axis.
        points_m: the formation's points by role, ENU, shape (n, 3).
        role_of_agent: shape (n,).

    Returns:
        Metres; NaN when a position is unknown.
    """
    pos, points = pos_m - pos_m.mean(axis=0), points_m[role_of_agent] - points_m[role_of_agent].mean(axis=0)
    # In NED a formation appears mirrored in its heading and upside down; distances do not mind, so both are tried.
    errors = []
    for axes in ([0, 1], [1, 0]):
        p, q = pos[:, axes[0]] + 1j * pos[:, axes[1]], points[:, 0] + 1j * points[:, 1]
        level = np.sum(np.conj(q) * p) / max(float(np.sum((np.conj(q) * q).real)), 1e-12)
        upward = float(pos[:, 2] @ points[:, 2]) / max(float(points[:, 2] @ points[:, 2]), 1e-12)
        scaled = np.stack([np.abs(level) * q.real, np.abs(level) * q.imag, abs(upward) * points[:, 2]], axis=1)
        errors.append(float(np.abs(pair_distances_m(pos) - pair_distances_m(scaled)).max()))
    return min(errors)


def size_ratios(pos_m: FloatArray, points_m: FloatArray) -> tuple[float, float]:
    """How large a team stands against a formation, level and upright, whoever has which role: root mean squares.

    Args:
        pos_m: shape (n, 3), any frame whose third axis is vertical.
        points_m: the formation's points, shape (n, 3).

    Returns:
        Both ratios; NaN when a position is unknown, and where the formation has no extent to compare with.
    """
    pos, points = (np.square(item - item.mean(axis=0)) for item in (pos_m, points_m))
    level, upright = (
        float(np.sqrt(here.sum() / there.sum())) if there.sum() > 1e-12 else float("nan")
        for here, there in ((pos[:, :2], points[:, :2]), (pos[:, 2], points[:, 2]))
    )
    return level, upright


def min_distance_m(pos_m: FloatArray, counted: BoolArray | None = None, *, flying: BoolArray | None = None) -> float:
    """Smallest distance between two counted agents.

    Args:
        pos_m: shape (n, 3), any one frame; unknown positions (NaN) count as nobody.
        counted: who counts, shape (n,); everybody when absent.
        flying: who is in the air, shape (n,): then only pairs count of which one at least is. Two that stand are as
            they were put, but whoever flies can come down on one that stands.

    Returns:
        Metres; infinite when no pair counts.
    """
    if len(pos_m) >= _MANY:
        return _nearest_m(pos_m, counted, flying)
    first, second = _pairs(pos_m, counted, flying)
    return float(norms(pos_m[second] - pos_m[first]).min(initial=np.inf))


def _nearest_m(pos_m: FloatArray, counted: BoolArray | None, flying: BoolArray | None) -> float:
    """The same by a search for the nearest of each, so that large teams do not cost the square of their size."""
    here = finite_rows(pos_m) if counted is None else finite_rows(pos_m) & counted
    rows = here.nonzero()[0]
    asking = rows if flying is None else (here & flying).nonzero()[0]
    if len(rows) < 2 or not len(asking):
        return math.inf
    _, nearest = cKDTree(pos_m[rows]).query(pos_m[asking], k=2)
    found = rows[nearest]
    other = np.where(found[:, 0] == asking, found[:, 1], found[:, 0])  # two may be in one place
    return float(norms(pos_m[other] - pos_m[asking]).min())


def min_clearance(
    pos_m: FloatArray, region: SafetyRegion, counted: BoolArray | None = None, *, flying: BoolArray | None = None
) -> float:
    """Smallest clearance between two counted agents in a safety region's own norm: below 1, one is inside.

    Args:
        pos_m: shape (n, 3), any frame whose third axis is vertical; unknown positions (NaN) count as nobody.
        region: the safety region.
        counted: who counts, shape (n,); everybody when absent.
        flying: as for ``min_distance_m``.

    Returns:
        Dimensionless; infinite when no pair counts.
    """
    if region.by_distance:
        return min_distance_m(pos_m, counted, flying=flying) / region.radius_m
    first, second = _pairs(pos_m, counted, flying)
    return float(region.clearance(pos_m[second] - pos_m[first]).min(initial=np.inf))


def _pairs(pos_m: FloatArray, counted: BoolArray | None, flying: BoolArray | None) -> tuple[IntArray, IntArray]:
    """Pairs of agents with known positions, both counted, one at least in the air where that is asked for."""
    here: BoolArray = finite_rows(pos_m)
    if counted is not None:
        here = here & counted
    first, second = pairs(len(pos_m))
    if every(here) and (flying is None or every(flying)):
        return first, second
    wanted: BoolArray = np.asarray(here[first] & here[second])
    if flying is not None:
        wanted = wanted & (flying[first] | flying[second])
    return first[wanted], second[wanted]


def vertical_orientation(height_m: FloatArray, points_height_m: FloatArray, role_of_agent: IntArray) -> float:
    """Tells a formation from its mirror image upside down, which has all distances right.

    From a flat start both are equally near, and distances cannot tell them apart.

    Args:
        height_m: heights of the agents, up positive, shape (n,).
        points_height_m: heights of the formation's points by role, shape (n,).
        role_of_agent: shape (n,).

    Returns:
        Correlation in [-1, 1]: near 1 upright, near -1 upside down; 0 where either has no height to speak of.
    """
    wanted = points_height_m[role_of_agent]
    a, b = height_m - mean(height_m), wanted - mean(wanted)
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 1e-9 else 0.0
