"""Exposure: images stay within [0, 1] in every view and octave, whatever the smoke, γ and quadrature."""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_smoke import moving_smoke

import tnst_mi
from tnst_mi.choices import QUADRATURES
from tnst_mi.fields.grid import octaves
from tnst_mi.fields.resampling import resample_density
from tnst_mi.frame import Frame
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import sample_views
from tnst_mi.rendering.columns import views_around
from tnst_mi.rendering.driving import driving_renderer
from tnst_mi.rendering.exposure import Brightness, brightness, exposure_of_thicker
from tnst_mi.rendering.levels import levels_seen

RECIPE = Recipe(style=("net",), octaves=3)


def block() -> np.ndarray:
    """Smoke with sharp edges: density 0 or 1."""
    density = np.zeros((24, 36, 24), np.float32)
    density[6:18, 8:28, 6:18] = 1
    return density


def found(densities: list[np.ndarray], recipes: list[Recipe], scale: float = 1.0) -> list[Brightness]:
    levels = levels_seen(recipes[0], densities[0].shape)
    return brightness([Frame(density) for density in densities], recipes, levels, scale)


def brightest(density: np.ndarray, recipe: Recipe, seed: int) -> float:
    """The largest pixel of random views of a run, in all its octaves, but for rounding."""
    largest = 0.0
    for octave in octaves(density.shape, recipe.octaves, recipe.scale_factor):
        seen = resample_density(mi.TensorXf(density), 1.0, octave.shape, octave.cell_size)
        renderer = driving_renderer(recipe, octave.shape, octave.cell_size)
        views = [tuple(view) for view in sample_views(9, recipe.azimuth, recipe.elevation, seed).tolist()]
        views.append((recipe.main_view[0], recipe.main_view[1] + 0.2))
        largest = max(largest, float(dr.max(renderer.render(seen, views).array)[0]))
    return largest * (1 - 1e-6)


@pytest.mark.parametrize("gamma", [0.01, 0.5, 5.0, 10.0, 1e4])
@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_images_of_sharp_edges_stay_within_one(gamma: float, quadrature: str) -> None:
    """Between cell centres the inclusive sum of thick smoke is brighter than the front view by orders of magnitude."""
    recipe = dataclasses.replace(RECIPE, gamma=gamma, quadrature=quadrature)
    (alone,) = found([block()], [recipe])
    for seed in range(3):
        assert brightest(block(), recipe, seed) * alone.exposure <= 1.0
    if quadrature != "paper":
        assert brightest(block(), recipe, 0) * alone.exposure > 0.8


@given(
    st.tuples(*[st.integers(1, 20)] * 3),
    st.integers(0, 1000),
    st.sampled_from([0.03, 0.3, 3.0]),
    st.sampled_from([(-10.0, 10.0), (30.0, 30.0), (-180.0, 180.0)]),
)
@settings(max_examples=30)
def test_images_of_noise_stay_within_one(
    shape: tuple[int, int, int], seed: int, gamma: float, azimuth: tuple[float, float]
) -> None:
    density = np.random.default_rng(seed).random(shape, np.float32) ** 4
    recipe = dataclasses.replace(RECIPE, gamma=gamma, azimuth=azimuth, octaves=2)
    (alone,) = found([density], [recipe])
    assert brightest(density, recipe, seed) * alone.exposure <= 1.0


def test_thin_smoke_is_as_bright_as_white() -> None:
    """The bound is tight where smoke is thin: a cell remains for views between those that are looked at."""
    recipe = dataclasses.replace(RECIPE, gamma=1e-3, octaves=1, azimuth=(0.0, 0.0), elevation=(0.0, 0.0))
    (alone,) = found([block()], [recipe])
    front = tnst_mi.render(block(), gamma=1e-3).max()
    assert front * alone.exposure == pytest.approx(12 / 13, rel=0.01)


def test_frames_of_equal_gamma_share_the_exposure_of_the_thickest() -> None:
    densities = [0.5 * block(), block(), 0 * block()]
    together = found(densities, [RECIPE] * 3)
    (alone,) = found(densities[1:2], [RECIPE])
    assert [frame.exposure for frame in together] == [alone.exposure] * 3
    assert together[2].step_scale == 0.0 and together[1].step_scale == 1.0


@pytest.mark.parametrize("sharp", [False, True])
def test_of_many_gammas_each_counts(sharp: bool) -> None:
    """Steps follow the smoke in view at each frame's own γ, also where the front view of sharp edges falls to nothing.

    With many γ, frames are compared with those that lead at some of them, which may miss the leader by a little.
    """
    frames = [frame.density for frame in moving_smoke(3)]
    densities = [block() * (0.3 if i % 2 else 1.0) if sharp else frames[i % 3] * (1.0 + i) for i in range(11)]
    recipes = [dataclasses.replace(RECIPE, gamma=gamma) for gamma in np.linspace(0.1, 20.0 if sharp else 2.0, 11)]
    for recipe, frame, density in zip(recipes, found(densities, recipes), densities, strict=True):
        sums = [tnst_mi.render(other, gamma=recipe.gamma).sum(dtype=float) for other in densities]
        own = tnst_mi.render(density, gamma=recipe.gamma).sum(dtype=float)
        assert frame.step_scale == pytest.approx(own / max(sums), rel=1e-4 if sharp else 0.02)


@pytest.mark.parametrize("depth", [24, 64, 120])
@pytest.mark.parametrize("azimuth", [5.0, -7.77, 2.74])
def test_images_of_a_thin_sheet_seen_along_it_stay_within_one(depth: int, azimuth: float) -> None:
    """Its columns are many times as long in views that run along it, within less than a degree."""
    z, x = np.meshgrid(np.arange(depth) - (depth - 1) / 2, np.arange(48) - 23.5, indexing="ij")
    a = np.radians(azimuth)
    sheet = np.clip(1.25 - np.abs(x * np.cos(a) - z * np.sin(a)), 0, 1).astype(np.float32)
    density = np.repeat(sheet[:, None], 24, axis=1)
    recipe = dataclasses.replace(RECIPE, gamma=0.01)
    (alone,) = found([density], [recipe])
    assert 0.85 < tnst_mi.render(density, (azimuth, 0), gamma=0.01).max() * alone.exposure <= 1.0
    for seed in range(3):
        assert brightest(density, recipe, seed) * alone.exposure <= 1.01


def test_views_cover_the_ranges() -> None:
    views = np.array(views_around(RECIPE))
    assert [RECIPE.main_view in map(tuple, views), len(views)] == [True, 9]
    wide = np.array(views_around(dataclasses.replace(RECIPE, azimuth=(-180.0, 180.0), elevation=(5.0, 5.0))))
    assert wide.min(0).tolist() == [-180, 5] and wide.max(0).tolist() == [180, 5]
    assert np.diff(np.unique(wide[:, 0])).max() <= 15 and [0.0, 5.0] in wide.tolist()


def test_where_empty_space_is_bright_empty_frames_still_take_no_steps() -> None:
    recipe = dataclasses.replace(RECIPE, quadrature="integrated_transmittance")
    half, whole, empty = found([0.5 * block(), block(), 0 * block()], [recipe] * 3)
    assert (whole.step_scale, empty.step_scale) == (1.0, 0.0) and 0.4 < half.step_scale < 1.0
    assert 0.85 < brightest(0 * block(), recipe, 0) * empty.exposure <= 1.0


@pytest.mark.parametrize("quadrature", ["paper", "exact", "transmittance", "integrated_transmittance"])
def test_the_exposure_of_thicker_smoke_follows_from_that_of_the_smoke(quadrature: str) -> None:
    density = np.random.default_rng(4).random((12, 16, 10), dtype=np.float32)
    recipe = Recipe(style=("spirals",), gamma=0.02, quadrature=quadrature, octaves=1)
    (thin,) = brightness([Frame(density)], [recipe], levels_seen(recipe, density.shape), 1.0)
    (thick,) = brightness([Frame(density)], [recipe], levels_seen(recipe, density.shape), 3.0)
    assert exposure_of_thicker(thin.exposure, 3.0, recipe) == pytest.approx(thick.exposure, rel=1e-4)
    assert exposure_of_thicker(thin.exposure, 1.0, recipe) == pytest.approx(thin.exposure, rel=1e-9)
