"""The curve of sRGB against what the standard says of it."""

from __future__ import annotations

import numpy as np

from tnst_mi.io.pictures.srgb import linear_of, srgb


def test_values_of_the_standard() -> None:
    assert srgb(np.array([0.0, 1.0])).tolist() == [0.0, 1.0] == linear_of(np.array([0.0, 1.0])).tolist()
    # Middle grey, and the value of 8 bits that has half the light.
    np.testing.assert_allclose(srgb(np.array([0.18, 0.5])), [0.46136, 0.73536], atol=1e-5)
    np.testing.assert_allclose(linear_of(np.array([188 / 255])), [0.50289], atol=1e-5)


def test_one_is_the_inverse_of_the_other_and_both_rise() -> None:
    values = np.linspace(0, 1, 4001).reshape(1, -1, 1).astype(np.float32)
    np.testing.assert_allclose(linear_of(srgb(values)), values, atol=2e-7)
    assert (np.diff(srgb(values).ravel()) > 0).all() and srgb(values).shape == values.shape
