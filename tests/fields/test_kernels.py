"""Exact index arithmetic, and values through memory."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tnst_mi
from tnst_mi.fields import kernels
from tnst_mi.fields.kernels import Divisor, stored
from tnst_mi.fields.pyramid import gaussian, normalise
from tnst_mi.optimisation.parameterisation import times


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


LIMITED: dict[str, Callable[[np.ndarray], object]] = {
    "velocity": lambda d: tnst_mi.velocity(d, None, 1.0),
    "advect": lambda d: tnst_mi.advect(d, np.zeros((*d.shape, 3), np.float32)),
    "render": tnst_mi.render,
    "views": lambda d: tnst_mi.render(d[:1], [(0, 0)] * 40),
    "gaussian": lambda d: gaussian(mi.TensorXf(d), 1.0),
    "normalise": lambda d: normalise(mi.TensorXf(d), 1),
    "times": lambda d: times(mi.TensorXf(d[:4]), mi.TensorXf(np.zeros((4, 6, 5, 3), np.float32))),
    "stylize": lambda d: tnst_mi.stylize(d, {"style": ["net"], "weights": "patterns"}, progress=False),
}


@pytest.mark.parametrize("name", LIMITED)
def test_arrays_that_indices_cannot_reach_are_refused(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a limit that a small grid reaches, in place of 2^30."""
    density = np.ones((12, 6, 5), np.float32)
    monkeypatch.setattr(kernels, "LARGEST_COUNT", 360)
    with pytest.raises(tnst_mi.InputError, match=r" of \d+ values, expected fewer than 360: resample"):
        LIMITED[name](density)


def test_samples_of_rays_that_indices_cannot_reach_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    leaf = mi.TensorXf(np.ones((4, 6, 5), np.float32))
    dr.enable_grad(leaf)
    image = tnst_mi.render(leaf, (20, 10))
    monkeypatch.setattr(kernels, "LARGEST_COUNT", 200)
    with pytest.raises(tnst_mi.InputError, match="the samples of the rays: an array of 330 values"):
        dr.backward(dr.sum(image, axis=None))
