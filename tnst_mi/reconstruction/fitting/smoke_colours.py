"""The colour of smoke whose extinction is known: what its cells have to emit so that pictures are its renderings.

In each channel, a pixel is linear in the colours c of the cells: b Σ w_k c_k + background, with the brightness b of
white smoke and shares w_k ≥ 0 that the extinction decides. What is lowered is, with c ≥ 0,

    Σ weight (pixel − picture)² / b² + λ Σ (difference of neighbouring cells)²

The second sum makes colours smooth where pictures hardly tell them apart, and goes on with them where there is no
smoke: an interpolation near the border of smoke sees no other colours than those inside. Grids go from coarse to fine.

Since no share is negative, a cell's curvature is at most w_k times the shares of its ray, summed over all pixels, and
that of the prior 4 λ for each neighbour. Minimising such a bound cell by cell is a step that needs no length, and that
never leads away; negative results become 0 (separable surrogates: De Pierro 1995, Erdogan and Fessler 1999). A step
takes some views for all of them (ordered subsets).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby

import mitsuba as mi
import numpy as np

from tnst_mi.fields.grid import Octave
from tnst_mi.fields.resampling import resample_density, resample_velocity
from tnst_mi.io.pictures.srgb import LUMINANCE
from tnst_mi.reconstruction.fitting.image_model import ImageModel
from tnst_mi.reconstruction.fitting.rendering import sample_distance
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.rendering.coloured_renderer import ColouredRenderer

#: Steps on each grid.
_STEPS = 40

#: How often the extinction is found anew with the colours, by how many steps, before the colours are.
COLOUR_ROUNDS, REFINING_STEPS = 3, 50

#: λ, in parts of the mean curvature of cells with smoke.
_SMOOTHNESS = 0.02

#: Opacity below which a pixel counts more and more as one of white smoke.
_FAINT = 0.01

#: Cells with less than this share of the largest extinction count as empty when that mean is taken.
_EMPTY = 0.02


def colour_steps(levels: int) -> int:
    """Steps of finding colours and refining the extinction, with so many grids."""
    return _STEPS * levels + COLOUR_ROUNDS * (REFINING_STEPS + _STEPS)


def smoke_colours(
    extinction: np.ndarray,
    levels: Sequence[Octave],
    photographs: Sequence[Photograph],
    model: ImageModel,
    quadrature: str,
    batch: int,
    start: np.ndarray | None,
    goes_on: Callable[[], bool],
) -> np.ndarray | None:
    """Find the colours of an extinction; None if it did not go on.

    Args:
        extinction: (D, H, W) on the full grid, per cell.
        levels: the grids, from coarse to fine.
        photographs: with colours, in the units of the model.
        model: the light of white smoke, and what is behind it, alike in all channels.
        quadrature: of emission and absorption.
        batch: views of a step.
        start: (D, H, W, 3) on the first of the grids to begin with; None for one colour everywhere.
        goes_on: asked before each step.

    Returns:
        (D, H, W, 3) float32, 0 or more; white where there is no smoke at all.
    """
    colours, before = start, levels[0]
    for octave in levels:
        shape, h = octave.shape, octave.cell_size
        smoke = np.array(resample_density(extinction, 1.0, shape, h), np.float32)
        seen = [photograph.averaged(h) for photograph in photographs]
        problem = _ColourProblem(smoke, octave, seen, model, quadrature, max(1, len(seen) // batch))
        if colours is None:
            colours = np.broadcast_to(problem.mean_colour, (*shape, 3)).astype(np.float32)
        else:
            colours = np.array(resample_velocity(colours, before.cell_size, shape, h), np.float32)
        for step in range(_STEPS):
            if not goes_on():
                return None
            colours = problem.improved(colours, step)
        before = octave
    return colours


def as_if_white(
    extinction: np.ndarray,
    colours: np.ndarray,
    octave: Octave,
    photographs: Sequence[Photograph],
    model: ImageModel,
    quadrature: str,
) -> list[Photograph]:
    """Photographs with the values that they would have if the smoke were white, its strongest channel being 1.

    What a pixel shows of smoke has the luminance of the colours along its ray, which makes it that much darker.
    """
    strongest = colours.max(axis=3, keepdims=True)
    bright = np.divide(colours, strongest, out=np.ones_like(colours), where=strongest > 0)
    found = []
    for photograph in photographs:
        view = _alone(photograph, extinction, octave, quadrature)
        white, luminance = view.opacity[0, ..., 0], view.shown(bright)[0] @ LUMINANCE
        ratio = (white + _FAINT) / (luminance + _FAINT)
        light = model.brightness * view.wanted(model)[0] @ LUMINANCE
        behind = model.background if photograph.background is None else photograph.background
        values = light * ratio + behind * (1 - white)
        found.append(replace(photograph, values=values.astype(np.float32)))
    return found


def coloured_images(
    extinction: np.ndarray,
    colours: np.ndarray,
    octave: Octave,
    photographs: Sequence[Photograph],
    model: ImageModel,
    quadrature: str,
) -> list[np.ndarray]:
    """What is seen of smoke in colour through the cameras of photographs: (rows, columns, 3), in the model's units."""
    found = []
    for photograph in photographs:
        view = _alone(photograph, extinction, octave, quadrature)
        found.append((model.brightness * view.shown(colours) + view.behind(model))[0])
    return found


class _ViewGroup:
    """Views whose pictures have one size: their cameras, and what is known of their pixels.

    Attributes:
        opacity: (V, rows, columns, 1), what white smoke of brightness 1 shows.
    """

    def __init__(self, extinction: np.ndarray, renderer: ColouredRenderer, photographs: Sequence[Photograph]) -> None:
        self._extinction, self._renderer = mi.TensorXf(extinction), renderer
        self._cameras = [photograph.camera for photograph in photographs]
        self._photographs = photographs
        self.opacity = renderer.images(self._extinction, self._cameras, (0,)).numpy()[..., None]
        self.weights = np.stack([one.weights for one in photographs])[..., None]

    def shown(self, colours: np.ndarray) -> np.ndarray:
        """Σ w_k c_k, (V, rows, columns, 3)."""
        return self._renderer.colour_images(self._extinction, mi.TensorXf(colours), self._cameras).numpy()

    def spread(self, images: np.ndarray) -> np.ndarray:
        """Its adjoint, (D, H, W, 3)."""
        gradient = mi.TensorXf(np.ascontiguousarray(np.broadcast_to(images, (*images.shape[:3], 3)), np.float32))
        white = mi.TensorXf(np.ones((*self._extinction.shape, 3), np.float32))
        # What the views show matters to derivatives with respect to the extinction alone.
        found = self._renderer.colour_gradient(
            self._extinction, white, self._cameras, (False, True), gradient, gradient
        )
        return found[1].numpy()

    def behind(self, model: ImageModel) -> np.ndarray:
        """The light from behind the smoke that gets through it."""
        known = [photograph.background_colours for photograph in self._photographs]
        images = [np.float32(model.background) if image is None else image for image in known]
        return np.stack([image * (1 - white) for image, white in zip(images, self.opacity, strict=True)])

    def wanted(self, model: ImageModel) -> np.ndarray:
        """What Σ w_k c_k has to be for the pictures to be right."""
        pictures = np.stack([one.colours for one in self._photographs if one.colours is not None])
        return ((pictures - self.behind(model)) / model.brightness).astype(np.float32)


class _ColourProblem:
    """The linear problem on one grid.

    Args:
        extinction: (D, H, W) of the grid, per full-resolution cell.
        octave: the grid.
        photographs: averaged for it.
        model: of their light.
        quadrature: of emission and absorption.
        subsets: into how many parts the views are divided.
    """

    def __init__(
        self,
        extinction: np.ndarray,
        octave: Octave,
        photographs: Sequence[Photograph],
        model: ImageModel,
        quadrature: str,
        subsets: int,
    ) -> None:
        self._model = model
        # Neighbours, who see nearly the same, are in different subsets.
        self._subsets = [
            [
                _ViewGroup(extinction, _renderer(octave, quadrature, size), list(members))
                for size, members in groupby(sorted(photographs[first::subsets], key=_size), key=_size)
            ]
            for first in range(subsets)
        ]
        groups = [group for subset in self._subsets for group in subset]
        spread = [group.spread(group.weights * group.opacity)[..., :1] for group in groups]
        self._curvature = np.sum(spread, axis=0)
        smoke = extinction > _EMPTY * extinction.max()
        typical = float(self._curvature[smoke].mean()) if smoke.any() else 0.0
        self._λ = np.float32(_SMOOTHNESS * typical or 1.0)
        self._neighbours = _neighbour_sums(np.ones((*extinction.shape, 1), np.float32))
        opacity = sum(float((group.weights * group.opacity).sum()) for group in groups)
        light = sum((group.weights * group.wanted(model)).sum(axis=(0, 1, 2), dtype=np.float64) for group in groups)
        self.mean_colour = np.maximum(light / opacity, 0) if opacity > 0 else np.ones(3)

    def improved(self, colours: np.ndarray, step: int) -> np.ndarray:
        """The colours after one more step."""
        gradient = np.zeros_like(colours)
        for group in self._subsets[step % len(self._subsets)]:
            gradient += group.spread(group.weights * (group.shown(colours) - group.wanted(self._model)))
        gradient *= len(self._subsets)
        gradient += self._λ * (self._neighbours * colours - _neighbour_sums(colours))
        return np.maximum(colours - gradient / (self._curvature + 2 * self._λ * self._neighbours), 0)


def _neighbour_sums(field: np.ndarray) -> np.ndarray:
    """The sum over the up to six neighbours of each cell of a field (D, H, W, C)."""
    total = np.zeros_like(field)
    for axis in range(3):
        low, high = [slice(None)] * 3, [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        total[tuple(low)] += field[tuple(high)]
        total[tuple(high)] += field[tuple(low)]
    return total


def _renderer(octave: Octave, quadrature: str, size: tuple[int, int]) -> ColouredRenderer:
    return ColouredRenderer(octave.shape, 1.0, quadrature, octave.cell_size, sample_distance(quadrature), size)


def _alone(photograph: Photograph, extinction: np.ndarray, octave: Octave, quadrature: str) -> _ViewGroup:
    """A group of one view."""
    return _ViewGroup(extinction, _renderer(octave, quadrature, _size(photograph)), [photograph])


def _size(photograph: Photograph) -> tuple[int, int]:
    rows, columns = photograph.values.shape
    return rows, columns
