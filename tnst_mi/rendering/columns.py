"""The most smoke along a ray in any view of a run, found by a search over the views.

First in a coarse grid, in views close to each other, then around the best of them in the full one. What is thinner than
a coarse cell in two directions, such as a lone filament seen from its end, it may miss.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.density_unit import densest_but_stray
from tnst_mi.fields.resampling import resample_density
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.levels import Level
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

#: Cells along the longest edge of the grid in which the views are searched.
_COARSE = 32

#: Distance in degrees of the views there, about that in which a sheet in the coarse grid goes out of sight; and their
#: largest number, for which it is enlarged in wide ranges.
_SPACING, _MOST_VIEWS = 2.0, 1500

#: Number of views around which the search goes on, and how often it halves its step.
_BEST, _HALVINGS = 2, 4


def views_around(recipe: Recipe, spacing: float = 15.0) -> list[View]:
    """Views that cover the camera ranges of a recipe evenly: the main view, the ends of the ranges, some between.

    Neighbours are at most `spacing` degrees apart.
    """
    return [recipe.view(*angles) for angles in _angles_around(recipe, spacing)]


def _angles_around(recipe: Recipe, spacing: float) -> list[tuple[float, float]]:
    """The angles of `views_around`, within the camera ranges of the recipe."""
    azimuths, elevations = (
        np.linspace(low, high, 1 + 2 * math.ceil((high - low) / (2 * spacing)) if high > low else 1)
        for low, high in (recipe.azimuth, recipe.elevation)
    )
    return [(float(azimuth), float(elevation)) for azimuth in azimuths for elevation in elevations]


@dataclass(frozen=True)
class Columns:
    """How much smoke there is along a ray, at most, in density × full-resolution cells.

    Attributes:
        ray: the largest ∫ d of all rays, in all views and octaves; infinite where nothing at all gets through.
        cell: the largest h d of a cell, in all octaves, but for a few that may be stray.
    """

    ray: float
    cell: float


def largest_columns(
    density: np.ndarray,
    levels: Sequence[Level],
    recipe: Recipe,
    gamma: float,
) -> Columns:
    """Measure the smoke of a frame.

    Args:
        density: (D, H, W) at full resolution.
        levels: the octaves of the run, and last the full grid.
        recipe: of the frame, without keyframes.
        gamma: the smallest γ of the run: columns that hide everything behind them need not be told apart.
    """
    views = [*views_around(recipe), *_thickest_views(density, levels[-1].size, recipe, gamma)]
    ray = cell = 0.0
    for level in levels:
        seen = resample_density(mi.TensorXf(density), 1.0, level.shape, level.cell_size)
        column = float(_columns(seen, level.cell_size, level.size, views, gamma, level.pixel).max())
        densities = seen.numpy().ravel()
        # In other views, a ray may meet the same smoke with a sample more.
        ray = max(ray, column + level.cell_size * float(densities.max()))
        cell = max(cell, level.cell_size * float(densest_but_stray(densities)))
    return Columns(ray, cell)


def _columns(
    density: mi.TensorXf,
    h: float,
    size: tuple[int, int],
    views: Sequence[View],
    gamma: float,
    pixel: float | None = None,
) -> np.ndarray:
    """The largest column of each view; infinite where nothing gets through at γ."""
    renderer = EmissionAbsorptionRenderer(tuple(density.shape), gamma, "transmittance", h, size=size, pixel=pixel)
    with dr.suspend_grad():
        opacity = renderer.render(density, views).numpy().max((1, 2)).astype(np.float64)
    with np.errstate(divide="ignore"):
        return -np.log1p(-opacity) / gamma


def _thickest_views(density: np.ndarray, size: tuple[int, int], recipe: Recipe, gamma: float) -> list[View]:
    """The views with the largest columns in the camera ranges of a recipe."""
    h = max(1.0, max(density.shape) / _COARSE)
    d, rows, columns = (math.ceil(n / h) for n in density.shape)
    coarse_size = math.ceil(size[0] / h), math.ceil(size[1] / h)
    full = mi.TensorXf(density)
    coarse = resample_density(full, 1.0, (d, rows, columns), h)
    spacing = _SPACING
    while len(angles := _angles_around(recipe, spacing)) > _MOST_VIEWS:
        spacing *= 1.25
    views = [recipe.view(*pair) for pair in angles]
    best = np.argsort(-_columns(coarse, h, coarse_size, views, gamma), kind="stable")[:_BEST]
    return [_climbed(full, size, angles[i], recipe, gamma, spacing) for i in best]


def _climbed(
    density: mi.TensorXf,
    size: tuple[int, int],
    angles: tuple[float, float],
    recipe: Recipe,
    gamma: float,
    spacing: float,
) -> View:
    """The view with the largest column around one of these angles, by steps to neighbours that are halved."""
    ranges = np.array([recipe.azimuth, recipe.elevation])
    compass = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    for step in spacing * 0.5 ** np.arange(1, _HALVINGS + 1):
        around = np.clip(np.array(angles) + step * compass, ranges[:, 0], ranges[:, 1]).tolist()
        views = [recipe.view(azimuth, elevation) for azimuth, elevation in around]
        angles = around[int(np.argmax(_columns(density, 1.0, size, views, gamma)))]
    return recipe.view(*angles)
