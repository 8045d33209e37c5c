"""The short ways to say what numpy says: to the bit the same."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.core.quick import any_of, between, every, length, norms, renewed, some, squares
from groundstation.core.types import FloatArray

SHAPES = [(0,), (1,), (8,), (8, 3), (8, 8, 3), (2, 8, 8, 3)]


def _numbers(shape: tuple[int, ...]) -> FloatArray:
    numbers = (
        np.random.default_rng(len(shape)).standard_normal(shape)
        * 10.0 ** np.arange(-3, 4)[np.random.default_rng(1).integers(0, 7, shape)]
    )
    numbers[np.random.default_rng(2).random(shape) < 0.1] = np.nan
    return np.asarray(numbers)


@pytest.mark.parametrize("shape", SHAPES)
def test_masks_are_told_as_numpy_tells_them(shape: tuple[int, ...]) -> None:
    numbers = _numbers(shape)
    for bound in (-np.inf, -1.0, 0.0, np.inf):
        for mask in (numbers > bound, ~(numbers > bound), (numbers > bound).T, (numbers > bound)[::2]):
            assert (some(mask), every(mask)) == (bool(mask.any()), bool(mask.all()))


@pytest.mark.parametrize("shape", SHAPES)
def test_lengths_and_bounds_are_those_of_numpy_to_the_bit(shape: tuple[int, ...]) -> None:
    numbers = _numbers(shape)
    for vectors in (numbers, numbers.T, numbers[::-1]):
        assert norms(vectors).tobytes() == np.linalg.norm(vectors, axis=-1).tobytes()
        assert between(vectors, -1.0, 2.0).tobytes() == np.clip(vectors, -1.0, 2.0).tobytes()
        assert between(vectors, 0.0, np.abs(vectors)).tobytes() == np.clip(vectors, 0.0, np.abs(vectors)).tobytes()
    vector = numbers.ravel()[~np.isnan(numbers.ravel())]
    assert length(vector) == np.linalg.norm(vector)


@pytest.mark.parametrize("new", [(False, False, False), (True, False, True), (True, True, True)])
def test_what_is_new_begins_anew_and_all_else_goes_on(new: tuple[bool, ...]) -> None:
    mask, later = np.array(new)[:, None], np.arange(6.0).reshape(3, 2)
    for first in (0.0, np.full((3, 2), 7.0)):
        assert renewed(any_of(mask), first, later).tolist() == np.where(mask, first, later).tolist()
    assert (any_of(mask) is None) == (not any(new))


@pytest.mark.parametrize("shape", [(0, 3), (1, 3), (8, 3), (5, 2)])
def test_squares_are_those_of_numpy_to_the_bit(shape: tuple[int, ...]) -> None:
    vectors = np.random.default_rng(3).standard_normal(shape) * 1e3
    for of_any_order in (vectors, np.asfortranarray(vectors)):
        assert squares(of_any_order).tobytes() == (vectors**2).sum(axis=-1).tobytes()
