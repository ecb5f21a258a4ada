"""The exposure of the frames of a run, which brings their images into the [0, 1] of the network, and their share of η.

Exposure is fixed before the first iteration and never differentiated. For emission–absorption it follows in closed form
from C, the most unstylized smoke along a ray: no quadrature exceeds (1 − exp(−γ C))/γ, the continuous image (the
inclusive sum takes the decreasing exp(−τ) at the far end of each step). So images are within [0, 1] in all views and
octaves, whatever γ is, and frames of equal γ have equal exposures. The images themselves would be a poor measure: the
inclusive sum of thick smoke with sharp edges is brighter by orders of magnitude where rays run between cell centres.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tnst_mi.fields.density_unit import scaled
from tnst_mi.fields.grid import Octave
from tnst_mi.frame import Frame
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import View, camera_frame, share_cut_off
from tnst_mi.rendering.columns import largest_columns, views_around
from tnst_mi.rendering.driving import main_view, stills
from tnst_mi.rendering.levels import Level

#: Number of values of γ at which all frames are compared, where more occur: those that have the most smoke in view at
#: one of them are then compared with every frame at its own γ.
_MOST_GAMMAS = 5


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
    opacity = -math.expm1(-recipe.extinction * column)
    return opacity if recipe.quadrature == "transmittance" else opacity / recipe.extinction


def _way_through(octave: Octave, view: View) -> float:
    """The longest way of a ray of a view through the box of a grid, and a sample more, in full-resolution cells."""
    direction = np.abs(camera_frame(*view[:2])[2])
    cells = np.array(octave.shape[::-1])[direction > 0] / direction[direction > 0]
    return octave.cell_size * (float(cells.min()) + 1.0)


def exposure_for(brightest: float) -> float:
    """Factor from rendered images to the network's [0, 1]: 1 / the brightest pixel, 1 where everything is black."""
    return 1.0 / brightest if brightest > 0.0 else 1.0


def exposure_of_thicker(exposure: float, factor: float, recipe: Recipe) -> float:
    """The exposure of a frame once there is `factor` times as much smoke along each ray; see `brightest_possible`.

    Args:
        exposure: what it was before.
        factor: above 0.
        recipe: of the frame, without keyframes, rendered by emission and absorption.
    """
    if recipe.quadrature == "integrated_transmittance":
        return exposure
    full = 1.0 if recipe.quadrature == "transmittance" else 1.0 / recipe.extinction
    opacity = min(1.0 / (exposure * full), 1.0 - 1e-12)
    return exposure_for(-math.expm1(factor * math.log1p(-opacity)) * full)


#: Paths per pixel of the path-traced views whose brightest pixel counts.
_GLIMPSE_SPP = 64


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
    frames: Sequence[Frame],
    recipes: Sequence[Recipe],
    levels: Sequence[Level],
    density_scale: float,
    watch: Callable[[Sequence[Frame]], Iterable[Frame]] = iter,
) -> list[Brightness]:
    """Render the frames of a run, each with its own γ and cameras.

    Frames of equal γ have the same exposure, that of the frame with the most smoke along a ray, so that a sequence does
    not flicker. Path-traced frames have no such bound: of equal γ, the brightest counts.

    Args:
        frames: in their order.
        recipes: the recipe of each frame, without keyframes.
        levels: the octaves of the run, and last the full grid; see `levels_seen`.
        density_scale: factor of all densities.
        watch: passes the frames on, and shows the progress.
    """
    size = levels[-1].size
    gammas, own_gammas = _measured_gammas(recipes), [recipe.extinction for recipe in recipes]
    # By frame: the smoke in view by γ, the largest columns, the brightest pixel if path traced, what is cut off.
    in_view, columns, pixels, cut_off = [], [], [], []
    for frame, recipe in zip(watch(frames), recipes, strict=True):
        density, views = scaled(frame.density, density_scale), views_around(recipe)
        in_view.append({g: _in_view(density, recipe, g, size) for g in {*gammas, recipe.extinction}})
        columns.append(largest_columns(density, levels, recipe, gammas[0]))
        cut_off.append(share_cut_off(frame.density, views, size))
        if recipe.integrator != "emission_absorption":
            corners = itertools.product(recipe.azimuth, recipe.elevation)
            ends = [recipe.main_view, *(recipe.view(*angles) for angles in corners)]
            pixels.append(float(stills(density, ends, recipe, size, _GLIMPSE_SPP).max()))
    others = {*own_gammas} - {*gammas}
    for leader in {max(range(len(frames)), key=lambda i: in_view[i][g]) for g in gammas} if others else ():
        density = scaled(frames[leader].density, density_scale)
        in_view[leader] |= {g: _in_view(density, recipes[leader], g, size) for g in others}
    longest = max(column.ray for column in columns)
    found = []
    for index, recipe in enumerate(recipes):
        if pixels:
            brightest = max(p for p, gamma in zip(pixels, own_gammas, strict=True) if gamma == recipe.extinction)
        else:
            brightest = brightest_possible(longest, recipe, levels)
        own, most = in_view[index][recipe.extinction], max(sums.get(recipe.extinction, 0.0) for sums in in_view)
        step_scale = own / most if own > 0 else 0.0
        thickest = recipe.extinction * columns[index].cell
        found.append(Brightness(exposure_for(brightest), step_scale, thickest, cut_off[index]))
    return found


def _in_view(density: np.ndarray, recipe: Recipe, gamma: float, size: tuple[int, int]) -> float:
    """The sum of the pixels of the main view at some γ."""
    # Where empty space is the brightest, smoke in view is measured by what else drives stylizations.
    quadrature = "paper" if recipe.quadrature == "integrated_transmittance" else recipe.quadrature
    return float(main_view(density, replace(recipe, gamma=gamma, quadrature=quadrature), size).sum(dtype=np.float64))


def _measured_gammas(recipes: Sequence[Recipe]) -> list[float]:
    """The values of γ that occur, in rising order; of many, evenly spaced ones between the ends."""
    gammas = sorted({recipe.extinction for recipe in recipes})
    return gammas if len(gammas) <= _MOST_GAMMAS else np.geomspace(gammas[0], gammas[-1], _MOST_GAMMAS).tolist()
