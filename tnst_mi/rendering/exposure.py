"""The exposure of the frames of a run, which brings their images into the [0, 1] of the network, and their share of η.

Exposure is fixed before the first iteration and never differentiated. For emission–absorption it follows in closed form
from C, the most unstylized smoke along a ray: no quadrature exceeds (1 − exp(−γ C))/γ, the continuous image (the
inclusive sum takes the decreasing exp(−τ) at the far end of each step). So images are within [0, 1] in all views and
octaves, whatever γ is, and frames of equal γ have equal exposures. The images themselves would be a poor measure: the
inclusive sum of thick smoke with sharp edges is brighter by orders of magnitude where rays run between cell centres.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.density_unit import scaled
from tnst_mi.fields.grid import Octave
from tnst_mi.fields.resampling import resample_density
from tnst_mi.frame import Frame
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import View, camera_frame, share_cut_off
from tnst_mi.rendering.driving import main_view, stills
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

#: Largest distance in degrees between the views in which columns are measured.
_SPACING = 15.0

#: Number of values of γ at which the smoke in view is measured, where more occur; between them it is interpolated.
_MOST_GAMMAS = 5


def views_around(recipe: Recipe) -> list[View]:
    """Views that cover the camera ranges of a recipe evenly: the main view, the ends of the ranges, some between."""
    azimuths, elevations = (
        np.linspace(low, high, 1 + 2 * math.ceil((high - low) / (2 * _SPACING)) if high > low else 1)
        for low, high in (recipe.azimuth, recipe.elevation)
    )
    return [(float(azimuth), float(elevation)) for azimuth in azimuths for elevation in elevations]


@dataclass(frozen=True)
class Columns:
    """How much smoke there is along a ray, at most, in density × full-resolution cells.

    Attributes:
        ray: the largest ∫ d of all rays, in all views and octaves; infinite where nothing at all gets through.
        cell: the largest h d of all cells, in all octaves.
    """

    ray: float
    cell: float


def largest_columns(
    density: np.ndarray,
    octaves: Sequence[Octave],
    sizes: Sequence[tuple[int, int]],
    views: Sequence[View],
    gamma: float,
) -> Columns:
    """Measure the smoke of a frame.

    Args:
        density: (D, H, W) at full resolution.
        octaves: of the run.
        sizes: rows and columns of the images of each octave.
        views: from `views_around`.
        gamma: the smallest γ of the run: columns that hide everything behind them need not be told apart.
    """
    ray = cell = 0.0
    for octave, size in zip(octaves, sizes, strict=True):
        seen = resample_density(mi.TensorXf(density), 1.0, octave.shape, octave.cell_size)
        renderer = EmissionAbsorptionRenderer(octave.shape, gamma, "transmittance", octave.cell_size, size=size)
        with dr.suspend_grad():
            opacity = float(dr.max(renderer.render(seen, views).array)[0])
        column = -math.log1p(-opacity) / gamma if opacity < 1.0 else math.inf
        thickest = octave.cell_size * float(dr.max(seen.array)[0])
        # In other views, a ray may meet the same smoke with a sample more.
        ray, cell = max(ray, column + thickest), max(cell, thickest)
    return Columns(ray, cell)


def brightest_possible(column: float, recipe: Recipe, octaves: Sequence[Octave]) -> float:
    """Upper bound of the emission–absorption images of smoke, ≥ 0.

    Args:
        column: the largest ∫ d along a ray.
        recipe: of the frame, without keyframes.
        octaves: of the run.
    """
    if recipe.quadrature == "integrated_transmittance":
        # Empty space is the brightest: all of the way through the box of the grid, and up to a sample more.
        return max(_way_through(octave, view) for octave in octaves for view in views_around(recipe))
    opacity = -math.expm1(-recipe.gamma * column)
    return opacity if recipe.quadrature == "transmittance" else opacity / recipe.gamma


def _way_through(octave: Octave, view: View) -> float:
    """The longest way of a ray of a view through the box of a grid, and a sample more, in full-resolution cells."""
    direction = np.abs(camera_frame(*view)[2])
    cells = np.array(octave.shape[::-1])[direction > 0] / direction[direction > 0]
    return octave.cell_size * (float(cells.min()) + 1.0)


def exposure_for(brightest: float) -> float:
    """Factor from rendered images to the network's [0, 1]: 1 / the brightest pixel, 1 where everything is black."""
    return 1.0 / brightest if brightest > 0.0 else 1.0


@dataclass(frozen=True)
class Brightness:
    """How bright and how thick a frame is.

    Attributes:
        exposure: factor from its rendered images to the network's [0, 1].
        step_scale: S_t / max_s S_s, the factor of η (the σ of paper Eq. 2), where S_s is the sum of the pixels in the
            main view of frame s, rendered with the γ of frame t; 0 for a frame whose main view is black.
        thickest: the largest γ h d of a cell, in any octave.
        cut_off: the largest share of the smoke that lies outside the image in a view around the main view.
    """

    exposure: float
    step_scale: float
    thickest: float
    cut_off: float


def brightness(
    frames: Iterable[Frame],
    recipes: Sequence[Recipe],
    levels: Sequence[Octave],
    sizes: Sequence[tuple[int, int]],
    density_scale: float,
) -> list[Brightness]:
    """Render the frames of a run, each with its own γ and cameras.

    Frames of equal γ have the same exposure, that of the frame with the most smoke along a ray, so that a sequence does
    not flicker. Path-traced frames have no such bound: of equal γ, the brightest counts.

    Args:
        frames: in their order.
        recipes: the recipe of each frame, without keyframes.
        levels: the octaves of the run.
        sizes: rows and columns of the images of each octave.
        density_scale: factor of all densities.
    """
    gammas = _measured_gammas(recipes)
    # By frame: sums of the main view at each of `gammas`, the largest columns, the brightest pixel if path traced.
    sums: list[list[float]] = []
    columns: list[Columns] = []
    pixels: list[float] = []
    cut_off: list[float] = []
    for frame, recipe in zip(frames, recipes, strict=True):
        density, views = scaled(frame.density, density_scale), views_around(recipe)
        # Where empty space is the brightest, smoke in view is measured by what else drives stylizations.
        shown = replace(recipe, quadrature="paper") if recipe.quadrature == "integrated_transmittance" else recipe
        images = (main_view(density, replace(shown, gamma=gamma), sizes[-1]) for gamma in gammas)
        sums.append([float(image.sum(dtype=np.float64)) for image in images])
        columns.append(largest_columns(density, levels, sizes, views, gammas[0]))
        cut_off.append(share_cut_off(frame.density, views, sizes[-1]))
        if recipe.integrator != "emission_absorption":
            pixels.append(float(stills(density, views, recipe, sizes[-1]).max()))
    longest = max(column.ray for column in columns)
    found = []
    for index, recipe in enumerate(recipes):
        if pixels:
            brightest = max(p for p, other in zip(pixels, recipes, strict=True) if other.gamma == recipe.gamma)
        else:
            brightest = brightest_possible(longest, recipe, levels)
        in_view = [_at(recipe.gamma, gammas, of_frame) for of_frame in sums]
        step_scale = in_view[index] / max(in_view) if in_view[index] > 0 else 0.0
        thickest = recipe.gamma * columns[index].cell
        found.append(Brightness(exposure_for(brightest), step_scale, thickest, cut_off[index]))
    return found


def _measured_gammas(recipes: Sequence[Recipe]) -> list[float]:
    """The values of γ that occur, in rising order; of many, evenly spaced ones between the ends."""
    gammas = sorted({recipe.gamma for recipe in recipes})
    return gammas if len(gammas) <= _MOST_GAMMAS else np.geomspace(gammas[0], gammas[-1], _MOST_GAMMAS).tolist()


def _at(gamma: float, gammas: Sequence[float], sums: Sequence[float]) -> float:
    """A frame's sum of pixels at one γ, from those at some others: a power law between neighbours."""
    if gamma in gammas or not all(sums):
        return float(np.interp(gamma, gammas, sums))
    return math.exp(np.interp(math.log(gamma), np.log(gammas), np.log(sums)))
