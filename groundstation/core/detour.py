"""A way round those who stand in the way, from one agent's own view.

Others are taken for balls that stand still. The way is the shortest one over points around these balls (a visibility
graph); it is good for the moment only, is followed under avoidance and damper like any other wish, and planned again
from a new view when it does not work out. Refuses nothing: where there is no way it says so.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from groundstation.core.obstacles import Obstacle, Obstacles, clear_of
from groundstation.core.types import BoolArray, FloatArray

_AROUND = 14
_MOST_OBSTACLES = 8
_MOST_BODIES = 4
_CLEAR = 1.03  # ways keep this many times the distance asked for, points lie at _BESIDE times
_BESIDE = 1.12
_WIDER = 1.7  # where points so near leave no way: lines between them pass too near the ball that they surround
_LEFT = 0.1  # length added per metre that a point lies to the left: two agents head on both turn to their right


def _directions(count: int) -> FloatArray:
    """Unit vectors spread evenly over the sphere (golden spiral)."""
    k = np.arange(count) + 0.5
    height = 1.0 - 2.0 * k / count
    around = np.pi * (1.0 + np.sqrt(5.0)) * k
    level = np.sqrt(1.0 - height * height)
    return np.stack([level * np.cos(around), level * np.sin(around), height], axis=1)


_SPREAD = _directions(_AROUND)


def way_round(
    goal_m: FloatArray,
    others_m: FloatArray,
    keep_out_m: float,
    low_m: FloatArray,
    high_m: FloatArray,
    *,
    obstacles: Obstacles | None = None,
) -> FloatArray | None:
    """Finds the shortest way to a point that keeps its distance from all others.

    Whoever is nearer than that already may be left, not approached; whoever stands at the goal itself is expected to
    be gone by then, and is gone round on the way there.

    Args:
        goal_m: relative to the agent, level axes with z up, shape (3,).
        others_m: where the others are, relative to the agent, shape (k, 3).
        keep_out_m: distance to keep from them, > 0.
        low_m: corner of the box that may be flown in, relative to the agent, shape (3,).
        high_m: its other corner.
        obstacles: what stands in the way and is no agent, relative to the agent.

    Returns:
        Points to fly to one after the other, the goal last, shape (p, 3); None where there is no way.
    """
    for beside in (_BESIDE, _WIDER):
        way = _way(goal_m, others_m, keep_out_m, beside * keep_out_m, box_m=(low_m, high_m), obstacles=obstacles)
        if way is not None:
            return way
    return None


def _way(
    goal_m: FloatArray,
    others_m: FloatArray,
    keep_out_m: float,
    beside_m: float,
    *,
    box_m: tuple[FloatArray, FloatArray],
    obstacles: Obstacles | None,
) -> FloatArray | None:
    """One try, over points ``beside_m`` from the middle of every ball."""
    keep_m = _CLEAR * keep_out_m
    along = np.clip(others_m @ goal_m / max(float(goal_m @ goal_m), 1e-12), 0.0, 1.0)
    off = np.linalg.norm(others_m - along[:, None] * goal_m, axis=1)
    others = others_m[np.argsort(off, kind="stable")[:_MOST_OBSTACLES]]
    beside = (others[:, None] + beside_m * _SPREAD[None]).reshape(-1, 3)
    bodies = _on_the_way(obstacles, goal_m)
    if obstacles is not None and bodies:
        around = [body.around_m(obstacles.keep_m) for body in bodies]
        beside = np.concatenate([beside, *around])
    inside = np.all((beside >= box_m[0]) & (beside <= box_m[1]), axis=1)
    clear = np.all(np.linalg.norm(beside[:, None] - others[None], axis=2) >= keep_m, axis=1)
    if obstacles is not None and bodies:
        clear &= clear_of(bodies, beside, _CLEAR * obstacles.keep_m)
    nodes = np.concatenate([np.zeros((1, 3)), goal_m[None], beside[inside & clear]])
    first, second = np.triu_indices(len(nodes), 1)
    length = np.linalg.norm(nodes[second] - nodes[first], axis=1)
    limit = np.minimum(keep_m, 0.999 * np.linalg.norm(others, axis=1))
    at_goal = np.minimum(limit, 0.999 * np.linalg.norm(others - goal_m, axis=1))
    free = _clear_of(nodes[first], nodes[second], others, np.where((second == 1)[:, None], at_goal, limit))
    ends = first == 1  # from the goal on: edges are looked at from the smaller index
    free[ends] = _clear_of(nodes[first[ends]], nodes[second[ends]], others, at_goal[None])
    if obstacles is not None:
        for body in bodies:
            # Whoever is nearer already may leave, and come back to a place that is nearer.
            most_m = 0.98 * float(body.gauge_m(nodes[:2]).min())
            if most_m > 0.0:
                free &= ~body.crossed(nodes[first], nodes[second], min(_CLEAR * obstacles.keep_m, most_m))
    left = np.array([-goal_m[1], goal_m[0], 0.0])
    left /= max(float(np.linalg.norm(left)), 1e-9)
    detour = _LEFT * np.maximum(nodes @ left, 0.0)
    weights = np.zeros((len(nodes), len(nodes)))
    weights[first, second] = np.where(free, length + 0.5 * (detour[first] + detour[second]) + 1e-9, 0.0)
    length_m, before = dijkstra(csr_matrix(weights), directed=False, indices=np.array([0]), return_predecessors=True)
    if not np.isfinite(length_m[0, 1]):
        return None
    way, node = [], 1
    while node != 0:
        way.append(nodes[node])
        node = int(before[0, node])
    return np.array(way[::-1])


def _on_the_way(obstacles: Obstacles | None, goal_m: FloatArray) -> list[Obstacle]:
    """The obstacles that are nearest to the straight way."""
    if obstacles is None:
        return []
    way_m = np.linspace(0.0, 1.0, 16)[:, None] * goal_m
    off_m = [float(body.gauge_m(way_m).min()) for body in obstacles.bodies]
    return [obstacles.bodies[k] for k in np.argsort(off_m, kind="stable")[:_MOST_BODIES].tolist()]


def _clear_of(start_m: FloatArray, end_m: FloatArray, others_m: FloatArray, limit_m: FloatArray) -> BoolArray:
    """Whether straight lines keep their distances from all others; limits of shape (k,) or (lines, k)."""
    line = end_m - start_m
    square = np.maximum((line * line).sum(axis=1), 1e-12)
    offset = others_m[None] - start_m[:, None]
    along = np.clip((offset * line[:, None]).sum(axis=2) / square[:, None], 0.0, 1.0)
    nearest = offset - along[..., None] * line[:, None]
    return np.asarray(np.all((nearest * nearest).sum(axis=2) >= limit_m**2, axis=1), dtype=np.bool_)


def back_off(others_m: FloatArray) -> FloatArray:
    """Direction away from those who are near, the nearest counting most; up where that says nothing; shape (3,)."""
    square = np.maximum((others_m * others_m).sum(axis=1, keepdims=True), 1e-6)
    away = -(others_m / square**1.5).sum(axis=0)
    size = float(np.linalg.norm(away))
    return np.array([0.0, 0.0, 1.0]) if size < 1e-6 else np.asarray(away / size, dtype=np.float64)
