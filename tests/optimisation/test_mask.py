"""The soft mask: range, softness, obstacles."""

from __future__ import annotations

import numpy as np
import pytest
from fields import blob

from tnst_mi.optimisation.mask import EDGE_SIGMA, soft_mask


def test_mask_is_the_blurred_density_clipped_to_one() -> None:
    density = np.zeros((25, 25, 25), np.float32)
    density[12, 12, 12] = 1000.0
    mask = soft_mask(density)
    assert mask.max() == 1.0 and mask.min() == 0.0
    distance = np.linalg.norm(np.indices(density.shape) - 12, axis=0)
    point_response = 1000 * np.exp(-(distance**2) / (2 * EDGE_SIGMA**2)) / (2 * np.pi * EDGE_SIGMA**2) ** 1.5
    near = distance < 4
    np.testing.assert_allclose(mask[near], np.clip(point_response[near], 0, 1), atol=0.01)


def test_density_outside_the_grid_counts_as_zero() -> None:
    mask = soft_mask(np.ones((9, 20, 9), np.float32))
    assert mask[4, 10, 4] == pytest.approx(1, abs=1e-3)
    # The sum of one half of the kernel, the centre included.
    weights = np.exp(-0.5 * (np.arange(-5, 6) / EDGE_SIGMA) ** 2)
    assert mask[4, 0, 4] == pytest.approx(weights[5:].sum() / weights.sum(), abs=1e-3)


def test_mask_is_zero_inside_an_obstacle() -> None:
    obstacle = np.zeros((8, 8, 8), bool)
    obstacle[2:5, 2:5, 2:5] = True
    mask = soft_mask(np.ones((8, 8, 8), np.float32), obstacle)
    assert (mask[obstacle] == 0).all() and (mask[~obstacle] > 0.1).all()


def test_strength_is_a_power_of_the_mask() -> None:
    density, obstacle = blob((9, 9, 9), (4, 4, 4), 2.0), np.zeros((9, 9, 9), bool)
    obstacle[4, 4, 4] = True
    once, square, none = (soft_mask(density, obstacle, strength) for strength in (1, 2, 0))
    np.testing.assert_allclose(square, once**2, rtol=1e-5)
    assert (none[~obstacle] == 1).all() and none[4, 4, 4] == 0


def test_a_plane_is_masked_as_smoke_that_goes_on_along_z() -> None:
    """A grid with D = 1 has the mask of the middle of many equal planes."""
    plane = blob((1, 12, 10), (4, 6, 0), 2.0)
    np.testing.assert_allclose(soft_mask(plane)[0], soft_mask(np.repeat(plane, 15, 0))[7], atol=1e-6)
