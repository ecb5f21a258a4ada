"""The renderer that drives a stylization, chosen by its recipe: emission–absorption, or the scattering path tracer."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import mitsuba as mi
import numpy as np

from tnst_mi.fields.grid import Shape
from tnst_mi.recipe.paths import LIGHTS, shipped_lights
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import View, fitted_size
from tnst_mi.rendering.coloured_renderer import ColouredRenderer
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer, Renderer
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer

STILL_SPP = 256
"""Paths per pixel of a path-traced still; an iteration of an optimisation needs far fewer."""


def image_size(recipe: Recipe, shape: Shape, h: float = 1.0) -> tuple[int, int]:
    """Rows and columns of the images of a grid (D, H, W), of all frames of a recipe.

    Args:
        recipe: of a run or a frame.
        shape: of the grid.
        h: size of its cells in full-resolution cells.

    Raises:
        InputError: all of the grid is to be seen, and a shot is too near for that.
    """
    if not recipe.fit:
        return shape[1:]
    nearest = min((shot[2] for shot in recipe.shots if len(shot) == 3), default=None)
    return fitted_size(shape, *recipe.view_ranges, None if nearest is None else nearest / h)


def driving_renderer(
    recipe: Recipe,
    shape: Shape,
    h: float,
    spp: int | None = None,
    size: tuple[int, int] | None = None,
    pixel: float | None = None,
) -> Renderer:
    """The renderer of a recipe's views, for grids of shape (D, H, W) and cell size h.

    Args:
        recipe: of a frame, without keyframes.
        shape: of the grid.
        h: size of a cell in full-resolution cells.
        spp: paths per pixel, by default the recipe's; emission–absorption ignores it.
        size: rows and columns of the images, by default those of the grid; see `image_size`.
        pixel: distance between pixels in full-resolution cells, by default h.

    Raises:
        InputError: the recipe's light cannot be used.
    """
    if recipe.integrator == "emission_absorption":
        return EmissionAbsorptionRenderer(shape, recipe.extinction, recipe.quadrature, h, size=size, pixel=pixel)
    light = LIGHTS / f"{recipe.light}.xml" if recipe.light in shipped_lights() else Path(recipe.light)
    lighting = Lighting(recipe.albedo, recipe.anisotropy, light, recipe.spp if spp is None else spp)
    return _scattering(mi.variant(), shape, recipe.extinction, h, lighting, size, pixel)


def colour_renderer(
    recipe: Recipe,
    shape: Shape,
    h: float,
    size: tuple[int, int] | None = None,
    pixel: float | None = None,
) -> ColouredRenderer:
    """The renderer of a recipe's views of smoke in colour; see `driving_renderer`."""
    return ColouredRenderer(shape, recipe.extinction, recipe.quadrature, h, size=size, pixel=pixel)


def main_view(
    density: np.ndarray, recipe: Recipe, size: tuple[int, int] | None = None, colour: np.ndarray | None = None
) -> np.ndarray:
    """Render a density (D, H, W) from the centre of the camera ranges, unexposed; see `stills`.

    Returns:
        (rows, columns), or with a colour (D, H, W, 3), of any scale, (rows, columns, 3) by emission–absorption.
    """
    if colour is None:
        return stills(density, [recipe.main_view], recipe, size)[0]
    renderer = colour_renderer(recipe, density.shape, 1.0, size=size)
    return renderer.render_colour(mi.TensorXf(density), mi.TensorXf(colour), [recipe.main_view]).numpy()[0]


def stills(
    density: np.ndarray,
    views: Sequence[View],
    recipe: Recipe,
    size: tuple[int, int] | None = None,
    spp: int = STILL_SPP,
) -> np.ndarray:
    """Render a density (D, H, W) from V views as a recipe's renderer sees it: (V, rows, columns), unexposed.

    If they are path traced, the same density has the same noise each time. `size`, `spp` and errors are those of
    `driving_renderer`.
    """
    renderer = driving_renderer(recipe, density.shape, 1.0, spp, size)
    return renderer.render(mi.TensorXf(density), views, [recipe.seed]).numpy()


@functools.lru_cache(maxsize=4)
def _scattering(
    variant: str,
    shape: Shape,
    gamma: float,
    h: float,
    lighting: Lighting,
    size: tuple[int, int] | None,
    pixel: float | None,
) -> ScatteringRenderer:
    """Cached, since loading a scene is slow and Mitsuba does not free all of its memory."""
    return ScatteringRenderer(shape, gamma, h, lighting, size, pixel)
