"""Exact index arithmetic, and values through memory."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from tnst_mi.fields.kernels import Divisor, stored


@pytest.mark.parametrize("size", [1, 2, 3, 5, 7, 64, 96, 97, 300, 1000, 65537, 2**20 - 1, 2**29])
def test_division_by_multiplication_is_exact(size: int) -> None:
    """At random indices and on both sides of every kind of multiple, up to the largest index."""
    rng = np.random.default_rng(size)
    multiples = rng.integers(0, 2**30 // size, 2000) * size
    index = np.concatenate([rng.integers(0, 2**30, 4000), multiples, np.maximum(multiples, 1) - 1, [0, 2**30 - 1]])
    quotient, remainder = Divisor(size).split(mi.UInt32(index.astype(np.uint32)))
    np.testing.assert_array_equal(quotient.numpy(), index // size)
    np.testing.assert_array_equal(remainder.numpy(), index % size)


def test_stored_values_are_the_values() -> None:
    values = np.random.default_rng(4).random(1001).astype(np.float32)
    np.testing.assert_array_equal(stored(mi.Float(values) * 2).numpy(), values * 2)
    np.testing.assert_array_equal(stored(mi.Float(values) > 0.5).numpy(), values > 0.5)
    assert dr.width(stored(mi.Float([]))) == 0
