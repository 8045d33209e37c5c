"""Points of common formations: rings, grids, cubes, lines, Vs and spheres.

Two nearest agents are 1 m apart, so that the ``scale`` of a formation file is that distance. Which edges are worth
having, ``graphs`` says.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from groundstation.core.choices import unknown
from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray

_RANGE = 2, 2_000
_GOLDEN_RAD = np.pi * (3.0 - np.sqrt(5.0))


def ring(agents: int) -> FloatArray:
    """A regular polygon at one height."""
    angles = 2.0 * np.pi * np.arange(agents) / agents
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(agents)])


def line(agents: int) -> FloatArray:
    """A line to the east."""
    return np.column_stack([np.arange(agents, dtype=np.float64), np.zeros(agents), np.zeros(agents)])


def vee(agents: int) -> FloatArray:
    """A V that points north, agent 1 in front, the others by turns on its right and its left."""
    rank = (np.arange(agents) + 1) // 2
    side = np.where(np.arange(agents) % 2 == 1, 1.0, -1.0)
    return np.column_stack([side * rank, -rank.astype(np.float64), np.zeros(agents)])


def grid(agents: int) -> FloatArray:
    """Rows of a square at one height; the last row may be shorter."""
    width = int(np.ceil(np.sqrt(agents)))
    return np.column_stack([np.arange(agents) % width, np.arange(agents) // width, np.zeros(agents)]).astype(np.float64)


def cube(agents: int) -> FloatArray:
    """Layers of a cube, bottom first; the last layer may be incomplete."""
    width = 1
    while width**3 < agents:
        width += 1
    index = np.arange(agents)
    return np.column_stack([index % width, index // width % width, index // width**2]).astype(np.float64)


def sphere(agents: int) -> FloatArray:
    """Points spread evenly over a sphere, along a golden spiral."""
    up = 1.0 - 2.0 * (np.arange(agents) + 0.5) / agents
    level = np.sqrt(1.0 - up**2)
    angles = _GOLDEN_RAD * np.arange(agents)
    return np.column_stack([level * np.cos(angles), level * np.sin(angles), up])


SHAPES: dict[str, Callable[[int], FloatArray]] = {
    "ring": ring,
    "line": line,
    "v": vee,
    "grid": grid,
    "cube": cube,
    "sphere": sphere,
}
"""Name: points for a number of agents, shape (n, 3), ENU, of any size."""


def points_of(shape: str, agents: int) -> FloatArray:
    """Points of a shape whose two nearest agents are 1 m apart, the lowest of them at height 0.

    Args:
        shape: one of ``SHAPES``.
        agents: how many, 2 to 2,000.

    Returns:
        ENU, m, shape (agents, 3).

    Raises:
        UserError: no such shape, or not that many agents.
    """
    if shape not in SHAPES:
        raise UserError(f"{shape}: {unknown(shape, SHAPES)}")
    if not _RANGE[0] <= agents <= _RANGE[1]:
        raise UserError(f"--agents {agents}: must be {_RANGE[0]} to {_RANGE[1]}")
    points = SHAPES[shape](agents)
    points = points / shortest_m(points)
    points[:, 2] -= points[:, 2].min()
    return points


def shortest_m(points_m: FloatArray) -> float:
    """Shortest distance between two of the points, shape (n, 3), n >= 2."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - loading it takes a while

    distances_m, _ = cKDTree(points_m).query(points_m, k=[2])  # the nearest one is the point itself
    return float(np.min(distances_m))
