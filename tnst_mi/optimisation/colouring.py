"""Colours that are optimised together with what moves the smoke: a change of the display values in every cell.

c = start + change, in [0, 1]. The change belongs to a place in the stylized smoke. The start is the mean colour of the
pictures, or the colour that the input has, which moves with the smoke. Steps of a sequence are transported and averaged
over its window like those of potentials.
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
from tnst_mi.optimisation.parameterisation import Fields, Parameterisation, Pullback, Transport
from tnst_mi.rendering.smoke_colour import colour_name, colours_of

#: The name of the field.
COLOUR = "colour"

#: Gradients below this are none: on a GPU, quotients of smaller numbers may not be finite.
_SMALLEST = 1e-30

#: Colours that leave [0, 1] by no more are at its end, but for rounding.
_ROUNDING = 1e-6


class Coloured(Parameterisation):
    """The density of another parameterisation, and a change of the colour.

    Args:
        of_density: how the density depends on its fields.
        moves: whether the colours with which it begins move with the smoke.
    """

    def __init__(self, of_density: Parameterisation, moves: bool = False) -> None:
        self._of_density = of_density
        self._moves = moves and isinstance(of_density, Transport)
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

    def colour_with_pullback(
        self, fields: Fields, start: mi.TensorXf, h: float, followed: bool = True
    ) -> tuple[mi.TensorXf, ColourPullback]:
        """The colours (D, H, W, 3), display values, detached, and the pull-back of their derivatives onto the fields.

        Args:
            fields: on a grid.
            start: the colours with which the smoke begins, (D, H, W, 3) likewise.
            h: size of a cell.
            followed: whether what moves the smoke follows derivatives of the colours that move with it.
        """
        if not self._moves or not isinstance(self._of_density, Transport):
            return dr.detach(start + fields[COLOUR]), ColourPullback(None, None)
        leaves = _of_density(fields).attached() if followed else _of_density(fields)
        moved = self._of_density.colour(leaves, start, h)
        sum_ = dr.detach(moved) + fields[COLOUR]
        inside = (sum_.array >= -_ROUNDING) & (sum_.array <= 1 + _ROUNDING)
        colour = mi.TensorXf(dr.clip(sum_.array, 0, 1), tuple(start.shape))
        return colour, ColourPullback(inside, Pullback(leaves, moved) if followed else None)

    def in_gamut(self, fields: Fields, start: mi.TensorXf, h: float) -> Fields:
        """The fields, with a change of the colour that leaves none of the display values outside of [0, 1]."""
        if self._moves and isinstance(self._of_density, Transport):
            with dr.suspend_grad():
                start = self._of_density.colour(_of_density(fields), start, h)
        change = dr.clip(fields[COLOUR].array, -start.array, 1 - start.array)
        return Fields({**fields, COLOUR: mi.TensorXf(change, tuple(start.shape))})

    def unit_step(self, rows: int, h: float) -> float:
        """Change of the density's fields where η · mask · N(g) is 1."""
        return self._of_density.unit_step(rows, h)


class ColourPullback:
    """The adjoint of the map from fields to colours, at one point.

    It can be called until the `last` call, which releases its memory.

    Args:
        inside: of each component, whether it is a display value as it is; others are cut to [0, 1], and follow
            nothing. None if all are.
        of_start: the adjoint of the colours with which the smoke begins; None if they do not move with it.
    """

    def __init__(self, inside: mi.Bool | None, of_start: Pullback | None) -> None:
        self._inside, self._of_start = inside, of_start

    def __call__(self, gradient: mi.TensorXf, of_strokes: mi.TensorXf | None, last: bool = True) -> Fields:
        """The derivative with respect to the fields.

        Args:
            gradient: with respect to the colours.
            of_strokes: the part of it that moves smoke too; None for nothing.
            last: whether this is the last call.
        """
        found = Fields({COLOUR: self._within(gradient)})
        if self._of_start is not None and of_strokes is not None:
            found |= self._of_start(self._within(of_strokes), last)
        return found

    def _within(self, gradient: mi.TensorXf) -> mi.TensorXf:
        if self._inside is None:
            return gradient
        return mi.TensorXf(dr.select(self._inside, gradient.array, 0), tuple(gradient.shape))


def colour_step(gradient: mi.TensorXf, region: mi.TensorXf | None, size: float, smoothness: float) -> mi.TensorXf:
    """size · region · g / (‖g‖ + mean ‖g‖): what to subtract from colours, by at most `size`.

    g is the blurred gradient of a cell, and the mean that over all cells that have one. Potentials have steps whose
    bands are as large at any scale; colours would then be thrown from one end of their range to the other in the few
    cells that smoke has. In this way, those that are hardly seen keep the colours that they have.

    Args:
        gradient: (D, H, W, 3).
        region: (D, H, W) in [0, 1]; None for everywhere. It has no mask of the smoke, whose colour matters as little as
            it is seen, unless a window averages over smoke, which takes that mask out again.
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


@dataclass(frozen=True)
class Colours:
    """The colours with which a run begins.

    Attributes:
        names: of the grids of frames that have some, of which the usual one counts; none if there is none.
        written: of the grid of the results.
        means: for each frame, and in it for each target, the mean (3,) of its style pictures, display values, with
            which smoke in its region begins that has no colours.
    """

    names: frozenset[str]
    written: str
    means: tuple[tuple[tuple[float, float, float], ...], ...]

    def grid(self, source: Frame) -> str | None:
        """The name of the grid that has the colours of a frame; None if it has none."""
        return colour_name(name for name in source.grids if name in self.names)

    def unstylized(self, source: Frame) -> np.ndarray:
        """The colours (D, H, W, 3) of a frame, display values in [0, 1]: white, unless it has some."""
        if (name := self.grid(source)) is None:
            return np.ones((*source.density.shape, 3), np.float32)
        return np.clip(srgb(colours_of(source.grids, name, source.name)), 0, 1)

    def start(self, frame: int, source: Frame, masks: Sequence[np.ndarray | None] = ()) -> np.ndarray:
        """Those with which a frame begins, likewise: white smoke has the means of the targets in their regions.

        Args:
            frame: its index.
            source: the frame.
            masks: of the targets, (D, H, W) in [0, 1], None for everywhere; none at all if all are.
        """
        own = self.unstylized(source)
        if self.grid(source) is not None:
            return own
        means = np.array(self.means[frame], np.float32)
        if not any(mask is not None for mask in masks):
            return np.broadcast_to(means.mean(0), own.shape)
        shares = np.stack([np.ones(own.shape[:3], np.float32) if mask is None else mask for mask in masks])
        inside = shares.max(0)[..., None]
        total = np.maximum(shares.sum(0), np.finfo(np.float32).tiny)
        return (1 - inside) * own + inside * np.einsum("tzyx,tc->zyxc", shares / total, means)


def mean_colour(
    objective: Objective, weights: Sequence[float] | None, size: tuple[int, int]
) -> tuple[float, float, float]:
    """The mean colour of the style pictures of a target, display values; white if it has none.

    Args:
        objective: of the target.
        weights: of its terms, by which its pictures count; all alike if none has one.
        size: rows and columns of the images, to which pictures are cropped.
    """
    of_each = np.ones(len(objective.weighted_terms)) if weights is None else np.array(weights)
    pairs = [
        (weight, term.picture.fitted(*size).mean_colour)
        for weight, (_, term) in zip(of_each, objective.weighted_terms, strict=True)
        if isinstance(term, Style | Palette)
    ]
    if not pairs:
        return 1.0, 1.0, 1.0
    shares, means = np.array([weight for weight, _ in pairs]), np.array([mean for _, mean in pairs], np.float64)
    if not shares.any():
        shares = np.ones(len(pairs))
    red, green, blue = (shares @ means / shares.sum()).tolist()
    return red, green, blue


def on_octave(colours: np.ndarray, octave: Octave) -> mi.TensorXf:
    """Colours (D, H, W, 3) of the full grid on that of an octave: means of what is inside the grid."""
    return resample_velocity(mi.TensorXf(np.ascontiguousarray(colours)), 1.0, octave.shape, octave.cell_size)


def final_colour(
    unstylized: np.ndarray, start: np.ndarray, change: mi.TensorXf, share: float, blend: float, solid: np.ndarray | None
) -> np.ndarray:
    """The colours (D, H, W, 3) of a result, display values in [0, 1]: those of solids stay as they were.

    Args:
        unstylized: the colours of the smoke, moved.
        start: those with which it began, moved too.
        change: of these, times the strength of the result.
        share: the strength times `blend`.
        blend: share of the stylized smoke in the result.
        solid: (D, H, W) bool; None without.
    """
    begun = unstylized + np.float32(share) * (start - unstylized)
    changed = np.clip(begun + (change * opaque(blend)).numpy(), 0, 1)
    return changed if solid is None else np.where(solid[..., None], unstylized, changed)
