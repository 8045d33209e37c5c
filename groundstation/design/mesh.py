"""Gains and graphs for hundreds of agents and more, in seconds: triangles, of which every one is a design by itself.

For three mutual neighbours there is one unit vector v on their places that is orthogonal to 1 and to the coordinate
(``triangles``), and v v* is admissible. So is every sum of them with positive weights, which is positive semidefinite
and has the kernel that is wanted as soon as the triangles hang together. No solver is needed, and none could do it for
a thousand agents in reasonable time. Nothing is said about the best: the bound of the certificate is the trivial one.

A graph whose triangles join agents at random, a few to each, keeps its slowest mode however large the team is, where
that of nearest neighbours falls with the number of agents (docs/gains.md).
"""

from __future__ import annotations

import itertools

import numpy as np
import scipy.sparse
import scipy.spatial

from groundstation.core.formation import Formation
from groundstation.core.types import IntArray
from groundstation.design.problem import Block, BlockSolution, Watch
from groundstation.design.triangles import triangle_vectors, triangles

LEVEL_ROUNDS, ROUNDS = 6, 6
"""Triangles of each agent in a proposed graph, among those of its height and among all: 24 neighbours at most."""

STEEP = 1.5
"""How high a triangle reaches, in distances of nearest neighbours, for half of its weight in the horizontal block."""


def solve_triangles(block: Block, gap: float, watch: Watch | None = None) -> BlockSolution:
    """H = the sum of v v* over all triangles of the graph.

    Args:
        block: the problem.
        gap: ignored, nothing is approached.
        watch: ignored, the answer is immediate.

    Returns:
        The sum, with a dual that proves nothing. Horizontally steep triangles weigh less: who leans sees the neighbours
        high above it to the side, which the control gain has to pay for (``core.control.most_for_tilted_views``).
    """
    del gap, watch
    corners, rows = triangle_vectors(block, triangles(block))
    if block.heights is None:
        weighted = rows
    else:
        reach = np.ptp(block.heights[corners], axis=1)
        places = np.stack([block.coordinate.real, block.coordinate.imag, block.heights], axis=1)
        nearest = np.median(scipy.spatial.cKDTree(places).query(places, [2])[0])
        weighted = scipy.sparse.diags_array(1.0 / (1.0 + (reach / (STEEP * nearest)) ** 2)) @ rows
    matrix = (rows.conj().T @ weighted).toarray().astype(block.dtype)
    dual = np.zeros(matrix.shape, dtype=matrix.dtype)
    return BlockSolution(matrix=matrix, dual=dual, iterations=0, finished=True)


def mesh(formation: Formation, seed: int = 0) -> Formation:
    """A graph of triangles for any number of agents from three on: they are dealt out in threes, again and again.

    Args:
        formation: its points; its edges are ignored.
        seed: of the dealing; the same one gives the same graph.

    Returns:
        The points with the edges of all the triangles, half of them among agents of about one height.
    """
    rng = np.random.default_rng(seed)
    n, heights = formation.size, formation.points_enu_m[:, 2]
    edges: set[tuple[int, int]] = set()
    for number in range(LEVEL_ROUNDS + ROUNDS):
        dealt: IntArray = rng.permutation(n)
        if number < LEVEL_ROUNDS:
            dealt = dealt[np.argsort(heights[dealt], kind="stable")]
        dealt = np.concatenate([dealt, dealt[: -n % 3]])  # the last three may hold some of the first
        for three in dealt.reshape(-1, 3).tolist():
            edges |= set(itertools.combinations(sorted(three), 2))
    return Formation(formation.name, formation.points_enu_m, tuple(sorted(edges)))
