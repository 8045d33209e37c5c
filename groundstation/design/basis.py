"""Unknowns of the interior-point method: how H depends on them, and the Schur complement that follows.

With NT scaling W = G G* of each cone, the Schur complement is M_kl = <H_k, W1 H_l W1> + <H_k, W2 H_l W2>.

* Dense: a null-space basis, H_k as full matrices. For small teams.
* Rank one: H_k = v_k v_k*, v_k with at most three entries. Then M_kl = |v_k* W v_l|^2, summed over both cones, is
  formed entry by entry. Every triangle of the graph gives one: v on its three agents, orthogonal to 1 and to the
  coordinate, already satisfies the kernel equations. Where triangles do not span all admissible matrices, the
  unknowns are edges (and the diagonal) instead, and the kernel equations remain as constraints.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import scipy.linalg
import scipy.sparse

from groundstation.core.types import FloatArray, IntArray
from groundstation.design.problem import Block, Matrix, hermitian_part

Solve = Callable[[FloatArray, FloatArray], FloatArray]
"""(rhs, constraint rhs) to the solution of the constrained normal equations."""

LocalMatrix = tuple[IntArray, Matrix]
"""Agents, shape (k,), and a Hermitian matrix on them, shape (k, k); zero elsewhere."""

BLOCK = 128
"""Columns of the Schur complement formed at a time."""

DENSE_LIMIT = 250_000
"""Numbers in a dense basis up to which it is used."""


class Basis(Protocol):
    """Unknowns y and the matrices H(y) that they build."""

    @property
    def count(self) -> int:
        """Number of real unknowns."""

    def matrix(self, y: FloatArray) -> Matrix:
        """H(y), shape (n, n)."""

    def reduced(self, y: FloatArray) -> Matrix:
        """Q* H(y) Q, shape (d, d), Hermitian."""

    def inner(self, reduced: Matrix) -> FloatArray:
        """<H_k, Q X Q*> for every k, shape (count,)."""

    def factor(self, scaling: Matrix) -> Solve:
        """Forms and factors the Schur complement for the scalings G, shape (2, d, d)."""

    def drift(self, y: FloatArray) -> FloatArray:
        """Violation of the constraints that rounding left, shape (k,)."""


def dense_pays(block: Block) -> bool:
    """Whether a dense basis is small enough to be the fastest."""
    dimensions = len(block.unknown_edges) - block.size * (3 if block.is_complex else 1)
    return max(dimensions, 1) * block.free**2 * (2 if block.is_complex else 1) <= DENSE_LIMIT


class DenseBasis:
    """An orthonormal basis of all admissible matrices, held as full matrices."""

    def __init__(self, block: Block) -> None:
        self._block = block
        q = block.complement
        n, d = block.size, block.free
        unknowns = block.null_space
        self.count = unknowns.shape[1]
        edges = len(block.edges)
        i, j = block.edges[:, 0], block.edges[:, 1]
        entries = (unknowns[:edges] + 1j * unknowns[edges:] if block.is_complex else unknowns).T
        full = np.zeros((self.count, n, n), dtype=block.dtype)
        full[:, i, j] = entries
        full[:, j, i] = entries.conj()
        every = np.arange(n)
        full[:, every, every] = -full.sum(axis=2).real
        reduced = q.conj().T @ full @ q
        self._stack = np.ascontiguousarray((reduced + np.swapaxes(reduced.conj(), 1, 2)) / 2)
        self._flat = self._stack.reshape(self.count, d * d).view(np.float64)

    def matrix(self, y: FloatArray) -> Matrix:
        """H(y), shape (n, n)."""
        return self._block.assemble(self._block.null_space @ y)

    def reduced(self, y: FloatArray) -> Matrix:
        """Q* H(y) Q, shape (d, d)."""
        d = self._block.free
        return np.asarray((y @ self._flat).view(self._block.dtype).reshape(d, d))

    def inner(self, reduced: Matrix) -> FloatArray:
        """<H_k, Q X Q*> for every k, shape (count,)."""
        return np.asarray(self._flat @ np.ascontiguousarray(reduced).reshape(-1).view(np.float64))

    def factor(self, scaling: Matrix) -> Solve:
        """Factors the Schur complement; it is a Gram matrix of scaled basis matrices."""
        total = np.zeros((self.count, self.count))
        for g in scaling:
            scaled = (g.conj().T @ self._stack @ g).reshape(self.count, -1).view(np.float64)
            total += scaled @ scaled.T
        factor = _cholesky(total)

        def solve(rhs: FloatArray, _: FloatArray) -> FloatArray:
            return _cho_solve(factor, rhs)

        return solve

    def drift(self, y: FloatArray) -> FloatArray:
        """No constraints, no drift."""
        del y
        return np.zeros(0)


def _cholesky(matrix: FloatArray) -> FloatArray:
    """Lower Cholesky factor; overwrites nothing that is seen from outside.

    Raises:
        LinAlgError: not positive definite even after a regularisation at the level of rounding.
    """
    diagonal = matrix.diagonal().copy()
    for boost in (0.0, 1e-14, 1e-12, 1e-10):
        shifted = matrix if boost == 0.0 else matrix + np.diag(boost * diagonal)
        factor, info = scipy.linalg.lapack.dpotrf(shifted, lower=1, clean=0, overwrite_a=0)
        if info == 0:
            return np.asarray(factor)
    raise np.linalg.LinAlgError("Schur complement is not positive definite")


def _cho_solve(factor: FloatArray, rhs: FloatArray) -> FloatArray:
    solution, _ = scipy.linalg.lapack.dpotrs(factor, rhs, lower=1)
    return np.asarray(solution)


class RankOneBasis:
    """H(y) = sum y_k v_k v_k* with sparse v_k, under linear constraints (possibly none).

    Attributes:
        count: number of unknowns, m.
    """

    def __init__(
        self,
        block: Block,
        vectors: scipy.sparse.csr_array,
        constraints: FloatArray,
        extras: tuple[LocalMatrix, ...] = (),
    ) -> None:
        """Takes the vectors as rows.

        Args:
            block: the problem.
            vectors: v_k* as rows, shape (m, n).
            constraints: independent rows C with C y = 0, shape (k, m + e).
            extras: admissible matrices that are not of rank one; their unknowns come last.
        """
        self._extras = extras
        self._block = block
        self._rows = vectors
        self._constraints = constraints
        self._outer = outer_products(vectors)
        self.count = vectors.shape[0] + len(self._extras)

    def matrix(self, y: FloatArray) -> Matrix:
        """H(y), shape (n, n)."""
        ones, n = self._rows.shape[0], self._block.size
        total = np.asarray(self._outer.T @ y[:ones]).reshape(n, n)
        for weight, (agents, part) in zip(y[ones:], self._extras, strict=True):
            total[np.ix_(agents, agents)] += weight * part
        return hermitian_part(total)

    def reduced(self, y: FloatArray) -> Matrix:
        """Q* H(y) Q, shape (d, d)."""
        return self._block.reduce(self.matrix(y))

    def inner(self, reduced: Matrix) -> FloatArray:
        """v_k* Q X Q* v_k for every k, shape (m,)."""
        return self._against(self._block.expand(reduced))

    def _against(self, full: Matrix) -> FloatArray:
        """<H_k, X> for every k and a Hermitian X, shape (n, n)."""
        ones = (self._outer.conj() @ full.ravel()).real
        more = [np.vdot(part, full[np.ix_(agents, agents)]).real for agents, part in self._extras]
        return np.concatenate([ones, np.array(more)])

    def factor(self, scaling: Matrix) -> Solve:
        """Forms M_kl = sum over cones |v_k* G G* v_l|^2 block by block, and factors it."""
        q = self._block.complement
        middles = [np.ascontiguousarray((q @ g) @ (q @ g).conj().T) for g in scaling]
        m = self._rows.shape[0]
        total = np.empty((self.count, self.count), order="F")
        squared_products(self._rows, middles, total)
        for middle in middles if self._extras else []:
            image = np.ascontiguousarray((self._rows @ middle).T)
            for place, extra in enumerate(self._extras):
                row = self._extra_row(place, extra, middle, image)
                if middle is middles[0]:
                    total[m + place, : m + place + 1] = row
                else:
                    total[m + place, : m + place + 1] += row
        return self._solver(total)

    def _extra_row(self, place: int, extra: LocalMatrix, middle: Matrix, image: Matrix) -> FloatArray:
        """<H_k, W E W> for the rank-one unknowns and for the extras up to E itself.

        Args:
            place: number of the extra.
            extra: E.
            middle: W, shape (n, n).
            image: v_k* W as columns, shape (n, m).

        Returns:
            Shape (m + place + 1,).
        """
        agents, part = extra
        if len(agents) == self._block.size:
            return self._against(hermitian_part(middle @ (part @ middle)))[: self._rows.shape[0] + place + 1]
        strip, seen = middle[:, agents], image[agents]
        ones = ((part.T @ seen) * seen.conj()).sum(axis=0).real
        weighted = strip @ part
        more = [
            np.vdot(other, weighted[others] @ strip[others].conj().T).real
            for others, other in self._extras[: place + 1]
        ]
        return np.concatenate([ones, np.array(more)])

    def _solver(self, total: FloatArray) -> Solve:
        c = self._constraints
        if len(c) == 0:
            factor = _cholesky_in_place(total)
            return lambda rhs, _: _cho_solve(factor, rhs)
        # M may be singular across the constraints; adding C'C there does not change the constrained solution
        diagonal = total.diagonal()
        weight = float(np.mean(diagonal)) / float(np.mean(np.sum(c * c, axis=0)))
        lower_product = scipy.linalg.blas.dsyrk(weight, c, beta=1.0, c=total, trans=1, lower=1, overwrite_c=1)
        factor = _cholesky_in_place(lower_product)
        half = scipy.linalg.solve_triangular(factor, c.T, lower=True, check_finite=False)
        schur = _cholesky(half.T @ half)

        def solve(rhs: FloatArray, constraint_rhs: FloatArray) -> FloatArray:
            free = _cho_solve(factor, rhs)
            price = _cho_solve(schur, c @ free - constraint_rhs)
            return free - np.asarray(_cho_solve(factor, c.T @ price))

        return solve

    def drift(self, y: FloatArray) -> FloatArray:
        """C y, shape (k,)."""
        return np.asarray(self._constraints @ y)


def outer_products(rows: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """v_k v_k*, flattened, one row per k, from v_k* as rows; shape (m, n * n)."""
    m, n = rows.shape
    lengths = np.diff(rows.indptr)
    pieces = []
    for length in np.unique(lengths):
        members = np.flatnonzero(lengths == length)
        places = rows.indptr[members][:, None] + np.arange(length)
        agents, values = rows.indices[places].astype(np.int64), rows.data[places]
        entries = values.conj()[:, :, None] * values[:, None, :]
        columns = agents[:, :, None] * n + agents[:, None, :]
        pieces.append((entries.ravel(), np.repeat(members, length * length), columns.ravel()))
    data, row, column = (np.concatenate(part) for part in zip(*pieces, strict=True))
    return scipy.sparse.csr_array((data, (row, column)), shape=(m, n * n))


def _squared(values: Matrix) -> FloatArray:
    """Squared absolute values, without a square root and without copies of the parts."""
    if np.iscomplexobj(values):
        pairs = np.ascontiguousarray(values).view(np.float64).reshape(*values.shape, 2)
        return np.asarray(np.einsum("ijk,ijk->ij", pairs, pairs))
    return np.asarray(values * values)


def squared_products(rows: scipy.sparse.csr_array, middles: list[Matrix] | None, out: FloatArray) -> None:
    """Writes the lower triangle of sum |v_k* W v_l|^2 over the given W, block by block so that it stays in the cache.

    Args:
        rows: v_k* as rows, shape (m, n).
        middles: the Hermitian W, shape (n, n) each; None stands for the identity.
        out: at least (m, m), Fortran order.
    """
    m = rows.shape[0]
    for start in range(0, m, BLOCK):
        stop = min(start + BLOCK, m)
        below, some = rows[start:], rows[start:stop]
        part = np.zeros((m - start, stop - start))
        for middle in middles if middles is not None else [None]:
            half = some.toarray() if middle is None else some @ middle
            values = below @ np.ascontiguousarray(half.conj().T)
            part += _squared(values)
        out[start:m, start:stop] = part


def _cholesky_in_place(matrix: FloatArray) -> FloatArray:
    """Cholesky of a large matrix in its own memory (lower triangle, Fortran order).

    Raises:
        LinAlgError: not positive definite.
    """
    matrix[np.diag_indices(len(matrix))] *= 1.0 + 1e-13
    factor, info = scipy.linalg.lapack.dpotrf(matrix, lower=1, clean=0, overwrite_a=1)
    if info != 0:
        raise np.linalg.LinAlgError("Schur complement is not positive definite")
    return np.asarray(factor)


def edge_basis(block: Block) -> RankOneBasis:
    """Unknowns per edge, (e_i - e_j) and for xy (e_i - i e_j), and per agent e_i; constraints H N = 0."""
    n, edges = block.size, len(block.edges)
    i, j = block.edges[:, 0], block.edges[:, 1]
    rows = np.repeat(np.arange(edges), 2)
    places = np.stack([i, j], axis=1).ravel()
    plain = scipy.sparse.csr_array((np.tile([1.0, -1.0], edges), (rows, places)), shape=(edges, n))
    if block.is_complex:
        # v = e_i - i e_j, and v* as a row
        turned = scipy.sparse.csr_array((np.tile([1.0, 1j], edges), (rows, places)), shape=(edges, n))
        vectors = scipy.sparse.csr_array(scipy.sparse.vstack([plain, turned, scipy.sparse.eye_array(n)]))
    else:
        vectors = plain
    columns = vectors.conj().T.tocsc()
    equations = []
    for direction in block.kernel.T:
        # row k of vectors is v_k*; H_k w = v_k (v_k* w)
        image = (columns @ scipy.sparse.diags_array(vectors @ direction)).toarray()
        equations += [image.real, image.imag] if block.is_complex else [image]
    stacked = np.concatenate(equations)
    # orthonormal rows of the same row space: the equations repeat each other
    values, directions = np.linalg.eigh(stacked @ stacked.T)
    kept = values > 1e-13 * values[-1]
    return RankOneBasis(block, vectors, (directions[:, kept].T @ stacked) / np.sqrt(values[kept])[:, None])
