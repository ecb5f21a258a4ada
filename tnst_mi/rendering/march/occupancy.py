"""Which parts of a grid are not empty: a march skips the rest, which adds nothing to its sums."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.grid import Cells, Shape
from tnst_mi.fields.kernels import gather, opaque_int

_LOG2_EDGE = 2
"""Blocks of 4³ cells. Larger ones contain more empty space, smaller ones no longer fit in the cache."""


class Occupancy:
    """For every block of cells, whether interpolation at a sample in it can be non-zero.

    A sample belongs to the block of its lower cells but also reads the cells above them. So a block counts as occupied
    if it or one of its upper neighbours has a non-zero cell.

    Args:
        values: all channels of every cell of the grid, flat.
        shape: (D, H, W).
        channels: number of channels.
    """

    def __init__(self, values: mi.Float, shape: Shape, channels: int) -> None:
        self.values = values
        planes, rows, columns = (((n - 1) >> _LOG2_EDGE) + 1 for n in shape)
        blocks = (planes, rows, columns)
        self._rows, self._columns = opaque_int(rows), opaque_int(columns)

        cells = Cells.of(shape)
        filled = mi.Bool(False)
        for value in gather(values, dr.arange(mi.UInt32, dr.prod(shape)), channels):
            # NaN counts as filled, too.
            filled |= value != 0
        own = dr.zeros(mi.UInt32, dr.prod(blocks))
        # All threads write the same value.
        dr.scatter(own, mi.UInt32(1), self._block(cells.x, cells.y, cells.z), filled)

        block = Cells.of(blocks)
        pairs = [(i, dr.minimum(i + 1, block.size[axis] - 1)) for axis, i in enumerate((block.x, block.y, block.z))]
        self._flags = mi.UInt32(0)
        for z in pairs[2]:
            for y in pairs[1]:
                for x in pairs[0]:
                    self._flags |= dr.gather(mi.UInt32, own, block.index(x, y, z))
        dr.eval(self._flags)

    def _block(self, x: mi.Int32, y: mi.Int32, z: mi.Int32) -> mi.UInt32:
        row = dr.fma(z >> _LOG2_EDGE, self._rows, y >> _LOG2_EDGE)
        return mi.UInt32(dr.fma(row, self._columns, x >> _LOG2_EDGE))

    def at(self, lower: mi.Vector3i) -> mi.Bool:
        """Whether interpolation between these cells (x, y, z) and the next ones may be non-zero."""
        return dr.gather(mi.UInt32, self._flags, self._block(lower.x, lower.y, lower.z)) != 0
