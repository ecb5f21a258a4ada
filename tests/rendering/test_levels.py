"""Octaves and their images: what a motif size makes of them on grids of any fineness, and images finer than a grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import ray_march
from fields import blob, directional_error, smooth_noise
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tnst_mi.choices import LOOKS
from tnst_mi.errors import InputError
from tnst_mi.fields.grid import octaves
from tnst_mi.fields.resampling import resample_density
from tnst_mi.frame import Frame
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.driving import driving_renderer
from tnst_mi.rendering.exposure import brightness
from tnst_mi.rendering.levels import MOTIF_PIXELS, Level, by_cell, full_level, levels_of, levels_seen
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

RECIPE = Recipe(tag=("net",), octaves=3)
SHAPES = st.tuples(*[st.integers(1, 200)] * 3)


def of_motifs(size: float | str, **keys: object) -> Recipe:
    return dataclasses.replace(RECIPE, motif_size=size, **keys)


# ---------------------------------------------------------------- the octaves


@given(SHAPES, st.integers(1, 4), st.floats(1.01, 3.0))
@example((1, 1, 2), 2, 1.8)
@example((4, 4, 9), 3, 1.1)
@settings(max_examples=50)
def test_pixels_are_cells_where_motifs_have_so_many(shape: tuple[int, int, int], count: int, factor: float) -> None:
    recipe = of_motifs("cells", octaves=count, scale_factor=factor)
    found = octaves(shape, count, factor)
    expected = [Level(o.shape, o.cell_size, o.shape[1:], o.cell_size) for o in found]
    assert levels_of(recipe, shape) == levels_seen(recipe, shape) == expected
    assert by_cell(recipe, shape) is recipe


@given(SHAPES)
@settings(max_examples=50)
def test_cells_are_a_motif_size_of_24_of_them(shape: tuple[int, int, int]) -> None:
    depth, rows, columns = shape
    rows = max(rows, 12)
    named, cells = of_motifs(MOTIF_PIXELS / rows), of_motifs("cells")
    assert levels_of(named, (depth, rows, columns)) == levels_of(cells, (depth, rows, columns))
    assert by_cell(named, (depth, rows, columns)).gamma == RECIPE.gamma


@given(SHAPES)
@settings(max_examples=50)
def test_auto_is_cells_up_to_96_rows_and_a_quarter_of_the_height_beyond(shape: tuple[int, int, int]) -> None:
    same = of_motifs("cells" if shape[1] <= 96 else 0.25)
    assert levels_of(RECIPE, shape) == levels_of(same, shape)
    assert by_cell(RECIPE, shape).gamma == by_cell(same, shape).gamma


@given(SHAPES, st.sampled_from([0.1, 0.25, "cells", "auto"]), st.sampled_from([*LOOKS, 7.0]))
@settings(max_examples=50)
def test_auto_gamma_is_the_optical_depth_of_the_look(
    shape: tuple[int, int, int], size: float | str, look: float | str
) -> None:
    """Whatever the grid and the images: smoke of density 1 along the longest edge is as thick as in the look."""
    depth = {"thin": 5.0, "medium": 25.0, "thick": 100.0}.get(str(look), 7.0)
    seen = by_cell(of_motifs(size, gamma="auto", look=look), shape)
    assert seen.extinction * max(shape) == pytest.approx(depth)


def test_images_have_the_same_rows_on_every_grid() -> None:
    found = {rows: levels_of(of_motifs(0.25), (2 * rows // 3, rows, 2 * rows // 3)) for rows in (64, 96, 128, 200)}
    for rows, levels in found.items():
        assert [level.size[0] for level in levels] == [29, 53, 96]
        assert [level.size[0] * level.pixel for level in levels] == pytest.approx([rows] * 3)
        # A grid is never made finer than it is.
        assert [level.shape[1] for level in levels] == [29, 53, min(rows, 96)]
        assert all(level.cell_size == max(level.pixel, 1) for level in levels)
    assert [level.shape for level in found[128]] == [level.shape for level in found[96]]
    assert found[64][-1] == Level((42, 64, 42), 1.0, (96, 63), 64 / 96)


@given(SHAPES, st.floats(0.02, 2.0), st.booleans())
@settings(max_examples=60)
def test_octaves_of_any_grid(shape: tuple[int, int, int], size: float, fit: bool) -> None:
    recipe = of_motifs(size, fit=fit)
    levels = levels_of(recipe, shape)
    for level in levels:
        assert all(1 <= n <= max(m, 1) for n, m in zip(level.shape, shape, strict=True))
        assert min(level.size) >= 1 and level.pixel > 0 and level.cell_size >= 1
    pixels = [level.pixel for level in levels]
    assert pixels == sorted(pixels, reverse=True)
    assert levels_seen(recipe, shape)[-1] == full_level(recipe, shape)
    for axis in range(3):
        if shape[axis] == 1:
            assert {level.shape[axis] for level in levels} == {1}, "a plane stays a plane"


def test_half_the_motif_size_has_twice_the_rows() -> None:
    rows = [levels_of(of_motifs(size), (64, 96, 64))[-1].size for size in (0.5, 0.25, 0.125)]
    assert rows == [(48, 32), (96, 64), (192, 128)]


@pytest.mark.parametrize("size", [0.0, -0.25, 0.005, 3, "large", True, [0.25]])
def test_other_sizes_are_refused_in_one_line(size: object) -> None:
    with pytest.raises(InputError, match=r"^recipe: motif_size = [^\n]*a number from 0.01 to 2 or auto or cells$"):
        Recipe(motif_size=size)


def test_images_of_one_smoke_are_the_same_on_a_fine_grid_as_on_a_coarse_one() -> None:
    """Brightness and contrast included: γ is per pixel of the images, and so is that of a grid twice as fine."""
    recipe = of_motifs(1.0, octaves=1, gamma=0.2, quadrature="exact")
    images = []
    for n in (1, 2, 4):
        # Cell centres of a finer grid lie between those of a coarser one: the same smoke, half as coarse.
        centre = [n * (m / 2 + shift) - 0.5 for m, shift in ((16, 1.0), (24, -2.0), (16, 0.5))]
        density = blob((16 * n, 24 * n, 16 * n), (centre[0], centre[1], centre[2]), 3.0 * n)
        at_frame = by_cell(recipe, density.shape)
        (bright,) = brightness([Frame(density, name="blob")], [at_frame], levels_seen(recipe, density.shape), 1.0)
        (level,) = levels_of(recipe, density.shape)
        seen = resample_density(mi.TensorXf(density), 1.0, level.shape, level.cell_size)
        renderer = driving_renderer(at_frame, level.shape, level.cell_size, size=level.size, pixel=level.pixel)
        images.append(bright.exposure * renderer.render(seen, [(0.0, 0.0), (10.0, 5.0)]).numpy())
    assert images[0].max() > 0.7
    for image in images[1:]:
        np.testing.assert_allclose(image, images[0], atol=0.05)


# ---------------------------------------------------------------- images finer than the grid

SHAPE = (10, 14, 9)
VIEWS: list[View] = [(0.0, 0.0), (-9.0, 4.0), (37.0, -12.0)]


def smoke(seed: int) -> np.ndarray:
    return np.abs(smooth_noise(np.random.default_rng(seed), *SHAPE)) + 0.05


def renderer(pixel: float, size: tuple[int, int], quadrature: str = "paper") -> EmissionAbsorptionRenderer:
    return EmissionAbsorptionRenderer(SHAPE, 0.5, quadrature, 1.0, size=size, pixel=pixel)


@pytest.mark.parametrize(("pixel", "size"), [(0.5, (28, 18)), (0.7, (20, 13)), (2 / 3, (21, 14))])
@pytest.mark.parametrize("quadrature", ["paper", "exact"])
def test_images_of_another_fineness_are_those_of_a_numpy_march(
    pixel: float, size: tuple[int, int], quadrature: str
) -> None:
    density = smoke(1)
    images = renderer(pixel, size, quadrature).render(mi.TensorXf(density), VIEWS).numpy()
    edges = np.diag(SHAPE[::-1]).astype(float)
    for image, view in zip(images, VIEWS, strict=True):
        towards = ray_march.camera_axes(view)[2]
        origins = ray_march.pixel_centres((1, *size), view, pixel) + 2 * np.linalg.norm(edges) * towards
        directions = np.broadcast_to(-towards, origins.shape)
        values = ray_march.samples(density, edges, np.zeros(3), origins, directions, 1.0)
        expected = ray_march.radiance(values, 0.5, 1.0, quadrature).reshape(size)
        np.testing.assert_allclose(image, expected, atol=2e-5 * expected.max())


def gradient(of: EmissionAbsorptionRenderer, density: np.ndarray, weights: np.ndarray) -> np.ndarray:
    leaf = mi.TensorXf(density)
    dr.enable_grad(leaf)
    dr.backward(dr.sum(of.render(leaf, VIEWS) * mi.TensorXf(weights), axis=None))
    return dr.grad(leaf).numpy()


SIZES: Sequence[tuple[float, tuple[int, int]]] = [(0.5, (28, 18)), (0.37, (38, 24)), (1.6, (9, 6))]


@pytest.mark.parametrize(("pixel", "size"), SIZES)
def test_the_adjoint_is_the_transpose_and_the_derivative(pixel: float, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    of, density = renderer(pixel, size), smoke(3)
    weights, tangent = smooth_noise(rng, len(VIEWS), *size), smooth_noise(rng, *SHAPE)
    found = gradient(of, density, weights)
    leaf = mi.TensorXf(density)
    dr.enable_grad(leaf)
    dr.set_grad(leaf, mi.TensorXf(tangent))
    forward = dr.forward_to(of.render(leaf, VIEWS)).numpy().astype(np.float64)
    assert (forward * weights).sum() == pytest.approx((found.astype(np.float64) * tangent).sum(), rel=1e-4)

    def objective(point: np.ndarray) -> float:
        return float((of.render(mi.TensorXf(point), VIEWS).numpy().astype(np.float64) * weights).sum())

    directions = [smooth_noise(rng, *SHAPE) for _ in range(12)]
    assert directional_error(objective, found, density, directions, 1e-2) <= 1e-3


def test_the_mean_of_finer_pixels_is_that_of_the_smoke() -> None:
    """What little smoke absorbs nothing: times the area of a pixel, every image has the mass of the grid."""
    density = np.pad(smoke(4), 4)
    for pixel in (0.25, 0.5):
        size = (round(density.shape[1] / pixel), round(density.shape[2] / pixel))
        thin = EmissionAbsorptionRenderer(density.shape, 1e-6, "exact", 1.0, size=size, pixel=pixel)
        images = thin.render(mi.TensorXf(density), VIEWS).numpy().astype(np.float64)
        np.testing.assert_allclose(pixel**2 * images.sum((1, 2)), density.sum(dtype=np.float64), rtol=0.01)
