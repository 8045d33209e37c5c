"""Array types shared by every package.

Holds no behaviour: a shape, a unit and a frame stand in the docstring of whoever takes or returns the array.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
