"""The 3n x 3n matrix of (7) and its modes, from the two blocks that are designed and stored."""

from __future__ import annotations

import numpy as np

from groundstation.core.formation import Gains
from groundstation.core.types import FloatArray


def aggregate(gains: Gains) -> FloatArray:
    """The matrix A of (7), built from the blocks of (3).

    Args:
        gains: the two blocks, shape (n, n) each.

    Returns:
        Shape (3n, 3n), acting on [x1, y1, z1, x2, ...].
    """
    n = len(gains.z)
    blocks = np.zeros((n, 3, n, 3))
    xy = gains.xy
    blocks[:, 0, :, 0] = blocks[:, 1, :, 1] = xy.real
    blocks[:, 1, :, 0] = xy.imag
    blocks[:, 0, :, 1] = -xy.imag
    blocks[:, 2, :, 2] = gains.z
    return blocks.reshape(3 * n, 3 * n)


def damped_modes(gains: Gains) -> tuple[FloatArray, FloatArray]:
    """Modes of A that are no formation.

    Args:
        gains: certified gains.

    Returns:
        Orthonormal directions, shape (3n, k), and their rates, negative, 1/s, shape (k,).
    """
    rates, directions = np.linalg.eigh(aggregate(gains))
    damped = rates < -1e-8 * max(float(np.max(np.abs(rates), initial=0.0)), 1e-300)
    return np.asarray(directions[:, damped]), np.asarray(rates[damped])
