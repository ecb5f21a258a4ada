"""Interpolation, its derivative and its transpose."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from tnst_mi.fields.grid import Cells
from tnst_mi.fields.stencil import Trilinear
from tnst_mi.fields.sums import RepeatableSum, largest_magnitude


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
