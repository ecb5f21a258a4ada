"""Octave sizes, exact index arithmetic, and the repeatable scatter-add."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tnst_mi
from tnst_mi.fields.grid import Cells, Divisor, RepeatableSum, Trilinear, largest_magnitude, octaves, stored


def test_octave_sizes_are_those_of_the_paper() -> None:
    levels = octaves((200, 300, 200), 3)
    assert [level.shape for level in levels] == [(61, 92, 61), (111, 166, 111), (200, 300, 200)]
    assert [level.cell_size for level in levels] == [300 / 92, 300 / 166, 1.0]
    assert [level.shape for level in octaves((192, 256, 192), 3)][:2] == [(58, 78, 58), (106, 142, 106)]
    assert octaves((1, 5, 3), 4)[0].shape == (1, 1, 1)


@pytest.mark.parametrize(("count", "factor"), [(0, 1.8), (2, 1.0)])
def test_bad_octaves_are_named(count: int, factor: float) -> None:
    with pytest.raises(tnst_mi.InputError, match=f"count {count} and factor {factor}"):
        octaves((4, 4, 4), count, factor)


@pytest.mark.parametrize("size", [1, 2, 3, 5, 7, 64, 96, 97, 300, 1000, 65537, 2**20 - 1, 2**29])
def test_division_by_multiplication_is_exact(size: int) -> None:
    """At random indices and on both sides of every kind of multiple, up to the largest index."""
    rng = np.random.default_rng(size)
    multiples = rng.integers(0, 2**30 // size, 2000) * size
    index = np.concatenate([rng.integers(0, 2**30, 4000), multiples, np.maximum(multiples, 1) - 1, [0, 2**30 - 1]])
    quotient, remainder = Divisor(size).split(mi.UInt32(index.astype(np.uint32)))
    np.testing.assert_array_equal(quotient.numpy(), index // size)
    np.testing.assert_array_equal(remainder.numpy(), index % size)


def test_cells_are_enumerated_in_storage_order() -> None:
    shape = (3, 5, 4)
    cells = Cells.of(shape)
    z, y, x = np.unravel_index(np.arange(60), shape)
    for ours, expected in ((cells.x, x), (cells.y, y), (cells.z, z)):
        np.testing.assert_array_equal(ours.numpy(), expected)
    np.testing.assert_array_equal(cells.index(cells.x, cells.y, cells.z).numpy(), np.arange(60))


def test_chosen_cells_and_their_own_values() -> None:
    shape = (3, 5, 4)
    chosen = np.array([0, 7, 31, 59], np.uint32)
    cells = Cells.of(shape, mi.UInt32(chosen))
    for ours, expected in zip((cells.z, cells.y, cells.x), np.unravel_index(chosen, shape), strict=True):
        np.testing.assert_array_equal(ours.numpy(), expected)
    values = np.random.default_rng(3).random((60, 3)).astype(np.float32)
    for c, own in enumerate(cells.own(mi.Float(values.ravel()), 3)):
        np.testing.assert_array_equal(own.numpy(), values[chosen, c])
    (own,) = Cells.of(shape).own(mi.Float(values[:, 0].copy()))
    np.testing.assert_array_equal(own.numpy(), values[:, 0])


def test_stored_values_are_the_values() -> None:
    values = np.random.default_rng(4).random(1001).astype(np.float32)
    np.testing.assert_array_equal(stored(mi.Float(values) * 2).numpy(), values * 2)
    np.testing.assert_array_equal(stored(mi.Float(values) > 0.5).numpy(), values > 0.5)
    assert dr.width(stored(mi.Float([]))) == 0


@pytest.mark.parametrize("outside", ["zero", "edge"])
def test_splat_is_the_transpose_of_interpolation(outside: str) -> None:
    rng = np.random.default_rng(1)
    shape = (4, 6, 5)
    field, weights = (rng.standard_normal(120).astype(np.float32) for _ in range(2))
    stencil = Trilinear(
        Cells.of(shape), mi.Vector3f(*(mi.Float(3 * rng.standard_normal(120)) for _ in range(3))), outside
    )
    value = stencil.value(stencil.read(mi.Float(field), 1))[0]
    total = RepeatableSum(120, largest_magnitude(mi.Float(weights)), 8 * 120)
    stencil.splat(total, [mi.Float(weights)])
    assert np.dot(value.numpy(), weights) == pytest.approx(np.dot(field, total.result().numpy()), rel=1e-5)


def test_interpolation_gradient_is_exact_for_a_linear_field() -> None:
    shape = (5, 6, 7)
    z, y, x = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape), indexing="ij")
    cells = Cells.of(shape)
    stencil = Trilinear(cells, mi.Vector3f(0.25, -0.4, 0.3), "edge")
    gradient = stencil.gradient(stencil.read(mi.Float((2 * x - 3 * y + 0.5 * z).ravel()), 1))[0]
    inner = np.s_[1:-1, 1:-1, 1:-1]
    for component, expected in zip(gradient, (2.0, -3.0, 0.5), strict=True):
        np.testing.assert_allclose(component.numpy().reshape(shape)[inner], expected, atol=1e-5)


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
