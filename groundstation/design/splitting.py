"""Douglas-Rachford splitting for nearly complete graphs, and for teams too large for an interior point.

One set holds the matrices with the graph's pattern and kernel, the other those with t I <= H <= I, t as large as it
may be. Projections onto both are cheap: one factorised linear solve, one Hermitian eigendecomposition. The difference
of the two projections converges to a dual matrix, which ``certify`` turns into a bound; so the gap is known while it
runs.

Nearly complete graphs are reduced first, exactly. Missing edges constrain H only through Q* e_i of the agents that miss
one. Off the span of those vectors, replacing Q* H Q by the identity leaves every constraint and, by interlacing, the
bounds as they are. With 50 edges missing among 1000 agents a problem of size 998 becomes one of size 100 or less.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg

from groundstation.core.types import FloatArray, IntArray
from groundstation.design.closed_form import solve_complete
from groundstation.design.problem import (
    Block,
    BlockSolution,
    Matrix,
    Progress,
    Watch,
    hermitian_part,
    pattern_equations,
    zero_solution,
)

MOST_ITERATIONS = 20_000
WEIGHT = 0.5
"""Reward for t, relative to the distance of the identity from the pattern."""

NOTHING = 1e-8
"""Bound below which nothing is left to be found."""

CHECK_EVERY = 10
"""Iterations between two looks at the gap."""


@dataclass(frozen=True)
class _Reduced:
    """A smaller problem with the same optimum, and the ways back.

    Attributes:
        size: of its matrices.
        project: onto the matrices with the graph's pattern and kernel, (size, size) to (size, size).
        expand: from the small matrix to Q* H Q and on to H, shape (n, n).
        lift: from a small dual matrix to D, shape (n, n).
        complex: whether entries are complex.
    """

    size: int
    project: Callable[[Matrix], Matrix]
    expand: Callable[[Matrix], Matrix]
    lift: Callable[[Matrix], Matrix]


def missing_edges(block: Block) -> IntArray:
    """Pairs i < j that are no edge, shape (f, 2)."""
    return np.argwhere(np.triu(~block.adjacency, 1)).astype(np.int64)


def _few_missing(block: Block, absent: IntArray) -> _Reduced:
    """Reduction to the agents that miss an edge, constraints H_ij = 0."""
    q = block.complement
    agents, place = np.unique(absent, return_inverse=True)
    i, j = place.reshape(absent.shape).T
    # columns of Q* for those agents; orthonormal basis of their span
    part = q[agents].conj().T
    basis, values, _ = scipy.linalg.svd(part, full_matrices=False)
    basis = basis[:, values > 1e-9 * values[0]]
    small = part.conj().T @ basis  # row of agent a: e_a* Q B, shape (agents, size)
    gram = _constraint_gram(small, i, j, block.is_complex)
    values, directions = np.linalg.eigh(gram)
    kept = values > 1e-12 * values[-1]
    inverse = (directions[:, kept] / values[kept]) @ directions[:, kept].T
    left, right = small[i], small[j]

    def project(matrix: Matrix) -> Matrix:
        entries = np.einsum("fk,fk->f", left @ matrix, right.conj())
        price = inverse @ (np.concatenate([entries.real, entries.imag]) if block.is_complex else entries)
        weights = price[: len(i)] + 1j * price[len(i) :] if block.is_complex else price
        correction = (left.conj().T * weights) @ right
        return np.asarray(matrix - (correction + correction.conj().T) / 2)

    def expand(matrix: Matrix) -> Matrix:
        wide = q @ basis
        rest = np.eye(block.size, dtype=block.dtype) - block.kernel @ block.kernel.conj().T
        return hermitian_part(rest + wide @ (matrix - np.eye(len(matrix))) @ wide.conj().T)

    def lift(dual: Matrix) -> Matrix:
        wide = q @ basis
        return hermitian_part(wide @ dual @ wide.conj().T)

    return _Reduced(basis.shape[1], project, expand, lift)


def _constraint_gram(rows: Matrix, i: IntArray, j: IntArray, is_complex: bool) -> FloatArray:
    """Inner products of the constraints Re H_ij = 0 and Im H_ij = 0.

    With M_e = r_j* r_i, H_ij = tr(K M_e), so that the constraints are (M_e + M_e*) / 2 and (M_e - M_e*) / 2i.

    Args:
        rows: r_a, shape (agents, size).
        i: first agent of each missing edge, index into rows, shape (f,).
        j: second agent, shape (f,).
        is_complex: whether there are imaginary parts.

    Returns:
        Symmetric, shape (f, f) or (2f, 2f).
    """
    inner = rows @ rows.conj().T
    plain = inner[np.ix_(i, j)] * inner[np.ix_(i, j)].T  # tr M_e M_f
    turned = inner[np.ix_(i, i)] * inner[np.ix_(j, j)].T  # tr M_e M_f*
    if not is_complex:
        return np.asarray((plain + turned).real / 2)
    mixed = (plain - turned).imag / 2
    return np.block([[(plain + turned).real / 2, mixed], [mixed.T, (turned - plain).real / 2]])


def _whole(block: Block) -> _Reduced:
    """No reduction: unknown entries on edges and diagonal, constraints H N = 0."""
    n = block.size
    i, j = block.edges[:, 0], block.edges[:, 1]
    every, root = np.arange(n), np.sqrt(2.0)
    equations = pattern_equations(block)
    normal = (equations @ equations.T).tocsc()
    # the equations repeat each other; a shift at the level of rounding and one refinement take care of that
    shift = 1e-12 * float(normal.diagonal().max())
    shifted = normal + shift * scipy.sparse.eye_array(normal.shape[0])
    solve: Callable[[FloatArray], FloatArray]
    if normal.shape[0] <= 5000:
        factor = scipy.linalg.cho_factor(shifted.toarray(), lower=True, overwrite_a=True, check_finite=False)

        def solve(rhs: FloatArray) -> FloatArray:
            return np.asarray(scipy.linalg.cho_solve(factor, rhs, check_finite=False))
    else:
        sparse_factor = scipy.sparse.linalg.splu(shifted.tocsc())

        def solve(rhs: FloatArray) -> FloatArray:
            return np.asarray(sparse_factor.solve(rhs))

    def nearest(matrix: Matrix) -> Matrix:
        entries = matrix[i, j] * root
        own = matrix[every, every].real
        values = np.concatenate([entries.real, entries.imag, own] if block.is_complex else [entries, own])
        for _ in range(2):
            values = values - equations.T @ solve(equations @ values)
        count = len(i)
        back = values[:count] + 1j * values[count : 2 * count] if block.is_complex else values[:count]
        found = np.zeros((n, n), dtype=block.dtype)
        found[i, j] = back / root
        found[j, i] = found[i, j].conj()
        found[every, every] = values[-n:]
        return found

    def project(matrix: Matrix) -> Matrix:
        return block.reduce(nearest(block.expand(matrix)))

    def expand(matrix: Matrix) -> Matrix:
        return block.expand(matrix)

    return _Reduced(block.free, project, expand, expand)


def reduction(block: Block) -> _Reduced:
    """The cheaper of the two ways to project onto pattern and kernel."""
    absent = missing_edges(block)
    if len(absent) <= max(block.size, 300):
        return _few_missing(block, absent)
    return _whole(block)


class Splitting:
    """One block under way: it can be taken to a coarse gap, left, and taken on from there."""

    def __init__(self, block: Block, most: int = MOST_ITERATIONS) -> None:
        """Starts at the identity.

        Args:
            block: the problem.
            most: iterations after which to give up.
        """
        self._block, self._most = block, most
        self._small: _Reduced | None = None
        self._iteration, self._weight = 0, WEIGHT
        nothing: Matrix = np.zeros((0, 0), dtype=block.dtype)
        self._state, self._best, self._best_dual = nothing, nothing, nothing
        self._best_slowest, self._bound = 0.0, 1.0

    def advance(self, gap: float, watch: Watch) -> BlockSolution:
        """Goes on to a relative gap by Douglas-Rachford splitting.

        Args:
            gap: relative distance of t from its bound at which to stop.
            watch: progress and interruption.

        Returns:
            The best matrix and the best dual found; unfinished when stopped early.
        """
        block = self._block
        if block.free == 0 or len(block.edges) == 0:
            return zero_solution(block)
        if block.complete:
            return solve_complete(block, gap, watch)
        if self._small is None:
            if watch.stop():
                return zero_solution(block, finished=False)
            self._start()
        small = self._small
        if small is None:
            raise RuntimeError("the reduction was just made")
        finished = self._near_enough(gap)
        while self._iteration < self._most and not finished and not watch.stop():
            admissible = small.project(self._state)
            if self._iteration % CHECK_EVERY == 0 or (self._iteration < 20 and self._iteration in (1, 2, 4, 7, 13)):
                self._look(admissible)
                finished = self._near_enough(gap)
                watch.report(Progress(block.name, "splitting", self._iteration + 1, self._best_slowest, self._bound))
            bounded = _bounded(2 * admissible - self._state, self._weight)
            self._state = self._state + bounded - admissible
            self._iteration += 1
        return BlockSolution(small.expand(self._best), small.lift(self._best_dual), self._iteration, finished)

    def _start(self) -> None:
        small = reduction(self._block)
        unit = np.eye(small.size, dtype=self._block.dtype)
        self._small, self._state = small, unit.copy()
        # dual matrices of the size by which the pattern moves the identity balance the two projections
        self._weight = WEIGHT * max(float(np.linalg.norm(unit - small.project(unit))), 1e-3)
        self._best, self._best_dual = np.zeros_like(unit), unit

    def _look(self, admissible: Matrix) -> None:
        """Keeps the admissible matrix and the dual of this iteration if they are the best so far."""
        values = np.linalg.eigvalsh(admissible)
        # where pattern and kernel leave nothing but zero, what is left is rounding
        if values[-1] > NOTHING and values[0] > self._best_slowest * values[-1]:
            # scaled to the norm of the identity that fills up the rest
            self._best, self._best_slowest = admissible / values[-1], float(values[0] / values[-1])
        dual = self._state - admissible
        proven = _bound(dual)
        if proven < self._bound:
            self._best_dual, self._bound = dual, proven

    def _near_enough(self, gap: float) -> bool:
        return self._bound - self._best_slowest <= gap * self._bound or self._bound <= NOTHING


def solve_splitting(block: Block, gap: float, watch: Watch, most: int = MOST_ITERATIONS) -> BlockSolution:
    """Solves one block to a relative gap in one go; see ``Splitting``."""
    return Splitting(block, most).advance(gap, watch)


def _bound(dual: Matrix) -> float:
    values = np.linalg.eigvalsh(dual)
    positive, negative = float(values[values > 0].sum()), float(-values[values < 0].sum())
    return negative / positive if positive > 1e-12 else 1.0


def _bounded(matrix: Matrix, weight: float) -> Matrix:
    """Nearest matrix with t I <= H <= I under a reward of ``weight`` for t.

    The optimal t satisfies sum (t - lambda_i)+ = weight over the eigenvalues below it, or is 1.
    """
    values, vectors = np.linalg.eigh(matrix)
    counts = np.arange(1, len(values) + 1)
    levels = (weight + np.cumsum(values)) / counts
    below = np.flatnonzero(levels > values)
    t = min(1.0, float(levels[below[-1]]) if len(below) else 1.0)
    clipped = np.clip(values, t, 1.0)
    return np.asarray((vectors * clipped) @ vectors.conj().T)
