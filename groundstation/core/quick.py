"""Short ways to say what numpy says with more ado: for teams of a few vehicles the calls cost, not the numbers.

Each gives to the bit what the usual way gives. A tick makes hundreds of such calls.
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.core.types import BoolArray, FloatArray


def some(mask: BoolArray) -> bool:
    """Whether anything in a mask of any shape is true: ``mask.any()``, at a fifth of its cost."""
    return b"\1" in mask.tobytes()


def every(mask: BoolArray) -> bool:
    """Whether all of a mask of any shape is true: ``mask.all()``."""
    return b"\0" not in mask.tobytes()


def norms(vectors: FloatArray) -> FloatArray:
    """Lengths of vectors, shape (..., k) to (...): ``np.linalg.norm(vectors, axis=-1)``."""
    lengths: FloatArray = np.sqrt(np.add.reduce(vectors * vectors, axis=-1))
    return lengths


def between(values: FloatArray, low: FloatArray | float, high: FloatArray | float) -> FloatArray:
    """``np.clip(values, low, high)``; what is not a number stays that."""
    clipped: FloatArray = np.minimum(np.maximum(values, low), high)
    return clipped


def length(vector: FloatArray) -> float:
    """Length of one vector, shape (k,): ``np.linalg.norm(vector)``."""
    return math.sqrt(vector.dot(vector))
