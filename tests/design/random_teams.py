"""Random formations for the tests of gain design: shapes and graphs, degenerate ones included."""

from __future__ import annotations

import numpy as np

from groundstation.core.formation import Formation
from groundstation.core.types import FloatArray

SHAPES = ("general", "near-coincident", "near-planar", "planar", "line", "vertical", "slanted", "grid")
GRAPHS = ("tree", "cycle", "disconnected", "random", "dense", "complete", "nearly-complete", "nearest", "wheel")

Edges = set[tuple[int, int]]


def random_team(seed: int, largest: int = 40) -> Formation:
    """One random input: n from 2 to ``largest``, any shape, any graph, any scale, often far from the origin."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, largest + 1)) if rng.random() < 0.6 else int(rng.integers(2, min(13, largest + 1)))
    shape, graph = str(rng.choice(SHAPES)), str(rng.choice(GRAPHS))
    points = random_points(rng, n, shape)
    edges = {(i, j) for i, j in random_edges(rng, points, graph) if i < j}
    return Formation(f"{shape}, {graph}, {seed}", points, tuple(sorted(edges)))


def random_points(rng: np.random.Generator, n: int, shape: str) -> FloatArray:
    points = rng.normal(size=(n, 3))
    if shape == "near-coincident":
        points[1] = points[0] + rng.normal(size=3) * 10.0 ** rng.uniform(-9, -3)
    elif shape == "near-planar":
        points[:, rng.integers(3)] *= 10.0 ** rng.uniform(-9, -3)
    elif shape == "planar":
        points[:, rng.integers(3)] = rng.normal()
    elif shape == "line":
        points = np.outer(rng.normal(size=n), rng.normal(size=3)) + rng.normal(size=3)
    elif shape == "vertical":
        points[:, :2] = rng.normal(size=2)
    elif shape == "slanted":
        points = rng.normal(size=(n, 2)) @ rng.normal(size=(2, 3))
    elif shape == "grid":
        points = np.round(3 * points / np.abs(points).max())
    points = points * rng.choice([0.01, 1.0, 100.0])
    if rng.random() < 0.3:
        points = points + rng.normal(size=3) * 1000 * np.abs(points).max()
    return np.asarray(points, dtype=np.float64)


def random_edges(rng: np.random.Generator, points: FloatArray, graph: str) -> Edges:
    n = len(points)
    pairs = [(i, j) for i in range(n) for j in range(i + 1, n)]
    if graph == "tree":
        return {(int(rng.integers(j)), j) for j in range(1, n)}
    if graph == "cycle":
        return {(j, j + 1) for j in range(n - 1)} | ({(0, n - 1)} if n > 2 else set())
    if graph == "disconnected":
        return {(i, j) for i, j in pairs if (i < n // 2) == (j < n // 2)}
    if graph == "nearly-complete":
        lost = rng.choice(len(pairs), min(3, len(pairs) - 1), replace=False)
        return {pair for k, pair in enumerate(pairs) if k not in lost}
    if graph == "nearest":
        distances = np.linalg.norm(points[:, None] - points[None], axis=2)
        near = np.argsort(distances, axis=1)[:, :6]
        return {(min(i, int(j)), max(i, int(j))) for i in range(n) for j in near[i]}
    if graph == "wheel":
        return (
            {(0, j) for j in range(1, n)} | {(j, j + 1) for j in range(1, n - 1)} | ({(1, n - 1)} if n > 3 else set())
        )
    share = {"random": rng.uniform(0.1, 0.7), "dense": 0.85, "complete": 1.0}[graph]
    return {pair for pair in pairs if rng.random() < share}
