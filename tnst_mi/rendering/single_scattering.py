"""Light that smoke scatters once into the view, and its derivative: summed up along rays, without random paths.

Of the light from direction ω_i, E_i T_i(x) reaches a point x, with the transmittance T_i on the way. Smoke that
scatters evenly sends α/(4π) of all that in every direction, as coloured smoke would emit it, which the renderer of
emission and absorption shows:

    I = ∫ α σ S T ds,        S(x) = Σ_i E_i T_i(x) / (4π)
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.grid import Shape
from tnst_mi.fields.kernels import gather
from tnst_mi.rendering.cameras.camera import Viewpoint
from tnst_mi.rendering.coloured_renderer import ColouredRenderer
from tnst_mi.rendering.shadows import Lights, Shadows


class SingleScattering:
    """Images of singly scattered light of smoke that scatters evenly.

    Args:
        shape: (D, H, W) of the grid.
        gamma: ratio γ of extinction to density, per full-resolution cell.
        h: size of a cell in full-resolution cells.
        albedo: scattered share α of the extinguished light.
        size: rows and columns of the images.
        pixel: distance between pixels in full-resolution cells.
    """

    def __init__(
        self, shape: Shape, gamma: float, h: float, albedo: float, size: tuple[int, int], pixel: float
    ) -> None:
        self._shape, self._per_cell = shape, gamma * h
        self._emitted = albedo * gamma / (4 * math.pi)
        self._camera = ColouredRenderer(shape, gamma, "exact", h, size=size, pixel=pixel)

    def images(self, density: mi.TensorXf, views: Sequence[Viewpoint], lights: Lights) -> mi.TensorXf:
        """Images (V, H, W) of a density (D, H, W)."""
        colour = Shadows(density.array, self._shape, self._per_cell, lights).colour(self._emitted)
        return self._luminance(self._camera.colour_images(density, colour, views), len(views))

    def gradient(
        self, density: mi.TensorXf, views: Sequence[Viewpoint], lights: Lights, image_gradient: mi.TensorXf
    ) -> mi.TensorXf:
        """Pull a gradient (V, H, W) with respect to those images back to the density (D, H, W)."""
        shadows = Shadows(density.array, self._shape, self._per_cell, lights)
        colour = shadows.colour(self._emitted)
        images = self._camera.colour_images(density, colour, views)
        of_channel = mi.TensorXf(dr.repeat(image_gradient.array / 3, 3), images.shape)
        of_density, of_colour = self._camera.colour_gradient(density, colour, views, (True, True), images, of_channel)
        cell = dr.arange(mi.UInt32, math.prod(self._shape))
        emitted = sum(gather(of_colour.array, cell, 3))
        return mi.TensorXf(of_density.array + shadows.gradient(self._emitted * emitted), self._shape)

    def _luminance(self, images: mi.TensorXf, count: int) -> mi.TensorXf:
        pixel = dr.arange(mi.UInt32, dr.width(images.array) // 3)
        return mi.TensorXf(gather(images.array, pixel, 3)[0], (count, *self._camera.size))
