"""The split problem as a cvxpy model, solved with Clarabel: a second, independent statement of the same problem.

Not loaded unless asked for: the modelling layer alone takes longer to import than most designs to solve. As everywhere,
what the solver says of itself is not believed.
"""

from __future__ import annotations

import warnings

import cvxpy
import numpy as np

from groundstation.design.problem import Block, BlockSolution, Watch, zero_solution
from groundstation.design.sdp import embed, fold, reduced_basis


def solve_cvxpy(block: Block, gap: float, watch: Watch | None = None) -> BlockSolution:
    """Solves one block as a cvxpy model with Clarabel: a second, independent statement of the same problem.

    Args:
        block: the problem; meant for n <= 16.
        gap: relative gap at which the solver may stop.
        watch: only asked before the start.

    Returns:
        The solution as the solver left it; zero and unfinished when the solver gave nothing.
    """
    basis = reduced_basis(block)
    if len(basis) == 0 or block.free == 0:
        return zero_solution(block)
    if watch is not None and watch.stop():
        return zero_solution(block, finished=False)
    real = embed(basis)
    side = real.shape[1]
    y, t = cvxpy.Variable(len(basis)), cvxpy.Variable()
    combined = cvxpy.reshape(real.reshape(len(basis), -1).T @ y, (side, side), order="C")
    # the products are symmetric up to rounding only, which cvxpy has to be told
    symmetric = (combined + combined.T) / 2
    lower, upper = symmetric >> t * np.eye(side), symmetric << np.eye(side)
    problem = cvxpy.Problem(cvxpy.Maximize(t), [lower, upper])
    tolerance = min(1e-8, gap / 10)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # "solution may be inaccurate": the certificate will tell
        try:
            problem.solve(
                solver=cvxpy.CLARABEL, tol_gap_abs=tolerance, tol_gap_rel=tolerance, tol_feas=tolerance, max_threads=1
            )
        except cvxpy.SolverError:
            return zero_solution(block, finished=False)
    if y.value is None or lower.dual_value is None or upper.dual_value is None:
        return zero_solution(block, finished=False)
    return BlockSolution(
        matrix=block.assemble(block.null_space @ y.value),
        dual=block.expand(fold(block, lower.dual_value - upper.dual_value)),
        iterations=int(problem.solver_stats.num_iters or 0),
        finished=problem.status == cvxpy.OPTIMAL,
    )
