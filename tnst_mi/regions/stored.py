"""Masks that are stored as grids: those of the input, and those in files of their own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.frame import Frame
from tnst_mi.io.files.listing import list_frames
from tnst_mi.io.interpretation.grid_names import listed
from tnst_mi.io.interpretation.layouts import picture_scale
from tnst_mi.io.sequence import FrameFiles, open_frames
from tnst_mi.regions.shapes import ramp


def input_grid(frames: Sequence[Frame], index: int, name: str) -> np.ndarray:
    """A grid of the input by its name, on the grid of the density; integers of 8 and 16 bits as 0 to 1, as in files.

    Raises:
        InputError: the frame has no such grid.
    """
    if isinstance(frames, FrameFiles):
        return frames.grid_on_cells(index, name)
    frame = frames[index]
    if name not in frame.grids:
        there = listed(sorted(frame.grids)) if frame.grids else "none"
        raise InputError(f"{frame.name}: has no grid {name!r}; those beside its density are {there}")
    values = frame.grids[name]
    scale = picture_scale(values.dtype)
    return values if scale is None else values.astype(np.float32) * np.float32(scale)


class MaskFiles:
    """A file with a grid for all frames, or a folder or a pattern with one for each frame, by its number.

    Args:
        path: of the file or the folder, or the pattern.
        name: of the grid in each file; None for what would be read as its density.
        frames: the sequence that the masks are for.
        numbers: of its frames.
    """

    def __init__(
        self, path: str, name: str | None, frames: Sequence[Frame], numbers: Sequence[int | float | None]
    ) -> None:
        self._path, self._name, self._frames, self._numbers = Path(path), name, frames, numbers
        self._one = self._path.is_file()
        listing = None if self._one else list_frames(self._path, None)
        self._files = {} if listing is None else dict(zip(listing.numbers, listing.files, strict=True))

    def at(self, index: int) -> np.ndarray:
        """The grid of a frame.

        Raises:
            InputError: there is none for it, or it cannot be read.
        """
        number = self._numbers[index]
        file = self._path if self._one else self._files.get(number)
        if file is None:
            raise InputError(f"{self._path}: has no mask for frame {number}; one file is for all frames")
        if isinstance(self._frames, FrameFiles):
            return self._frames.grid_on_cells(index, self._name, file)
        return open_frames(file).grid_on_cells(0, self._name)


def checked_grid(values: np.ndarray, shape: Shape, name: str, bounds: tuple[float, float] | None = None) -> np.ndarray:
    """A grid as a mask (D, H, W).

    Args:
        values: of the grid.
        shape: (D, H, W) of the density.
        name: of the grid, for messages.
        bounds: the values that become 0 and 1, between which it is linear and beyond which it is clipped; None takes
            the values as they are, and what exceeds 1 as 1.

    Raises:
        InputError: it has another shape, values that are not finite, or negative ones without bounds.
    """
    if values.shape == (*shape, 3):
        raise InputError(f"{name}: holds vectors, expected one number for each cell")
    if values.shape != tuple(shape):
        raise InputError(f"{name}: has shape {values.shape}, expected {tuple(shape)} like the density")
    if bad := int((~np.isfinite(values)).sum()):
        raise InputError(f"{name}: has {bad} values that are not finite, expected values from 0 to 1")
    if bounds is not None:
        return ramp("range", values, *bounds).astype(np.float32)
    if values.min() < 0:
        raise InputError(
            f"{name}: has negative values (smallest {values.min():g}), expected values from 0 to 1; "
            f"{suggested_range(values.min(), values.max())}"
        )
    return np.minimum(values, 1).astype(np.float32)


def suggested_range(least: float, largest: float) -> str:
    """What to add to the table of a mask whose grid has other values than those from 0 to 1."""
    if least == largest:
        least, largest = sorted((0.0, least))
    return f"range = [{least:.4g}, {largest:.4g}] maps what it has to 0 to 1"
