"""The soft mask: range, softness, obstacles."""

from __future__ import annotations

import numpy as np
import pytest

from tnst_mi.mask import SIGMA, soft_mask


def test_mask_is_the_blurred_density_clipped_to_one() -> None:
    density = np.zeros((25, 25, 25), np.float32)
    density[12, 12, 12] = 1000.0
    mask = soft_mask(density)
    assert mask.max() == 1.0 and mask.min() == 0.0
    distance = np.linalg.norm(np.indices(density.shape) - 12, axis=0)
    point_response = 1000 * np.exp(-(distance**2) / (2 * SIGMA**2)) / (2 * np.pi * SIGMA**2) ** 1.5
    near = distance < 4
    np.testing.assert_allclose(mask[near], np.clip(point_response[near], 0, 1), atol=0.01)


def test_density_outside_the_grid_counts_as_zero() -> None:
    mask = soft_mask(np.ones((9, 20, 9), np.float32))
    assert mask[4, 10, 4] == pytest.approx(1, abs=1e-3)
    # The sum of one half of the kernel, the centre included.
    weights = np.exp(-0.5 * (np.arange(-5, 6) / SIGMA) ** 2)
    assert mask[4, 0, 4] == pytest.approx(weights[5:].sum() / weights.sum(), abs=1e-3)


def test_mask_is_zero_inside_an_obstacle() -> None:
    obstacle = np.zeros((8, 8, 8), bool)
    obstacle[2:5, 2:5, 2:5] = True
    mask = soft_mask(np.ones((8, 8, 8), np.float32), obstacle)
    assert (mask[obstacle] == 0).all() and (mask[~obstacle] > 0.1).all()
