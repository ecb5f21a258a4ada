"""The Laplacian pyramid, the Gaussian, and what normalisation promises."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest
from fields import smooth_noise

from tnst_mi.fields.pyramid import expand, gaussian, merge, normalise, reduce, root_mean_square, split

SHAPES = [(13, 20, 17), (16, 24, 8, 3), (1, 9, 8), (2, 1, 3), (5, 5, 5, 3)]


def oracle_reduce(field: np.ndarray) -> np.ndarray:
    """[1, 4, 6, 4, 1]/16 with replicated edges, then every second cell, axis by axis."""
    for axis in range(3):
        padded = np.pad(field, [(2, 2) if a == axis else (0, 0) for a in range(field.ndim)], mode="edge")
        n = field.shape[axis]
        blurred = sum(w * np.take(padded, np.arange(n) + k, axis) for k, w in enumerate((1, 4, 6, 4, 1))) / 16
        field = np.take(blurred, np.arange(0, n, 2), axis)
    return field


@pytest.mark.parametrize("shape", SHAPES)
def test_split_and_merge_reconstruct_exactly(shape: tuple[int, ...]) -> None:
    field = np.random.default_rng(1).standard_normal(shape).astype(np.float32)
    bands = split(mi.TensorXf(field), 3)
    assert len(bands) == 4
    np.testing.assert_allclose(merge(bands).numpy(), field, atol=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_reduce_against_numpy(shape: tuple[int, ...]) -> None:
    field = np.random.default_rng(2).standard_normal(shape).astype(np.float32)
    result = reduce(mi.TensorXf(field))
    assert result.shape[:3] == tuple(math.ceil(n / 2) for n in shape[:3])
    np.testing.assert_allclose(result.numpy(), oracle_reduce(field), atol=1e-6)


def test_expand_is_the_transpose_of_reduce_times_eight() -> None:
    """Away from the border: the kernel's gain is 1 on the way up and down."""
    rng = np.random.default_rng(3)
    fine, coarse = np.zeros((24, 24, 24), np.float32), np.zeros((12, 12, 12), np.float32)
    fine[6:18, 6:18, 6:18] = rng.standard_normal((12, 12, 12))
    coarse[3:9, 3:9, 3:9] = rng.standard_normal((6, 6, 6))
    left = (reduce(mi.TensorXf(fine)).numpy() * coarse).sum()
    right = (fine * expand(mi.TensorXf(coarse), fine.shape).numpy()).sum() / 8
    assert left == pytest.approx(right, rel=1e-5)


def test_constants_pass_unchanged_and_leave_the_bands_empty() -> None:
    bands = split(mi.TensorXf(np.full((13, 9, 6), 2.5, np.float32)), 3)
    assert all(np.abs(band.numpy()).max() < 1e-6 for band in bands[:-1])
    np.testing.assert_allclose(bands[-1].numpy(), 2.5, rtol=1e-6)


def test_normalised_bands_have_unit_mean_square() -> None:
    """A field of one band comes back with RMS 1, whatever its magnitude; the scale of the input does not matter."""
    field = smooth_noise(np.random.default_rng(4), 32, 32, 32)
    whole = normalise(mi.TensorXf(field), 0)
    assert root_mean_square(whole)[0] == pytest.approx(1, rel=1e-5)
    small, large = (normalise(mi.TensorXf(s * field), 3).numpy() for s in (1e-4, 1e4))
    np.testing.assert_allclose(small, large, rtol=1e-3, atol=1e-4)
    for band in split(mi.TensorXf(field), 3):
        merged = normalise(band, 0)
        assert root_mean_square(merged)[0] == pytest.approx(1, rel=1e-5)


@pytest.mark.parametrize("levels", [0, 1, 3])
def test_normalising_is_what_its_docstring_says(levels: int) -> None:
    field = mi.TensorXf(np.random.default_rng(6).standard_normal((13, 9, 6, 3)).astype(np.float32))
    bands = split(field, levels)
    bands = [mi.TensorXf(band.array / root_mean_square(band), band.shape) for band in bands]
    np.testing.assert_allclose(normalise(field, levels).numpy(), merge(bands).numpy(), rtol=1e-5, atol=1e-5)


def test_one_number_normalises_all_components_of_a_vector_field() -> None:
    """Ratios between components survive, which separate numbers would level."""
    field = smooth_noise(np.random.default_rng(5), 16, 16, 16)
    vector = np.stack([field, 10 * field, -field], -1)
    result = normalise(mi.TensorXf(vector), 3).numpy()
    np.testing.assert_allclose(result[..., 1], 10 * result[..., 0], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(result[..., 2], -result[..., 0], rtol=1e-3, atol=1e-4)


def test_empty_gradient_stays_empty() -> None:
    assert not normalise(mi.TensorXf(np.zeros((8, 8, 8), np.float32))).numpy().any()


def test_gaussian_against_numpy_for_every_component() -> None:
    rng = np.random.default_rng(6)
    field, sigma = rng.standard_normal((9, 12, 10, 3)).astype(np.float32), 1.2
    radius = math.floor(4 * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    expected = field.astype(np.float64)
    for axis in range(3):
        padded = np.pad(expected, [(radius, radius) if a == axis else (0, 0) for a in range(4)], mode="symmetric")
        n = field.shape[axis]
        taps = enumerate(weights / weights.sum())
        expected = sum(w * np.take(padded, np.arange(n) + k, axis) for k, w in taps)
    np.testing.assert_allclose(gaussian(mi.TensorXf(field), sigma).numpy(), expected, atol=1e-6)
    assert gaussian(mi.TensorXf(field), 0).numpy() is not None


@pytest.mark.parametrize(("boundary", "mode"), [("reflect", "symmetric"), ("nearest", "edge"), ("zero", "constant")])
@pytest.mark.parametrize("shape", [(1, 2, 3), (9, 4, 17), (2, 8, 1, 3)])
def test_gaussian_at_the_borders_of_narrow_grids(boundary: str, mode: str, shape: tuple[int, ...]) -> None:
    """Axes shorter than the kernel are reflected several times; lengths on both sides of a thread's run."""
    field, sigma = np.random.default_rng(7).standard_normal(shape).astype(np.float32), 1.2
    radius = math.floor(4 * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    expected = field.astype(np.float64)
    for axis in range(3):
        padded = np.pad(expected, [(radius, radius) if a == axis else (0, 0) for a in range(len(shape))], mode=mode)
        taps = enumerate(weights / weights.sum())
        expected = sum(w * np.take(padded, np.arange(shape[axis]) + k, axis) for k, w in taps)
    np.testing.assert_allclose(gaussian(mi.TensorXf(field), sigma, boundary).numpy(), expected, atol=1e-6)
