"""Masks on octaves keep fields inside the mask of the full grid; shares of images are sums along rays."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise

import tnst_mi
from tnst_mi.fields.grid import Octave, octaves
from tnst_mi.fields.resampling import resample_potential
from tnst_mi.regions.octave_masks import octave_mask, well_inside
from tnst_mi.regions.seen import seen_shares
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer


@pytest.mark.parametrize("shape", [(20, 31, 26), (1, 40, 27), (33, 24, 50)])
def test_fields_inside_an_octaves_mask_stay_inside_the_full_one(shape: tuple[int, int, int]) -> None:
    """Whatever the fields are, and however the grids of the octaves lie on each other."""
    rng = np.random.default_rng(0)
    mask = np.clip(blob(shape, tuple(n * 0.45 for n in shape[::-1]), 9.0) - 0.3, 0, None)
    levels = octaves(shape, 3)
    for octave in levels:
        coarse = octave_mask(mask, octave)
        assert coarse.shape == octave.shape and coarse.max() > 0
        field = rng.standard_normal(octave.shape).astype(np.float32) * (coarse > 0)
        fine = resample_potential(field, octave.cell_size, shape, 1.0)
        assert (fine[mask == 0] == 0).all() and (fine != 0).any()
    assert octave_mask(mask, levels[-1]) is mask


def test_a_coarse_cell_has_the_least_of_what_it_reaches() -> None:
    """In a mask that rises along x by 0.01 a cell, that is two coarse cells further down."""
    mask = np.broadcast_to(np.arange(40, dtype=np.float32) / 100, (4, 40, 40))
    coarse = octave_mask(mask, Octave((2, 20, 20), 2.0))
    place = (np.arange(20) - 9.5) * 2 + 19.5
    lowest = np.ceil(np.maximum(place - 4 + 1e-6, 0))
    # The first and the last cells are repeated beyond their centres.
    np.testing.assert_allclose(coarse[0, 10, 2:-2], lowest[2:-2] / 100, atol=1e-6)


def test_well_inside_is_soft_and_knows_no_border_of_the_grid() -> None:
    mask = np.zeros((5, 9, 12), np.float32)
    mask[:, :, 4:] = 0.01
    soft = well_inside(mi.TensorXf(mask)).numpy()
    expected = np.array([0, 0, 0, 0, 1 / 3, 2 / 3, 1, 1, 1, 1, 1, 1])
    np.testing.assert_allclose(soft, np.broadcast_to(expected, soft.shape), atol=1e-6)


def smoke(shape: tuple[int, int, int]) -> np.ndarray:
    noise = np.abs(smooth_noise(np.random.default_rng(3), *shape))
    return (blob(shape, tuple(n / 2 for n in shape[::-1]), 3.0) * (0.5 + noise)).astype(np.float32)


def test_shares_are_those_of_the_light_that_arrives() -> None:
    """In the front view, against sums in float64 over the cells behind each pixel."""
    shape, gamma = (9, 12, 10), 0.7
    density = smoke(shape)
    mask = np.random.default_rng(5).random(shape).astype(np.float32)
    renderer = EmissionAbsorptionRenderer(shape, gamma, "exact", 1.0)
    (found,) = seen_shares(mi.TensorXf(density), [mi.TensorXf(mask)], [(0.0, 0.0)], renderer)
    d, m = density[::-1, ::-1].astype(np.float64), mask[::-1, ::-1].astype(np.float64)
    passed = np.exp(-gamma * np.cumsum(d, axis=0))
    light = np.concatenate([np.ones((1, *shape[1:])), passed[:-1]]) - passed
    expected = (light * m).sum(0) / (light.sum(0) + 1e-3)
    np.testing.assert_allclose(found.numpy()[0], expected, atol=2e-5)


def test_shares_of_complements_are_all_of_the_opacity() -> None:
    """In oblique views, of a coarse octave's cells, against the renderer of the images."""
    shape, gamma, h, views = (9, 12, 10), 0.4, 1.8, [(20.0, -10.0), (130.0, 40.0)]
    density = smoke(shape)
    mask = blob(shape, (3, 5, 4), 2.0)
    renderer = EmissionAbsorptionRenderer(shape, gamma, "exact", h)
    parts = [mi.TensorXf(m) for m in (mask, 1 - mask)]
    first, second = (share.numpy() for share in seen_shares(mi.TensorXf(density), parts, views, renderer))
    opacity = tnst_mi.render(density, views, gamma, "transmittance", h)
    np.testing.assert_allclose(first + second, opacity / (opacity + 1e-3), atol=1e-4)
    assert first.max() > 0.3 and second.max() > 0.3
