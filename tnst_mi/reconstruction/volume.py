"""The grid of a reconstruction: cubic cells that fill a box of the cameras' scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.geometry.placement import Placement

#: Cells of a grid at most: what a float32 grid with Adam's moments and its renderings take in 32 GB.
MOST_CELLS = 1 << 28

#: A box may be longer than a whole number of cells by this share of a cell: the last digit of numbers in files.
_ROUNDING = 1e-3


@dataclass(frozen=True)
class GridPlace:
    """A grid and where it lies.

    Attributes:
        shape: (D, H, W), y up.
        placement: in the scene.
    """

    shape: Shape
    placement: Placement


def grid_in_box(box: Sequence[float], cells: int, up: str) -> GridPlace:
    """The grid with so many cells along the longest edge of a box, which grows about its middle to whole cells.

    Args:
        box: two corners in the axes of the scene, six numbers.
        cells: along the longest edge.
        up: which axis of the scene is up, "y" or "z".

    Raises:
        InputError: the grid would have too many cells.

    Example:
        >>> grid_in_box((-1, -1, 0, 1, 1, 3), 6, "z").shape  # the scene's z is up
        (4, 6, 4)
    """
    low, high = np.array(box[:3], np.float64), np.array(box[3:], np.float64)
    size = float((high - low).max()) / cells
    along = [max(1, math.ceil((b - a) / size - _ROUNDING)) for a, b in zip(low, high, strict=True)]
    if math.prod(along) > MOST_CELLS:
        raise InputError(f"cells = {cells}: makes {math.prod(along)} cells, expected at most {MOST_CELLS}; take fewer")
    corner = (low + high) / 2 - size * (np.array(along) - 1) / 2
    x, y, z = along
    shape = (z, y, x) if up == "y" else (y, z, x)
    return GridPlace(shape, Placement(size, (float(corner[0]), float(corner[1]), float(corner[2])), up))
