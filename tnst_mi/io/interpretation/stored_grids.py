"""Grids beside the density, as their files hold them: in the axes of the file, and read when they are needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from tnst_mi.geometry.other_grids import OtherGrid
from tnst_mi.io.interpretation.orientation import from_z_up, mirrored, to_z_up
from tnst_mi.machine.gate import gate


@dataclass(frozen=True)
class Axes:
    """The axes of a file.

    Attributes:
        up: the one that points up, "y" or "z".
        flip: our axes that are mirrored once y is up, any of "x", "y" and "z".
    """

    up: str = "y"
    flip: str = ""

    def turned(self, array: np.ndarray, directed: bool = True) -> np.ndarray:
        """A grid of the file, (Z, Y, X) or (Z, Y, X, 3), in our axes.

        Args:
            array: the grid.
            directed: whether the components of vectors are directions, which turn too, unlike those of colours.
        """
        return self._by_channel(self._turned, array, directed)

    def turned_back(self, array: np.ndarray, directed: bool = True) -> np.ndarray:
        """Undo `turned`."""
        return self._by_channel(self._turned_back, array, directed)

    def _turned(self, array: np.ndarray) -> np.ndarray:
        array = from_z_up(array) if self.up == "z" else array
        return mirrored(array, self.flip) if self.flip else array

    def _turned_back(self, array: np.ndarray) -> np.ndarray:
        array = mirrored(array, self.flip) if self.flip else array
        return to_z_up(array) if self.up == "z" else array

    def _by_channel(self, turn: Callable[[np.ndarray], np.ndarray], array: np.ndarray, directed: bool) -> np.ndarray:
        # A direction has a sign: numbers without one are something else.
        if array.ndim == 3 or (directed and array.dtype.kind not in "ub"):
            return turn(array)
        return np.stack([turn(array[..., channel]) for channel in range(array.shape[-1])], axis=-1)


@dataclass(frozen=True)
class StoredGrid:
    """A grid of a file.

    Attributes:
        path: the file.
        read: reads it at the cells of the frame, in the axes of the file.
        directed: whether the components of its vectors, if it has any, are directions.
    """

    path: Path
    read: Callable[[], OtherGrid]
    directed: bool = True

    def reader(self, axes: Axes) -> Callable[[], OtherGrid]:
        """What reads it in our axes."""
        return partial(_read, self, axes)


def _read(stored: StoredGrid, axes: Axes) -> OtherGrid:
    with gate(stored.path, f"a {stored.path.suffix.lower()} file"):
        grid = stored.read()
    outside = grid.outside
    if outside.shape:
        outside = axes.turned(outside.reshape(1, 1, 1, -1), stored.directed).reshape(-1)
    return replace(grid, values=axes.turned(grid.values, stored.directed), outside=outside)
