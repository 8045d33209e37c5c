"""The gain design problem of Section IV, split into its two independent blocks.

A' = -A of (7) decouples: one complex Hermitian block for x + iy and one real symmetric block for z. This module says
what each block is: its kernel, the complement of that kernel and the pattern of its sensing graph. It solves nothing.

Everything here is rank-aware: a formation whose heights are all equal has no z direction in the kernel, one on a
vertical line has no horizontal direction, and so on. A matrix design that ignored this would miss an eigenvalue.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any, Literal

import numpy as np
import scipy.linalg
import scipy.sparse
from numpy.typing import NDArray

from groundstation.core.formation import Formation
from groundstation.core.types import BoolArray, FloatArray, IntArray

BlockName = Literal["xy", "z"]
Matrix = NDArray[Any]
"""complex128 for the block xy, float64 for z."""

SPECTRAL_NORM = 10.0
"""Fastest mode of every design, 1/s: (11) leaves the scale open, this is the authors' value."""

FLAT_TOLERANCE = 1e-10
"""Spread of one coordinate, relative to the formation's size, below which all agents count as equal in it."""

CONSTRAINT_TOLERANCE = 1e-11
"""Relative singular value below which a kernel equation counts as a repetition of the others."""


@dataclass(frozen=True)
class Block:
    """One of the two semidefinite problems.

    Over Hermitian matrices H with zeros where the graph has no edge and with the given kernel, maximise t subject to
    t I <= Q* H Q <= I. The spectral norm that (11) leaves open is 1 here; the certificate scales it.

    Attributes:
        name: ``xy`` (complex) or ``z`` (real).
        coordinate: p = x + iy or z, centred and divided by the size of the formation, shape (n,).
        kernel: orthonormal basis of span{1, coordinate}, shape (n, r), r = 1 when all agents agree in the coordinate.
        edges: pairs i < j, shape (m, 2), counted from 0.
        adjacency: shape (n, n).
        heights: of the agents, in the same unit as the coordinate, shape (n,); None where nobody asks.
    """

    name: BlockName
    coordinate: Matrix
    kernel: Matrix
    edges: IntArray
    adjacency: BoolArray
    heights: FloatArray | None = None

    @property
    def size(self) -> int:
        """Number of agents, n."""
        return len(self.coordinate)

    @property
    def free(self) -> int:
        """Number of eigenvalues to place, d = n - r."""
        return self.size - int(self.kernel.shape[1])

    @cached_property
    def complement(self) -> Matrix:
        """Q, orthonormal basis of the kernel's complement, shape (n, d)."""
        orthogonal, _ = scipy.linalg.qr(self.kernel, mode="full", check_finite=False)
        return np.ascontiguousarray(orthogonal[:, self.kernel.shape[1] :])

    @cached_property
    def outside(self) -> BoolArray:
        """True for pairs that are no edge, False on edges and diagonal, shape (n, n)."""
        return np.asarray(~(self.adjacency | np.eye(self.size, dtype=np.bool_)))

    @property
    def is_complex(self) -> bool:
        """Whether edges carry a rotation as well as a gain."""
        return self.name == "xy"

    @property
    def dtype(self) -> type[np.complex128] | type[np.float64]:
        """Element type of the block's matrices."""
        return np.complex128 if self.is_complex else np.float64

    @property
    def complete(self) -> bool:
        """Whether every pair of agents is an edge."""
        return 2 * len(self.edges) == self.size * (self.size - 1)

    @cached_property
    def unknown_edges(self) -> IntArray:
        """Indices into ``edges``, one per real unknown: for xy every edge twice (a, then b), shape (u,)."""
        every = np.arange(len(self.edges), dtype=np.int64)
        return np.concatenate([every, every]) if self.is_complex else every

    @cached_property
    def _equation_entries(self) -> tuple[IntArray, IntArray, FloatArray, int]:
        """Rows, columns and values of ``equations``, and the number of rows."""
        n, count = self.size, len(self.edges)
        i, j = self.edges[:, 0], self.edges[:, 1]
        step = self.coordinate[j] - self.coordinate[i]
        a, b = np.arange(count), np.arange(count) + count
        spread = self.kernel.shape[1] == 2
        if not self.is_complex:
            if not spread:
                return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0), 0
            return np.concatenate([i, j]), np.concatenate([a, a]), np.concatenate([step, -step]), n
        one, x, y = np.ones(count), step.real, step.imag
        rows, columns, values = [i, j], [b, b], [one, -one]
        if spread:
            rows += [i + n, j + n] * 2 + [i + 2 * n, j + 2 * n] * 2
            columns += [a, a, b, b] * 2
            values += [x, -x, -y, -y, y, -y, x, x]
        return np.concatenate(rows), np.concatenate(columns), np.concatenate(values), 3 * n if spread else n

    @cached_property
    def equations(self) -> scipy.sparse.csr_array:
        """Real linear equations that say H N = 0, one column per unknown, sparse, shape (k, u).

        With H_ij = a + ib for i < j, its conjugate below and minus the row sums on the diagonal, the row sums vanish by
        construction; what remains is that the diagonal is real and that sum_j H_ij (p_j - p_i) = 0.
        """
        rows, columns, values, count = self._equation_entries
        return scipy.sparse.csr_array((values, (rows, columns)), shape=(count, len(self.unknown_edges)))

    @cached_property
    def null_space(self) -> FloatArray:
        """Orthonormal basis of the unknowns that satisfy ``equations``, shape (u, dimensions)."""
        places, columns, entries, count = self._equation_entries
        if count == 0 or len(self.unknown_edges) == 0:
            return np.eye(len(self.unknown_edges))
        dense = np.zeros((count, len(self.unknown_edges)))
        dense[places, columns] = entries  # no two entries share a place
        _, values, rows = np.linalg.svd(dense, full_matrices=True)
        rank = int(np.sum(values > CONSTRAINT_TOLERANCE * max(values[0], 1e-300)))
        return np.ascontiguousarray(rows[rank:].T)

    def assemble(self, unknowns: FloatArray) -> Matrix:
        """Builds H from one number (z) or two (xy) per edge; the diagonal holds the negative row sums.

        Args:
            unknowns: shape (u,), as in ``unknown_edges``.

        Returns:
            Hermitian, shape (n, n).
        """
        count = len(self.edges)
        matrix = np.zeros((self.size, self.size), dtype=self.dtype)
        i, j = self.edges[:, 0], self.edges[:, 1]
        entries = unknowns[:count] + 1j * unknowns[count:] if self.is_complex else unknowns
        matrix[i, j] = entries
        matrix[j, i] = np.conj(entries)
        matrix[np.diag_indices(self.size)] = -matrix.sum(axis=1).real
        return matrix

    def reduce(self, matrix: Matrix) -> Matrix:
        """Q* H Q, made exactly Hermitian, shape (d, d)."""
        return hermitian_part(self.complement.conj().T @ matrix @ self.complement)

    def expand(self, reduced: Matrix) -> Matrix:
        """Q X Q*, shape (n, n)."""
        return hermitian_part(self.complement @ reduced @ self.complement.conj().T)


def hermitian_part(matrix: Matrix) -> Matrix:
    """(H + H*) / 2."""
    return np.asarray((matrix + matrix.conj().T) / 2)


def split(formation: Formation) -> tuple[Block, Block]:
    """Splits a formation's design problem into its horizontal and vertical blocks.

    Args:
        formation: any number of agents, any graph.

    Returns:
        The blocks xy and z.
    """
    points = formation.points_enu_m
    centred = points - points.mean(axis=0)
    extent = float(np.max(np.abs(centred))) if len(points) > 1 else 0.0
    # coordinates far from the origin carry that much rounding, whatever the formation's own size
    noise = 1e-15 * float(np.max(np.abs(points)))
    size = extent if extent > noise else 1.0
    edges, adjacency = graph_of(formation)
    horizontal = (centred[:, 0] + 1j * centred[:, 1]) / size
    vertical = centred[:, 2] / size
    floor = max(FLAT_TOLERANCE, noise / size)
    return (
        replace(_block("xy", horizontal, edges, adjacency, floor), heights=vertical),
        _block("z", vertical, edges, adjacency, floor),
    )


def graph_of(formation: Formation) -> tuple[IntArray, BoolArray]:
    """Edges, shape (m, 2), and adjacency, shape (n, n), without a walk over half a million tuples where complete."""
    n = formation.size
    if 2 * len(formation.edges) == n * (n - 1):
        # edges of a Formation are valid, sorted and unique: these are all there are
        return np.stack(np.triu_indices(n, 1), axis=1).astype(np.int64), ~np.eye(n, dtype=np.bool_)
    edges = np.fromiter(chain.from_iterable(formation.edges), dtype=np.int64).reshape(-1, 2)
    adjacency = np.zeros((n, n), dtype=np.bool_)
    adjacency[edges[:, 0], edges[:, 1]] = adjacency[edges[:, 1], edges[:, 0]] = True
    return edges, adjacency


def _block(name: BlockName, coordinate: Matrix, edges: IntArray, adjacency: BoolArray, floor: float) -> Block:
    n = len(coordinate)
    columns = [np.ones(n, dtype=coordinate.dtype)]
    if n > 1 and float(np.max(np.abs(coordinate))) > floor:
        columns.append(coordinate / np.max(np.abs(coordinate)))
    kernel, _ = np.linalg.qr(np.stack(columns, axis=1))
    return Block(
        name=name,
        coordinate=coordinate,
        kernel=np.ascontiguousarray(kernel),
        edges=edges,
        adjacency=adjacency,
    )


def pattern_equations(block: Block) -> scipy.sparse.csr_array:
    """H N = 0 in orthonormal coordinates of the pattern: sqrt 2 Re H_ij, sqrt 2 Im H_ij (xy only), and the diagonal.

    Returns:
        For each column of the kernel n rows of real parts, for xy n more of imaginary parts.
    """
    n = block.size
    i, j = block.edges[:, 0], block.edges[:, 1]
    edge, every = np.arange(len(i)), np.arange(n)
    stack: list[scipy.sparse.csr_array] = []
    for direction in block.kernel.T:
        rows, columns = np.concatenate([i, j]), np.concatenate([edge, edge])
        seen = np.concatenate([direction[j], direction[i]]) / np.sqrt(2.0)
        parts = [scipy.sparse.csr_array((seen, (rows, columns)), (n, len(i)))]
        if block.is_complex:
            turned = np.concatenate([1j * direction[j], -1j * direction[i]]) / np.sqrt(2.0)
            parts.append(scipy.sparse.csr_array((turned, (rows, columns)), (n, len(i))))
        parts.append(scipy.sparse.csr_array((direction, (every, every)), (n, n)))
        full = scipy.sparse.csr_array(scipy.sparse.hstack(parts))
        stack += [full.real, full.imag] if block.is_complex else [full]
    return scipy.sparse.csr_array(scipy.sparse.vstack(stack))


@dataclass(frozen=True)
class Progress:
    """Where a running method stands; eigenvalues relative to the spectral norm.

    Attributes:
        block: which of the two problems.
        method: name of the method.
        iteration: counted from 1.
        slowest: t of the best matrix so far, negative while there is none.
        bound: no matrix can be better than this.
    """

    block: BlockName
    method: str
    iteration: int
    slowest: float
    bound: float


@dataclass(frozen=True)
class Watch:
    """What a method asks of its caller while it runs. Clocks and keyboards stay outside.

    Attributes:
        stop: asked once an iteration; True ends the method with its best matrix so far.
        report: told once an iteration.
    """

    stop: Callable[[], bool] = lambda: False
    report: Callable[[Progress], None] = lambda _: None


@dataclass(frozen=True)
class BlockSolution:
    """What a method claims; only ``certify`` says what is true of it.

    Attributes:
        matrix: H, shape (n, n), spectral norm about 1.
        dual: D = Q (X1 - X2) Q* from the dual problem, about orthogonal to all admissible H, shape (n, n).
        iterations: how many it took.
        finished: False when it was stopped or gave up before reaching its gap.
    """

    matrix: Matrix
    dual: Matrix
    iterations: int
    finished: bool


def zero_solution(block: Block, *, finished: bool = True) -> BlockSolution:
    """The zero matrix: the only admissible one when the graph leaves no freedom, with the identity as its dual."""
    return BlockSolution(
        matrix=np.zeros((block.size, block.size), dtype=block.dtype),
        dual=block.expand(np.eye(block.free, dtype=block.dtype)),
        iterations=0,
        finished=finished,
    )
