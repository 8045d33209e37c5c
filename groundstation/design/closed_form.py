"""Complete graphs: the optimum is known, no solver is needed."""

from __future__ import annotations

import numpy as np

from groundstation.design.problem import Block, BlockSolution, Watch


def solve_complete(block: Block, gap: float, watch: Watch | None = None) -> BlockSolution:
    """H = I - N N+: the projector onto the kernel's complement, all of whose eigenvalues are 1.

    Args:
        block: a problem whose graph is complete.
        gap: ignored, the answer is exact.
        watch: ignored, the answer is immediate.

    Returns:
        The optimum; a dual is not needed, t cannot exceed the spectral norm.

    Raises:
        ValueError: the graph is not complete.
    """
    del gap, watch
    if not block.complete:
        raise ValueError(f"block {block.name}: the closed form needs a complete graph")
    # real and imaginary part apart, so that the result is Hermitian to the bit
    real, imaginary = block.kernel.real, block.kernel.imag
    matrix = np.empty((block.size, block.size), dtype=block.dtype)
    if block.is_complex:
        crossed = imaginary @ real.T
        np.negative(real @ real.T + imaginary @ imaginary.T, out=matrix.real)
        np.subtract(crossed.T, crossed, out=matrix.imag)
    else:
        np.negative(real @ real.T, out=matrix)
    matrix[np.diag_indices(block.size)] += 1.0
    dual = np.zeros(matrix.shape, dtype=matrix.dtype)  # not zeros_like, which would touch all of the memory
    return BlockSolution(matrix=matrix, dual=dual, iterations=0, finished=True)
