"""Formations and gains as values.

A formation is points and a sensing graph; gains are the matrices of equation (3) that belong to both. Neither
knows a file: ``design.store`` reads and writes them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from groundstation.core.types import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Formation:
    """A desired formation and its sensing graph (Section II).

    Attributes:
        name: for messages and reports.
        points_enu_m: desired positions q*, shape (n, 3), ENU axes, any origin, scale already applied.
        edges: pairs (i, j) of neighbouring roles, counted from 0, i < j, sorted, each once.
    """

    name: str
    points_enu_m: FloatArray
    edges: tuple[tuple[int, int], ...]

    def __post_init__(self) -> None:
        """Refuses shapes and edges that no formation can have.

        Raises:
            ValueError: points not finite or not (n, 3) with n >= 1; an edge out of range, repeated or out of order.
        """
        points = self.points_enu_m
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 1:
            raise ValueError(f"formation {self.name}: points have shape {points.shape}, expected (n, 3) with n >= 1")
        if not np.all(np.isfinite(points)):
            raise ValueError(f"formation {self.name}: points must be finite numbers")
        if list(self.edges) != sorted(set(self.edges)):
            raise ValueError(f"formation {self.name}: edges must be sorted and each given once")
        for i, j in self.edges:
            if not 0 <= i < j < len(points):
                raise ValueError(f"formation {self.name}: edge ({i}, {j}) is not 0 <= i < j < {len(points)}")

    @property
    def size(self) -> int:
        """Number of roles, n."""
        return len(self.points_enu_m)

    @property
    def adjacency(self) -> BoolArray:
        """Sensing graph as a symmetric matrix, shape (n, n), False on the diagonal."""
        adjacency = np.zeros((self.size, self.size), dtype=np.bool_)
        for i, j in self.edges:
            adjacency[i, j] = adjacency[j, i] = True
        return adjacency

    @cached_property
    def distances_m(self) -> FloatArray:
        """Desired distances d*_ij between all pairs, shape (n, n), 0 on the diagonal; not to be written."""
        difference = self.points_enu_m[:, None] - self.points_enu_m[None, :]
        distances = np.asarray(np.linalg.norm(difference, axis=-1), dtype=np.float64)
        distances.flags.writeable = False
        return distances


@dataclass(frozen=True)
class Gains:
    """Gain matrices A_ij of equation (3), split into their horizontal and vertical parts.

    With p = x + iy in axes whose z points up, u_xy = sum_j xy[i, j] (p_j - p_i) and u_z = sum_j z[i, j] (z_j - z_i).
    The diagonals hold the negative row sums, so that ``xy @ p`` and ``z @ pz`` are the closed loop (6).

    Attributes:
        xy: a_ij + i b_ij, shape (n, n), complex Hermitian, negative semidefinite, 1/s.
        z: c_ij, shape (n, n), real symmetric, negative semidefinite, 1/s.
    """

    xy: ComplexArray
    z: FloatArray

    def __post_init__(self) -> None:
        """Refuses blocks that are not two square matrices of one size."""
        if self.xy.ndim != 2 or self.xy.shape[0] != self.xy.shape[1] or self.z.shape != self.xy.shape:
            raise ValueError(f"gains: xy has shape {self.xy.shape} and z {self.z.shape}, expected two (n, n)")
