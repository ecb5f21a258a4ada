"""What of a stylization is measured: its pictures as the network saw them, from views that it did not see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quality_measures.crops import Picture
from tnst_mi import Recipe, render
from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import scaled
from tnst_mi.fields.grid import Shape
from tnst_mi.losses.pictures import read_image, resized
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.levels import finest_rows

FRONT: View = (0.0, 0.0)

#: How far held-out views lie outside of the camera ranges of the optimisation: a part of these, and some degrees.
_BEYOND, _AT_LEAST = 0.25, 2.0


def held_out_views(recipe: Recipe) -> list[View]:
    """Four views that no iteration of a recipe sees: to the left and right of its camera ranges, below and above."""
    (left, right), (low, high) = recipe.azimuth, recipe.elevation
    middle = (left + right) / 2, (low + high) / 2
    aside, over = (max(_BEYOND * (last - first), _AT_LEAST) for first, last in (recipe.azimuth, recipe.elevation))
    return [
        (left - aside, middle[1]),
        (right + aside, middle[1]),
        (middle[0], low - over),
        (middle[0], high + over),
    ]


@dataclass(frozen=True)
class Look:
    """How a run shows the densities of one of its frames to the network.

    Attributes:
        gamma: extinction per unit of density and full-resolution cell.
        quadrature: of the emission–absorption renderer, which takes the pictures whatever the run was driven by.
        exposure: factor from images to [0, 1].
        density_scale: factor of the densities.
        size: rows and columns of the images of the finest octave, to which pictures are resized.
    """

    gamma: float
    quadrature: str
    exposure: float
    density_scale: float
    size: tuple[int, int]

    def images(self, density: np.ndarray, views: Sequence[View]) -> np.ndarray:
        """Images (V, rows, columns) in [0, 1] of a density (D, H, W)."""
        return self._seen(density, views, self.quadrature, self.exposure)

    def inside(self, density: np.ndarray, views: Sequence[View]) -> np.ndarray:
        """Where there is smoke, (V, rows, columns) bool: where a view is at least half as opaque as anywhere."""
        opacity = self._seen(density, views, "transmittance", 1.0)
        return opacity >= 0.5 * opacity.max((1, 2), keepdims=True)

    def _seen(self, density: np.ndarray, views: Sequence[View], quadrature: str, exposure: float) -> np.ndarray:
        images = np.asarray(render(scaled(density, self.density_scale), list(views), self.gamma, quadrature))
        return np.stack([resized(np.float32(exposure) * image, *self.size) for image in images])


def size_of_images(recipe: Recipe, shape: Shape) -> tuple[int, int]:
    """Rows and columns of the images of the finest octave, for frames (D, H, W) (without the room of `fit`)."""
    rows = finest_rows(recipe, shape)
    return rows, max(1, round(shape[2] * rows / shape[1]))


def style_picture(path: str | Path, size: tuple[int, int]) -> Picture:
    """A style picture as the optimisation's target: grey, cropped to the aspect of the images and resized to them.

    Raises:
        InputError: the file cannot be used, or is transparent where it would be seen.
    """
    fitted = read_image(path).fitted(*size)
    inside = np.ones(size, bool) if fitted.alpha is None else fitted.alpha >= 0.5
    if not inside.any():
        raise InputError(f"{path}: transparent where it is used; use a picture that is opaque there")
    return Picture(fitted.grey, inside)
