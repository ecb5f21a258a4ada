"""Resampling between octaves: exactness on polynomials, conservation, alignment."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import torch
from fields import blob, smooth_noise
from hypothesis import given
from hypothesis import strategies as st

from tnst_mi.fields.grid import octaves
from tnst_mi.fields.resampling import (
    cubic_matrix,
    resample_density,
    resample_mask,
    resample_potential,
    resample_velocity,
)

FULL = (40, 64, 48)


def positions(shape: tuple[int, int, int], h: float) -> list[np.ndarray]:
    """Coordinates (x, y, z) of the cell centres, from the centre of the grid."""
    z, y, x = np.meshgrid(*((np.arange(n) - (n - 1) / 2) * h for n in shape), indexing="ij")
    return [x, y, z]


def test_potentials_keep_quadratic_polynomials_up_an_octave() -> None:
    """Catmull–Rom reproduces them away from the border, in physical position: no factor, no shift."""
    coarse, full = octaves(FULL, 2)

    def field(shape: tuple[int, int, int], h: float) -> np.ndarray:
        x, y, z = positions(shape, h)
        return (0.01 * x * x - 0.02 * x * y + 0.1 * z + 3).astype(np.float32)

    result = resample_potential(field(coarse.shape, coarse.cell_size), coarse.cell_size, full.shape, 1.0)
    inner = np.s_[6:-6, 6:-6, 6:-6]
    np.testing.assert_allclose(result[inner], field(FULL, 1.0)[inner], atol=2e-5)


def test_vector_potentials_are_resampled_by_component() -> None:
    coarse, full = octaves(FULL, 2)
    field = smooth_noise(np.random.default_rng(1), *coarse.shape, 3)
    together = resample_potential(field, coarse.cell_size, full.shape, 1.0)
    apart = [resample_potential(field[..., c], coarse.cell_size, full.shape, 1.0) for c in range(3)]
    np.testing.assert_allclose(together, np.stack(apart, -1), atol=1e-6)


def test_cubic_interpolates_the_samples_and_keeps_constants() -> None:
    np.testing.assert_allclose(cubic_matrix(9, 1.0, 9, 1.0), np.eye(9), atol=1e-12)
    np.testing.assert_allclose(cubic_matrix(9, 1.8, 16, 1.0).sum(1), 1, atol=1e-12)


@pytest.mark.parametrize("count", [2, 3])
def test_density_keeps_its_mass_and_its_centre(count: int) -> None:
    coarse = octaves(FULL, count)[0]
    h = coarse.cell_size
    density = blob(FULL, (20.3, 35.1, 17.2), 4.0)
    result = resample_density(density, 1.0, coarse.shape, h).astype(np.float64)
    assert result.sum() * h**3 == pytest.approx(density.sum(), rel=2e-3)
    for coordinate, fine in zip(positions(coarse.shape, h), positions(FULL, 1.0), strict=True):
        centre = (coordinate * result).sum() / result.sum()
        assert centre == pytest.approx((fine * density).sum() / density.sum(), abs=0.02)
    assert result.min() >= 0


def test_density_reads_zero_outside() -> None:
    """A grid full of smoke thins out towards the border, where the coarse cells reach beyond it."""
    coarse = octaves((9, 9, 9), 2)[0]
    result = resample_density(np.ones((9, 9, 9), np.float32), 1.0, coarse.shape, coarse.cell_size)
    assert result[2, 2, 2] == pytest.approx(1, abs=1e-3)
    assert result[0, 0, 0] < 0.95


def test_the_full_octave_is_the_field_itself() -> None:
    field = smooth_noise(np.random.default_rng(2), 5, 6, 7)
    np.testing.assert_array_equal(resample_potential(field, 1.0, (5, 6, 7), 1.0), field)
    np.testing.assert_array_equal(resample_density(np.abs(field), 1.0, (5, 6, 7), 1.0), np.abs(field))


def test_a_plane_of_smoke_keeps_its_brightness_and_its_mask() -> None:
    """D = 1: the integral along z, cell size times density, stays; so does a mask, along which nothing varies."""
    coarse = octaves((1, 64, 48), 3)[0]
    field = np.ones((1, 64, 48), np.float32)
    density, mask = (f(field, 1.0, coarse.shape, coarse.cell_size) for f in (resample_density, resample_mask))
    np.testing.assert_allclose(coarse.cell_size * density, mask, rtol=1e-5)
    assert mask[0, coarse.shape[1] // 2, coarse.shape[2] // 2] == pytest.approx(1, abs=1e-3)


def test_kinds_of_arrays_and_no_derivatives() -> None:
    """Numpy and Dr.Jit alike; derivatives, which it has none of, are refused rather than dropped."""
    coarse = octaves(FULL, 2)[0]
    field = blob(FULL, (20, 30, 20), 5)
    expected = resample_density(field, 1.0, coarse.shape, coarse.cell_size)
    assert isinstance(expected, np.ndarray) and expected.dtype == np.float32 and expected.flags.c_contiguous
    tensor = mi.TensorXf(field)
    found = resample_density(tensor, 1.0, coarse.shape, coarse.cell_size)
    np.testing.assert_array_equal(found.numpy(), expected)
    dr.enable_grad(tensor)
    for attached in (tensor, torch.from_numpy(field).requires_grad_()):
        with pytest.raises(TypeError, match="resample_density is not differentiable: detach its arguments"):
            resample_density(attached, 1.0, coarse.shape, coarse.cell_size)
    plain = resample_density(torch.from_numpy(field), 1.0, coarse.shape, coarse.cell_size)
    np.testing.assert_array_equal(plain.detach().numpy(), expected)


@given(
    st.tuples(*[st.integers(1, 60)] * 3),
    st.integers(1, 4),
    st.tuples(*[st.floats(-9, 9, width=32)] * 3),
)
def test_velocities_of_any_proportions_repeat_the_border(
    shape: tuple[int, int, int], count: int, v: tuple[float, float, float]
) -> None:
    """A uniform one stays what it is, also in cells of a coarse octave that lie outside the full grid."""
    field = np.broadcast_to(np.float32(v), (*shape, 3))
    for octave in octaves(shape, count):
        found = resample_velocity(field, 1.0, octave.shape, octave.cell_size)
        np.testing.assert_allclose(found, np.broadcast_to(np.float32(v), found.shape), rtol=1e-5, atol=1e-30)
