"""Equal seeds give equal bits, on grids whose coarse images have only a few pixels, too."""

from __future__ import annotations

import numpy as np
import pytest
from fields import blob, smooth_noise

import tnst_mi
from tnst_mi.recipe.recipe import Recipe


@pytest.mark.parametrize("shape", [(16, 24, 16), (8, 12, 8)])
def test_ten_runs_of_a_small_grid_give_the_same_bits(shape: tuple[int, int, int]) -> None:
    """All defaults but the number of iterations; the coarsest octave has 7×4 and 3×2 pixels."""
    lumps = 1 + np.abs(smooth_noise(np.random.default_rng(0), *shape))
    density = np.clip(blob(shape, (shape[2] / 2 - 0.5, shape[1] / 2 - 0.5, shape[0] / 2 - 0.5), 3.0) * lumps, 0, 1)
    recipe = Recipe(style=("spirals",), weights="patterns", iterations=1)
    results = [tnst_mi.stylize(density.astype(np.float32), recipe, progress=False) for _ in range(10)]
    assert np.abs(results[0].densities[0] - density).max() > 1e-3
    assert len({result.densities[0].tobytes() for result in results}) == 1
    assert len({result.run["frames"][0]["loss_after"] for result in results}) == 1
