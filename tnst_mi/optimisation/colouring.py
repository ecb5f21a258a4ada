"""Colours that are optimised together with what moves the smoke: a change of the display values in every cell.

A colour belongs to a place in the stylized smoke, not to the smoke that is moved there: c = start + change, in [0, 1].
Steps of a sequence are transported and averaged over its window like those of potentials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.grid import Octave
from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.pyramid import gaussian
from tnst_mi.fields.resampling import resample_potential, resample_velocity
from tnst_mi.frame import Frame
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.losses.objective import Objective
from tnst_mi.losses.palette import Palette
from tnst_mi.losses.style import Style
from tnst_mi.optimisation.parameterisation import Fields, Parameterisation, Pullback
from tnst_mi.rendering.smoke_colour import colours_of

#: The name of the field.
COLOUR = "colour"

#: Gradients below this are none: on a GPU, quotients of smaller numbers may not be finite.
_SMALLEST = 1e-30


class Coloured(Parameterisation):
    """The density of another parameterisation, and a change of the colour.

    Args:
        of_density: how the density depends on its fields.
    """

    def __init__(self, of_density: Parameterisation) -> None:
        self._of_density = of_density
        self.channels = {**of_density.channels, COLOUR: 3}
        self.largest_derivative = of_density.largest_derivative

    @property
    def of_density(self) -> Parameterisation:
        """How the density depends on its fields."""
        return self._of_density

    def carried(self, fields: Fields, source: Octave, target: Octave) -> Fields:
        """Fields of one octave, resampled to the grid of another."""
        change = resample_potential(fields[COLOUR], source.cell_size, target.shape, target.cell_size)
        return Fields({**self._of_density.carried(_of_density(fields), source, target), COLOUR: change})

    def rescaled(self, fields: Fields, factor: float) -> Fields:
        """The fields that change densities times `factor` alike."""
        return Fields({**self._of_density.rescaled(_of_density(fields), factor), COLOUR: fields[COLOUR]})

    def within(self, fields: Fields, reach: float | mi.TensorXf, h: float) -> Fields:
        """The fields, scaled down if they move smoke farther than `reach`; colours do not move."""
        return Fields({**self._of_density.within(_of_density(fields), reach, h), COLOUR: fields[COLOUR]})

    def density(self, fields: Fields, density: mi.TensorXf, h: float) -> mi.TensorXf:
        """The stylized density."""
        return self._of_density.density(_of_density(fields), density, h)

    def density_with_pullback(self, fields: Fields, density: mi.TensorXf, h: float) -> tuple[mi.TensorXf, Pullback]:
        """The stylized density, and the pull-back of its derivatives onto the fields without the colour."""
        return self._of_density.density_with_pullback(_of_density(fields), density, h)

    def unit_step(self, rows: int, h: float) -> float:
        """Change of the density's fields where η · mask · N(g) is 1."""
        return self._of_density.unit_step(rows, h)


def colour_step(gradient: mi.TensorXf, region: mi.TensorXf | None, size: float, smoothness: float) -> mi.TensorXf:
    """size · region · g / (‖g‖ + mean ‖g‖): what to subtract from colours, by at most `size`.

    g is the blurred gradient of a cell, and the mean that over all cells that have one. Potentials have steps whose
    bands are as large at any scale; colours would then be thrown from one end of their range to the other in the few
    cells that smoke has. In this way, those that are hardly seen keep the colours that they have.

    Args:
        gradient: (D, H, W, 3).
        region: (D, H, W) in [0, 1]; None for everywhere. There is no mask of the smoke: where it is thin, its colour
            matters as little as it is seen.
        size: largest change.
        smoothness: width of the blur in cells.
    """
    g = dr.unravel(mi.Vector3f, gaussian(gradient, smoothness).array)
    length = dr.norm(g)
    count = dr.sum(dr.select(length > 0, mi.Float(1), 0))
    mean = dr.sum(length) / dr.maximum(count, 1)
    share = dr.select(length > 0, opaque(size) / dr.maximum(length + mean, opaque(_SMALLEST)), 0)
    if region is not None:
        share = share * region.array
    step = mi.TensorXf(dr.ravel(share * g), tuple(gradient.shape))
    dr.eval(step)
    return step


def _of_density(fields: Fields) -> Fields:
    return Fields({name: field for name, field in fields.items() if name != COLOUR})


def in_gamut(fields: Fields, start: mi.TensorXf) -> Fields:
    """The fields, with a change of the colour that leaves none of the display values outside of [0, 1]."""
    change = dr.clip(fields[COLOUR].array, -start.array, 1 - start.array)
    return Fields({**fields, COLOUR: mi.TensorXf(change, tuple(start.shape))})


@dataclass(frozen=True)
class Colours:
    """The colours with which a run begins.

    Attributes:
        grid: the name of the grid of the input that has them; None if it has none, or is not to be used.
        means: for each frame, the mean colour (3,) of its style pictures, display values, where there is no such grid.
    """

    grid: str | None
    means: tuple[tuple[float, float, float], ...]

    def start(self, frame: int, source: Frame) -> np.ndarray:
        """The colours (D, H, W, 3) of a frame, display values in [0, 1]."""
        if self.grid is not None and self.grid in source.grids:
            return np.clip(srgb(colours_of(source.grids, self.grid, source.name)), 0, 1)
        return np.broadcast_to(np.array(self.means[frame], np.float32), (*source.density.shape, 3))


def mean_colour(objectives: Sequence[Objective], weights: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """The mean colour of the style pictures of all targets, display values, by the weights of their terms."""
    pairs = [
        (weight, term.picture.mean_colour)
        for objective, of_terms in zip(objectives, weights, strict=True)
        for weight, (_, term) in zip(of_terms, objective.weighted_terms, strict=True)
        if isinstance(term, Style | Palette)
    ]
    means, of_each = np.array([mean for _, mean in pairs], np.float64), np.array([weight for weight, _ in pairs])
    red, green, blue = (of_each @ means / of_each.sum()).tolist()
    return red, green, blue


def on_octave(colours: np.ndarray, octave: Octave) -> mi.TensorXf:
    """Colours (D, H, W, 3) of the full grid on that of an octave: means of what is inside the grid."""
    return resample_velocity(mi.TensorXf(np.ascontiguousarray(colours)), 1.0, octave.shape, octave.cell_size)


def final_colour(start: np.ndarray, change: mi.TensorXf, blend: float, solid: np.ndarray | None) -> np.ndarray:
    """The colours (D, H, W, 3) of a result, display values in [0, 1]: those of solids stay as they were."""
    changed = np.clip(start + (change * opaque(blend)).numpy(), 0, 1)
    return changed if solid is None else np.where(solid[..., None], start, changed)
