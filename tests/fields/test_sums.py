"""The repeatable scatter-add."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from tnst_mi.fields.sums import RepeatableSum, largest_magnitude


@pytest.mark.parametrize("magnitude", [1e-12, 1.0, 1e9])
def test_repeatable_sum_is_accurate_and_repeatable(magnitude: float) -> None:
    """Against a float64 sum, for a thousand values per slot; the same bits in every run and for every order."""
    rng = np.random.default_rng(2)
    slots, values = 64, (magnitude * rng.standard_normal(64_000)).astype(np.float32)
    index = rng.integers(0, slots, values.size).astype(np.uint32)
    expected = np.bincount(index, values.astype(np.float64), slots)
    results = set()
    for _ in range(5):
        order = rng.permutation(values.size)
        total = RepeatableSum(slots, largest_magnitude(mi.Float(values)), values.size)
        total.add(mi.UInt32(index[order]), mi.Float(values[order]))
        result = total.result().numpy()
        results.add(result.tobytes())
    assert len(results) == 1
    np.testing.assert_allclose(result, expected, rtol=1e-6, atol=2e-6 * magnitude)


@pytest.mark.parametrize("exponent", [0, 20, 31])
def test_repeatable_sum_keeps_small_values_beside_a_large_bound(exponent: int) -> None:
    """The unit is 2^-30 of the bound or finer for 2^31 additions, and finer still for fewer."""
    small = 2.0 ** -(60 - exponent)
    total = RepeatableSum(1, mi.Float(1.0), 2**exponent)
    total.add(mi.UInt32(0, 0, 0), mi.Float(small, small, small))
    assert total.result()[0] == 3 * small


def test_repeatable_sum_of_values_that_cancel_is_zero() -> None:
    total = RepeatableSum(1, mi.Float(3.7), 4)
    total.add(mi.UInt32(0, 0, 0, 0), mi.Float(3.7, 1e-7, -3.7, -1e-7))
    assert total.result()[0] == 0


def test_repeatable_sum_spreads_what_is_not_finite() -> None:
    """An infinite bound must not become a finite, wrong number."""
    total = RepeatableSum(1, mi.Float(dr.inf), 2)
    total.add(mi.UInt32(0), mi.Float(dr.inf))
    assert not np.isfinite(total.result().numpy()).any()
