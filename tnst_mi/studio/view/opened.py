"""What the studio shows: the frames of an input, or of a run before and after, in a bounded part of the memory."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mitsuba as mi
import numpy as np

from tnst_mi.fields.density_unit import ReferenceDensity, scaled
from tnst_mi.fields.grid import Shape
from tnst_mi.frame import Frame
from tnst_mi.io.formats import FORMATS
from tnst_mi.machine.environment import free_memory
from tnst_mi.machine.turns import turn
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.smoke_colour import colour_name, own_colours
from tnst_mi.run.reopened import Reopened, reopened
from tnst_mi.run.stored_arrays import StoredArrays
from tnst_mi.studio.source import among_all_frames, stylized_frames

#: Sides of a frame: as it came, and stylized.
BEFORE, AFTER = "before", "after"

#: Cells of the grid that is rendered while the camera moves, at most.
_COARSE_CELLS = 1 << 20

#: Of the largest density, what cells without smoke count for in the colours of the coarser grid.
_FAINT = 1e-6

#: Part of the free memory that frames may take.
_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class ShownGrid:
    """Smoke that is rendered, in the unit of the run.

    Attributes:
        density: (D, H, W) float32.
        tensor: the same on the device.
        h: size of a cell in full-resolution cells, 1 or more.
        colour: display values (D, H, W, 3) float32; None for grey smoke.
        tint: the same on the device.
    """

    density: np.ndarray
    tensor: mi.TensorXf
    h: float
    colour: np.ndarray | None = None
    tint: mi.TensorXf | None = None


@dataclass(frozen=True, eq=False)
class GridPair:
    """One side of a frame: its full grid, and a coarser one of large grids for while the camera moves."""

    full: ShownGrid
    coarse: ShownGrid


@dataclass(frozen=True, eq=False)
class Opened:
    """An input or a run.

    Attributes:
        results: what the path holds.
        recipe: of the run; None of an input.
        shape: (D, H, W) of the frames.
        density_scale: factor from their densities to those that γ and looks mean.
        size_limit: bytes that frames in memory may take, but for the latest one.
        coloured: whether smoke is shown in colour, by what one of the frames has.
    """

    results: Reopened
    recipe: Recipe | None
    shape: Shape
    density_scale: float
    size_limit: int
    coloured: bool = False
    _frames: OrderedDict[tuple[str, int], GridPair] = field(default_factory=OrderedDict)
    _reading: threading.RLock = field(default_factory=threading.RLock)

    @property
    def has_after(self) -> bool:
        """Whether there is something before, and something after."""
        return self.results.record is not None and self.results.inputs is not None

    def frame(self, side: str, index: int) -> GridPair:
        """One side of a frame; of an input, both are the same.

        Raises:
            InputError: its file cannot be read, or is on another grid.
        """
        key = (side if self.has_after else BEFORE), index
        with self._reading:
            if key in self._frames:
                self._frames.move_to_end(key)
                return self._frames[key]
            frame = self._source(key[0])[index]
            shown = _shown(scaled(frame.density, self.density_scale), self._colour(frame))
            self._frames[key] = shown
            while len(self._frames) > 1 and sum(_bytes(frame) for frame in self._frames.values()) > self.size_limit:
                self._frames.popitem(last=False)
            return shown

    def exposure(self, index: int) -> float | None:
        """By how much a run has multiplied the emission–absorption images of a frame for the network.

        None of an input, of a frame that the run has not got to, of a damaged record, and of a run whose images were
        path traced.
        """
        record = self.results.record
        if record is None or self.recipe is None or self.recipe.integrator != "emission_absorption":
            return None
        name = self.results.names[index]
        of_frame = next((frame.get("exposure") for frame in record["frames"] if frame.get("name") == name), None)
        if isinstance(of_frame, int | float) and math.isfinite(of_frame) and of_frame > 0:
            return float(of_frame)
        return None

    def velocity(self, index: int) -> np.ndarray:
        """v* of a frame of a run, (D, H, W, 3) float32, in cells.

        Raises:
            InputError: its file cannot be read.
        """
        results = self.results
        suffix = f".{(results.record or {}).get('format', FORMATS[0][1:])}"
        arrays = StoredArrays(results.path, "velocity", results.names, suffix, results.inputs or ())
        return arrays[index]

    def _colour(self, frame: Frame) -> np.ndarray | None:
        """The colours of a frame as they are shown: those of the run's pictures, or else its own."""
        if self.recipe is None or self.recipe.colour == "off":
            return own_colours(frame)
        return self.results.colour(frame)

    def _source(self, side: str) -> Sequence[Frame]:
        before = self.results.inputs if self.has_after else None
        return self.results.frames if side == AFTER or before is None else before


def opened(path: Path, all_frames: bool = False) -> Opened:
    """Open densities or the folder of a run, finished or not.

    Args:
        path: where they are.
        all_frames: whether to show a run among all frames of its input, if that can be read.

    Raises:
        InputError: nothing is there that can be shown.
    """
    results = among_all_frames(reopened(path)) if all_frames else reopened(path)
    record = results.record
    # Of frames that the run has not stylized, those of the input, one may be damaged.
    stylized = stylized_frames(results)
    middle = results.frames[stylized[len(stylized) // 2]]
    if record is None:
        reference = ReferenceDensity()
        reference.add(middle.density)
        factor = reference.scale()
    else:
        factor = float(record["density_scale"])
    d, h, w = middle.density.shape
    coloured = colour_name(middle.grids) is not None or results.temperature is not None
    return Opened(results, results.recipe, (d, h, w), factor, int(_SHARE * free_memory()), coloured)


def _shown(density: np.ndarray, colour: np.ndarray | None) -> GridPair:
    full = _shown_grid(density, 1.0, colour)
    factor = 1
    while density.size > _COARSE_CELLS * factor**3:
        factor *= 2
    if factor == 1:
        return GridPair(full, full)
    mean = pooled(density, factor)
    if colour is not None:
        # Colours count by their smoke, since those beyond it are not seen; without any, by its cells alike.
        weights = density + np.float32(_FAINT) * max(float(density.max()), np.finfo(np.float32).tiny)
        total = pooled(weights, factor)
        colour = np.stack([pooled(weights * colour[..., i], factor) / total for i in range(3)], axis=-1)
    return GridPair(full, _shown_grid(mean, float(factor), colour))


def _shown_grid(density: np.ndarray, h: float, colour: np.ndarray | None) -> ShownGrid:
    with turn():
        return ShownGrid(density, mi.TensorXf(density), h, colour, None if colour is None else mi.TensorXf(colour))


def pooled(density: np.ndarray, factor: int) -> np.ndarray:
    """The means over cubes of cells; those at the ends are filled up with nothing, evenly on both sides."""
    missing = [-n % factor for n in density.shape]
    padded = np.pad(density, [(n // 2, n - n // 2) for n in missing])
    d, h, w = (n // factor for n in padded.shape)
    return padded.reshape(d, factor, h, factor, w, factor).mean((1, 3, 5), dtype=np.float32)


def _bytes(frame: GridPair) -> int:
    # Of each grid one copy is on the host, and one on the device.
    grids = (frame.full,) if frame.coarse is frame.full else (frame.full, frame.coarse)
    return 2 * sum(grid.density.nbytes + (0 if grid.colour is None else grid.colour.nbytes) for grid in grids)
