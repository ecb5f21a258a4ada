"""Light that smoke scatters once into the view, and its derivative: summed up along rays, without random paths.

What reaches a cell x of the light from direction ω_i is E_i T_i(x), with the transmittance T_i from there to the cell;
isotropic scattering sends α/(4π) of their sum in every direction. The smoke emits that as coloured smoke would, so the
renderer of emission and absorption shows it:

    S(x) = Σ_i E_i T_i(x) / (4π),        I = ∫ α σ S T ds

All is of second order in the size of a cell. Of an environment, a few directions are drawn at random, the same for all
cells: their mean is all of it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.grid import Cells, Shape
from tnst_mi.fields.kernels import gather, on_device, opaque
from tnst_mi.fields.stencil import ClampedStencil
from tnst_mi.fields.sums import RepeatableSum, largest_magnitude
from tnst_mi.rendering.cameras.camera import Viewpoint
from tnst_mi.rendering.coloured_renderer import ColouredRenderer
from tnst_mi.rendering.march.grid_march import in_smoke
from tnst_mi.rendering.march.occupancy import Occupancy

#: Directions that are drawn of an environment.
ENVIRONMENT_DIRECTIONS = 8

#: Steps of the R2 sequence (Roberts 2018) in the unit square: points that are spread evenly, whatever their number.
_EVENLY = (0.7548776662466927, 0.5698402909980532)


class Lights(NamedTuple):
    """Light from far away.

    Attributes:
        towards: (N, 3), unit vectors towards the light.
        irradiance: (N,), the luminance that a surface facing it receives.
    """

    towards: np.ndarray
    irradiance: np.ndarray


def draw_lights(scene: mi.Scene, seed: int) -> Lights:
    """The lights of a scene, all of which surround it: directional ones, and directions drawn of environments."""
    spread = np.random.default_rng(seed).random(2) + np.outer(np.arange(ENVIRONMENT_DIRECTIONS), _EVENLY)
    towards, irradiance = [], []
    for emitter in scene.emitters():
        delta = mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta)
        places = np.zeros((1, 2)) if delta else spread % 1.0
        sample, weight = emitter.sample_direction(
            dr.zeros(mi.Interaction3f, len(places)), mi.Point2f(places.T.astype(np.float32))
        )
        towards.append(np.broadcast_to(sample.d.numpy().T, (len(places), 3)))
        luminance = np.atleast_1d(mi.luminance(mi.Color3f(weight)).numpy())
        irradiance.append(np.broadcast_to(luminance / len(places), len(places)))
    return Lights(np.concatenate(towards), np.concatenate(irradiance))


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
        colour = _Shadows(density.array, self._shape, self._per_cell, lights).colour(self._emitted)
        return self._luminance(self._camera.colour_images(density, colour, views), len(views))

    def gradient(
        self, density: mi.TensorXf, views: Sequence[Viewpoint], lights: Lights, image_gradient: mi.TensorXf
    ) -> mi.TensorXf:
        """Pull a gradient (V, H, W) with respect to those images back to the density (D, H, W)."""
        shadows = _Shadows(density.array, self._shape, self._per_cell, lights)
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


class _Shadows:
    """The light at the cells in and beside smoke.

    Args:
        density: of all cells, flat.
        shape: (D, H, W).
        per_cell: extinction of density 1, per cell of this grid.
        lights: what falls on it.
    """

    def __init__(self, density: mi.Float, shape: Shape, per_cell: float, lights: Lights) -> None:
        self._density, self._shape, self._per_cell = dr.detach(density), shape, opaque(per_cell)
        self._occupancy = Occupancy(self._density, shape, 1)
        #: Cells that a sample in smoke may read.
        self._cells = dr.compress(beside_smoke(self._density, shape))
        #: By light, what arrives of it at those cells.
        self._light: list[mi.Float] = []
        if not dr.width(self._cells):
            return
        cells = Cells.of(shape, self._cells)
        self._start = mi.Vector3f(mi.Float(cells.x), mi.Float(cells.y), mi.Float(cells.z))
        self._towards = [
            mi.Vector3f(*(on_device(mi.Float, [value]) for value in light)) for light in lights.towards.tolist()
        ]
        arriving = zip(self._towards, lights.irradiance.tolist(), strict=True)
        self._light = [self._of(*light) for light in arriving]

    def colour(self, factor: float) -> mi.TensorXf:
        """The light at each cell times a factor, as a colour (D, H, W, 3); 0 away from smoke."""
        colour = dr.zeros(mi.Float, 3 * math.prod(self._shape))
        if self._light:
            light = opaque(factor) * sum(self._light)
            for channel in range(3):
                dr.scatter(colour, light, 3 * self._cells + channel)
        return mi.TensorXf(colour, (*self._shape, 3))

    def gradient(self, of_light: mi.Float) -> mi.Float:
        """Pull a gradient with respect to the light at each cell back to the density."""
        if not self._light:
            return dr.zeros(mi.Float, math.prod(self._shape))
        scale = -self._per_cell * dr.gather(mi.Float, of_light, self._cells)
        of_τ = [scale * light for light in self._light]
        bound = functools.reduce(dr.maximum, map(largest_magnitude, of_τ))
        total = RepeatableSum(math.prod(self._shape), bound, len(of_τ) * dr.width(self._cells))

        def splat(stencil: ClampedStencil, of_τ: mi.Float) -> tuple:
            stencil.splat(total, of_τ)
            return (of_τ,)

        for towards, value in zip(self._towards, of_τ, strict=True):
            self._march(towards, value, splat)
            dr.eval(total.total)
        return total.result()

    def _of(self, towards: mi.Vector3f, irradiance: float) -> mi.Float:
        def add(stencil: ClampedStencil, τ: mi.Float) -> tuple:
            return (τ + stencil.value(stencil.read(self._density, 1))[0],)

        zeros = dr.zeros(mi.Float, dr.width(self._cells))
        τ = self._march(towards, zeros, lambda stencil, τ: in_smoke(self._occupancy, add, stencil, τ))
        light = on_device(mi.Float, [irradiance]) * dr.exp(-τ * self._per_cell)
        dr.eval(light)
        return light

    def _march(self, towards: mi.Vector3f, state: mi.Float, visit: Any) -> mi.Float:
        """Visit the samples in the middle of each step of one cell towards a light, as far as the grid reaches."""
        d, h, w = self._shape
        last = mi.Vector3f(opaque(w - 0.5), opaque(h - 0.5), opaque(d - 0.5))
        to_faces = dr.select(towards > 0, last - self._start, -0.5 - self._start) / towards
        count = mi.UInt32(dr.min(dr.select(towards == 0, dr.inf, to_faces)) + 0.5)
        return dr.while_loop(
            state=(dr.zeros(mi.UInt32, dr.width(state)), state),
            cond=lambda k, _: k < count,
            body=lambda k, state: (
                k + 1,
                *visit(ClampedStencil(self._shape, self._start + towards * (mi.Float(k) + 0.5)), state),
            ),
            label="shadows",
        )[1]


def beside_smoke(density: mi.Float, shape: Shape) -> mi.Bool:
    """For each cell of a density, flat, whether it or one of its 26 neighbours holds smoke."""
    cells = Cells.of(shape)
    found = mi.Bool(False)
    for z in (-1, 0, 1):
        for y in (-1, 0, 1):
            for x in (-1, 0, 1):
                near = [
                    dr.clip(i + step, 0, cells.size[axis] - 1)
                    for axis, (i, step) in enumerate(((cells.x, x), (cells.y, y), (cells.z, z)))
                ]
                found |= dr.gather(mi.Float, density, cells.index(*near)) > 0
    return found
