"""Reference solver: Clarabel on the split problem, through its own interface.

The kernel equations are eliminated first (null-space basis), because redundant equalities make interior-point
solvers fail. What a solver says of itself is not believed: the certificate of the matrix decides.
"""

from __future__ import annotations

import clarabel
import numpy as np
import scipy.sparse

from groundstation.core.types import FloatArray, IntArray
from groundstation.design.problem import Block, BlockSolution, Matrix, Watch, zero_solution


def reduced_basis(block: Block) -> Matrix:
    """Q* H_k Q for a basis H_k of the admissible matrices, shape (dimensions, d, d)."""
    q = block.complement
    basis = np.stack([block.assemble(column) for column in block.null_space.T]) if block.null_space.shape[1] else None
    if basis is None:
        return np.zeros((0, block.free, block.free), dtype=block.dtype)
    return np.asarray(q.conj().T @ basis @ q)


def embed(matrices: Matrix) -> FloatArray:
    """Real symmetric matrices with the spectrum of Hermitian ones (each eigenvalue twice), shape (k, 2d, 2d)."""
    if not np.iscomplexobj(matrices):
        return np.asarray(matrices)
    upper = np.concatenate([matrices.real, -matrices.imag], axis=2)
    lower = np.concatenate([matrices.imag, matrices.real], axis=2)
    return np.concatenate([upper, lower], axis=1)


def fold(block: Block, real: FloatArray) -> Matrix:
    """Adjoint of ``_embed`` up to a factor: the Hermitian matrix that a real dual stands for, shape (d, d)."""
    if not block.is_complex:
        return real
    d = block.free
    return np.asarray(real[:d, :d] + real[d:, d:] + 1j * (real[d:, :d] - real[:d, d:]))


def _triangle(side: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Row and column indices of the upper triangle, column by column, and Clarabel's weights."""
    columns, rows = (index.astype(np.int64) for index in np.tril_indices(side))
    return rows, columns, np.where(rows == columns, 1.0, np.sqrt(2.0))


def solve_clarabel(block: Block, gap: float, watch: Watch | None = None) -> BlockSolution:
    """Solves one block with Clarabel's own interface.

    Args:
        block: the problem; up to n = 16 or so, the cost grows with the sixth power of n.
        gap: relative gap between t and its bound at which the solver may stop.
        watch: only asked before the start; Clarabel cannot be interrupted.

    Returns:
        The solution as the solver left it.
    """
    basis = reduced_basis(block)
    if len(basis) == 0 or block.free == 0:
        return zero_solution(block)
    real = embed(basis)
    side = real.shape[1]
    rows, columns, weights = _triangle(side)
    stacked = (real[:, rows, columns] * weights).T
    unit = np.eye(side)[rows, columns]
    # s1 = sum y_k H_k - t I, s2 = I - sum y_k H_k, both in the cone: A x + s = b
    matrix = np.block([[-stacked, unit[:, None]], [stacked, np.zeros((len(unit), 1))]])
    offset = np.concatenate([np.zeros(len(unit)), unit])
    objective = np.zeros(len(basis) + 1)
    objective[-1] = -1.0
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    tolerance = min(1e-8, gap / 10)
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    if watch is not None and watch.stop():
        return zero_solution(block, finished=False)
    cones = [clarabel.PSDTriangleConeT(side), clarabel.PSDTriangleConeT(side)]
    answer = clarabel.DefaultSolver(
        scipy.sparse.csc_matrix((len(objective), len(objective))),
        objective,
        scipy.sparse.csc_matrix(matrix),
        offset,
        cones,
        settings,
    ).solve()
    solved = str(answer.status) in {"Solved", "AlmostSolved"}
    duals = np.asarray(answer.z).reshape(2, -1)
    square = np.zeros((2, side, side))
    square[:, rows, columns] = duals / weights
    square[:, columns, rows] = duals / weights
    return BlockSolution(
        matrix=block.assemble(block.null_space @ np.asarray(answer.x)[:-1]),
        dual=block.expand(fold(block, square[0] - square[1])),
        iterations=int(answer.iterations),
        finished=solved,
    )
