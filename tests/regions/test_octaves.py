"""Masks on octaves are means, and fields end at the masks of the full grid; shares of images are sums along rays."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest
import torch
from fields import blob, smooth_noise

import tnst_mi
from tnst_mi.fields.grid import Octave, octaves
from tnst_mi.fields.potentials import velocity
from tnst_mi.fields.resampling import resample_potential
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.regions.octave_masks import RegionBorder, border_of, distance_within, octave_mask
from tnst_mi.regions.seen import seen_in_views
from tnst_mi.regions.shapes import shape_mask
from tnst_mi.rendering.levels import levels_of
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer


def sphere(rows: int, radius: float, edge: float) -> np.ndarray:
    """In the middle of a grid (·, rows, ·); lengths in cells."""
    shape = (rows // 3, rows, rows // 3)
    centre = [(n - 1) / 2 for n in reversed(shape)]
    return shape_mask("sphere", {"centre": centre, "radius": radius, "edge": edge}, shape, None)


@pytest.mark.parametrize("edge", [0.0, 0.02])
def test_a_small_region_is_as_much_of_octaves_coarser_than_the_frame(edge: float) -> None:
    """A sphere of a twentieth of the height: its share in the finest octave, of 96 rows each, is that of 96 rows."""
    shares = []
    for rows in (96, 128, 200):
        radius, shape = 0.05 * rows, (rows // 3, rows, rows // 3)
        mask, octave = sphere(rows, radius, edge * rows), levels_of(Recipe(), shape)[-1]
        assert octave.shape[1] == 96
        found = octave_mask(mask, border_of([mask], octave), octave).numpy()
        shares.append(found.sum() * octave.cell_size**3 / mask.sum())
        if edge:
            assert shares[-1] == pytest.approx(1, abs=0.03)
        else:
            # It fades over two cells of the octave, which end where the centres of cells outside are: up to half
            # a cell of the frame beyond the surface, which is up to 0.03 of this share.
            r = (np.arange(1000) + 0.5) * radius / 1000
            fade = np.minimum(1, (radius + 0.5 - r) / (2 * octave.cell_size))
            assert shares[-1] == pytest.approx((fade * r**2).sum() / (r**2).sum(), abs=0.03)
    assert min(shares) > 0.8 * max(shares)


@pytest.mark.parametrize("radius", [1, 3, 5, 7])
def test_no_region_is_too_small_for_the_finest_octave(radius: int) -> None:
    """Of 200 rows, whose octaves have cells of two: even one of a few cells is there, and where it was."""
    mask, octave = sphere(200, radius, 0), levels_of(Recipe(), (66, 200, 66))[-1]
    found = octave_mask(mask, border_of([mask], octave), octave).numpy()
    assert found.max() > 0.02
    for axis, n in enumerate(found.shape):
        others = tuple({0, 1, 2} - {axis})
        assert (found.sum(others) * np.arange(n)).sum() / found.sum() == pytest.approx((n - 1) / 2, abs=0.3)


@pytest.mark.parametrize("shape", [(20, 31, 26), (1, 40, 27), (33, 24, 50)])
def test_fields_of_an_octave_end_where_the_masks_do(shape: tuple[int, int, int]) -> None:
    """Whatever the fields are, and however the grids of the octaves lie on each other."""
    rng = np.random.default_rng(0)
    mask = np.clip(blob(shape, tuple(n * 0.45 for n in shape[::-1]), 9.0) - 0.3, 0, None)
    for octave in [*octaves(shape, 3), levels_of(Recipe(motif_size=1.4), shape)[-1]]:
        border = RegionBorder([np.zeros_like(mask), mask], octave)
        field = rng.standard_normal(octave.shape).astype(np.float32) * border.fade().numpy()
        fine = resample_potential(field, octave.cell_size, shape, 1.0) * border.restored().numpy()
        assert (fine[mask == 0] == 0).all() and (fine != 0).any()
        assert (octave_mask(mask, border, octave).numpy() <= border.fade().numpy() + 1e-6).all()
    full = RegionBorder([mask], octaves(shape, 1)[0])
    # A number over itself is 1 up to rounding on a GPU.
    np.testing.assert_allclose(full.restored().numpy(), mask > 0, rtol=1e-7, atol=0)


@pytest.mark.parametrize("h", [1.0, 1.5, 2.0, 3.7])
def test_no_velocity_at_a_hard_border_is_faster_than_that_of_a_ramp_of_two_cells(h: float) -> None:
    """Of a potential that is 1 within an octave, faded, interpolated and ended at a plane: 1 / 2h, and 0 beyond it."""
    shape, rows = (3, 80, 80), round(80 / h)
    octave = Octave((3, rows, rows), 80 / rows)
    mask = np.broadcast_to(np.arange(80, dtype=np.float32) >= 37, shape)
    border = RegionBorder([mask], octave)
    fine = resample_potential(border.fade().numpy(), octave.cell_size, shape, 1.0) * border.restored().numpy()
    v = np.abs(velocity(fine, None, 1.0)[..., 0])
    assert 0.9 * 0.5 / octave.cell_size < v.max() < 1.1 * 0.5 / octave.cell_size
    assert (v[..., :36] == 0).all()
    np.testing.assert_allclose(fine[..., 37 + math.ceil(4 * octave.cell_size) :], 1, atol=1e-3)


def test_distances_are_those_to_the_nearest_cell_outside() -> None:
    """Of all pairs of cells; the border of the grid is not outside, and an axis of one cell has no other."""
    rng = np.random.default_rng(1)
    for shape in ((5, 9, 8), (1, 12, 7)):
        inside = rng.random(shape) < 0.97
        cells = np.argwhere(np.ones(shape)).astype(np.float64)
        apart = np.linalg.norm(cells[:, None] - np.argwhere(~inside)[None], axis=-1).min(axis=1).reshape(shape)
        for most in (1.0, 2.4, 4.0):
            found = distance_within(torch.as_tensor(inside), most).numpy()
            np.testing.assert_allclose(found, np.minimum(apart, most), atol=1e-6)


def test_there_is_no_border_where_a_target_is_everywhere() -> None:
    """Its mask alone then is a mean, without a fade."""
    mask, octave = sphere(40, 6, 0), Octave((7, 20, 7), 2.0)
    assert border_of([], octave) is None and border_of([mask, None], octave) is None
    assert octave_mask(np.ones_like(mask), None, octave).numpy() == pytest.approx(1)
    assert octave_mask(mask, None, octave).numpy().max() == pytest.approx(1, abs=0.02)


def smoke(shape: tuple[int, int, int]) -> np.ndarray:
    noise = np.abs(smooth_noise(np.random.default_rng(3), *shape))
    return (blob(shape, tuple(n / 2 for n in shape[::-1]), 3.0) * (0.5 + noise)).astype(np.float32)


def test_shares_are_those_of_the_light_that_arrives() -> None:
    """In the front view, against sums in float64 over the cells behind each pixel."""
    shape, gamma = (9, 12, 10), 0.7
    density = smoke(shape)
    mask = np.random.default_rng(5).random(shape).astype(np.float32)
    renderer = EmissionAbsorptionRenderer(shape, gamma, "exact", 1.0)
    (found,) = seen_in_views(mi.TensorXf(density), [mi.TensorXf(mask)], [(0.0, 0.0)], renderer).shares
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
    seen = seen_in_views(mi.TensorXf(density), parts, views, renderer)
    first, second = (share.numpy() for share in seen.shares)
    opacity = tnst_mi.render(density, views, gamma, "transmittance", h)
    np.testing.assert_allclose(seen.opacity.numpy(), opacity, atol=1e-6)
    np.testing.assert_allclose(first + second, opacity / (opacity + 1e-3), atol=1e-4)
    assert first.max() > 0.3 and second.max() > 0.3
