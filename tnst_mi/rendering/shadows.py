"""What arrives of light from far away in smoke: transmittances, summed up along straight lines from every cell.

All is of second order in the size of a cell. Of an environment, a few directions are drawn at random, the same for all
cells, so that the mean over draws is the light of all of it.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.grid import Cells, Shape
from tnst_mi.fields.kernels import on_device, opaque, stored
from tnst_mi.fields.stencil import ClampedStencil
from tnst_mi.fields.sums import RepeatableSum, largest_magnitude
from tnst_mi.rendering.march.grid_march import in_smoke
from tnst_mi.rendering.march.occupancy import Occupancy

#: Directions that are drawn of an environment: at least, for each path per pixel, and at most, since the light from
#: each is kept for every cell.
_FEWEST, _FOR_EACH_PATH, _MOST = 8, 1 / 8, 64

#: Steps of the R2 sequence (Roberts 2018) in the unit square: points that are spread evenly, whatever their number.
_EVENLY = (0.7548776662466927, 0.5698402909980532)


class Lights(NamedTuple):
    """Light from far away.

    Attributes:
        towards: (N, 3), unit vectors towards the light.
        irradiance: (N,), the luminance that a surface facing each receives.
    """

    towards: np.ndarray
    irradiance: np.ndarray


def draw_lights(scene: mi.Scene, seed: int, spp: int) -> Lights:
    """The lights of a scene, all of which surround it: directional ones, and directions drawn of environments.

    Args:
        scene: of the lights.
        seed: of the directions.
        spp: paths per pixel of the light that is scattered more often: the more, the more directions, so that the noise
            of neither is left when the other's has gone.
    """
    count = min(max(_FEWEST, round(_FOR_EACH_PATH * spp)), _MOST)
    spread = np.random.default_rng(seed).random(2) + np.outer(np.arange(count), _EVENLY)
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


class Shadows:
    """The light that arrives at cells in smoke, and at those up to two cells away, and its derivative.

    Args:
        density: of all cells, flat.
        shape: (D, H, W).
        per_cell: extinction of density 1, per cell of this grid.
        lights: what falls on it.
    """

    def __init__(self, density: mi.Float, shape: Shape, per_cell: float, lights: Lights) -> None:
        self._density, self._shape, self._per_cell = dr.detach(density), shape, opaque(per_cell)
        self._occupancy = Occupancy(self._density, shape, 1)
        # What a sample reads that is in smoke, or would be if a cell beside smoke had some.
        beside = beside_smoke(self._density, shape)
        self._cells = dr.compress(beside_smoke(stored(dr.select(beside, 1.0, 0.0)), shape))
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
        total = RepeatableSum(math.prod(self._shape), bound, 8 * len(of_τ) * dr.width(self._cells))

        def splat(stencil: ClampedStencil, length: mi.Float, of_τ: mi.Float) -> tuple:
            stencil.splat(total, length * of_τ)
            return (of_τ,)

        for towards, value in zip(self._towards, of_τ, strict=True):
            self._march(towards, value, splat)
            dr.eval(total.total)
        return total.result()

    def _of(self, towards: mi.Vector3f, irradiance: float) -> mi.Float:
        def add(stencil: ClampedStencil, length: mi.Float, τ: mi.Float) -> tuple:
            return length, τ + length * stencil.value(stencil.read(self._density, 1))[0]

        def add_smoke(stencil: ClampedStencil, length: mi.Float, τ: mi.Float) -> tuple:
            return in_smoke(self._occupancy, add, stencil, length, τ)[1:]

        τ = self._march(towards, dr.zeros(mi.Float, dr.width(self._cells)), add_smoke)
        light = on_device(mi.Float, [irradiance]) * dr.exp(-τ * self._per_cell)
        dr.eval(light)
        return light

    def _march(self, towards: mi.Vector3f, state: mi.Float, visit: Any) -> mi.Float:
        """Visit the middles of steps of one cell, of which the last ends where the grid does, towards a light."""
        d, h, w = self._shape
        last = mi.Vector3f(opaque(w - 0.5), opaque(h - 0.5), opaque(d - 0.5))
        to_faces = dr.select(towards > 0, last - self._start, -0.5 - self._start) / towards
        end = dr.min(dr.select(towards == 0, dr.inf, to_faces))

        def step(begin: mi.Float, state: mi.Float) -> tuple:
            length = dr.minimum(1, end - begin)
            middle = self._start + towards * (begin + 0.5 * length)
            return begin + 1, *visit(ClampedStencil(self._shape, middle), length, state)

        begin = dr.zeros(mi.Float, dr.width(state))
        return dr.while_loop((begin, state), lambda begin, _: begin < end, step, label="shadows")[1]


def beside_smoke(density: mi.Float, shape: Shape) -> mi.Bool:
    """For each cell of a density, flat, whether it or one of its 26 neighbours holds smoke.

    Where there is no smoke at all, any cell is where smoke may begin, and so all are.
    """
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
    return found | (dr.max(density) <= 0)
