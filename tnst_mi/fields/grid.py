"""Cell-centred grids: the sizes of their octaves, and the coordinates and storage indices of their cells.

Grids are stored as tensors of shape (D, H, W) or (D, H, W, C), that is (z, y, x[, channel]).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from tnst_mi.errors import InputError
from tnst_mi.fields.kernels import Divisor, gather, opaque_int, require_indexable

#: (D, H, W): number of cells along z, y and x.
Shape = tuple[int, int, int]


@dataclass(frozen=True)
class Octave:
    """One level of the coarse-to-fine optimisation: its shape (D, H, W) and its cell size in full-resolution cells."""

    shape: Shape
    cell_size: float


def octaves(shape: Sequence[int], count: int, factor: float = 1.8) -> list[Octave]:
    """Sizes of the octaves from the coarsest to the full grid: int(N / factor), applied repeatedly.

    The cell size is H / H_octave on every axis; all octaves share the centre of the full grid.
    An axis never falls below one cell.
    """
    if count < 1 or factor <= 1.0:
        raise InputError(f"octaves: count {count} and factor {factor} given, expected count >= 1 and factor > 1")
    d, h, w = (int(n) for n in shape)
    sizes: list[Shape] = [(d, h, w)]
    for _ in range(count - 1):
        d, h, w = (max(1, int(n / factor)) for n in sizes[-1])
        sizes.append((d, h, w))
    return [Octave(size, shape[1] / size[1]) for size in reversed(sizes)]


@dataclass
class Cells:
    """Integer coordinates of cells of a grid."""

    shape: Shape
    size: mi.Vector3i  # W, H, D as opaque numbers
    x: mi.Int32
    y: mi.Int32
    z: mi.Int32
    #: Storage indices; None for all cells of the grid in storage order.
    chosen: mi.UInt32 | None = None

    @classmethod
    def of(cls, shape: Shape, chosen: mi.UInt32 | None = None) -> Cells:
        """The cells of a (D, H, W) grid with the storage indices `chosen`, or all of them."""
        d, h, w = shape
        require_indexable(d * h * w, "a grid")
        row, x = Divisor(w).split_first(d * h * w) if chosen is None else Divisor(w).split(chosen)
        z, y = Divisor(h).split(row)
        size = mi.Vector3i(*(opaque_int(n) for n in (w, h, d)))
        return cls(shape, size, mi.Int32(x), mi.Int32(y), mi.Int32(z), chosen)

    @property
    def number(self) -> mi.UInt32:
        """Storage index of every cell."""
        return dr.arange(mi.UInt32, math.prod(self.shape)) if self.chosen is None else self.chosen

    def own(self, values: mi.Float, channels: int = 1) -> list[mi.Float]:
        """All channels of `values` at these cells."""
        return [values] if channels == 1 and self.chosen is None else gather(values, self.number, channels)

    def index(self, x: mi.Int32, y: mi.Int32, z: mi.Int32) -> mi.UInt32:
        """Storage index of cell (x, y, z), which must lie inside the grid."""
        return mi.UInt32(dr.fma(dr.fma(z, self.size.y, y), self.size.x, x))
