"""Cell-centred grids: octave sizes, cell indices, the trilinear stencil and a repeatable scatter-add.

Grids are stored as tensors of shape (D, H, W) or (D, H, W, C), that is (z, y, x[, channel]). Positions are
displacements from a cell centre, measured in cells: their fractional part is then exact in float32 however
large the grid is.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from tnst_mi.errors import InputError

#: (D, H, W): number of cells along z, y and x.
Shape = tuple[int, int, int]

#: Displacements are clamped to this many cells, so that they always fit a 32-bit index.
_FARTHEST = float(2**20)


@dataclass(frozen=True)
class Octave:
    """One level of the coarse-to-fine optimisation: its (D, H, W) and its cell size in full-resolution cells."""

    shape: Shape
    cell_size: float


def octaves(shape: Sequence[int], count: int, factor: float = 1.8) -> list[Octave]:
    """Sizes of the octaves from the coarsest to the full grid: int(N / factor), applied repeatedly.

    The cell size is H / H_octave on every axis; all octaves share the centre of the full grid.
    An axis never falls below one cell.
    """
    if count < 1 or factor <= 1.0:
        raise InputError(f"octaves: count {count} and factor {factor} given, expected count >= 1 and factor > 1")
    sizes = [tuple(int(n) for n in shape)]
    for _ in range(count - 1):
        sizes.append(tuple(max(1, int(n / factor)) for n in sizes[-1]))
    return [Octave(size, shape[1] / size[1]) for size in reversed(sizes)]


def opaque(value: float) -> mi.Float:
    """A number that changes between calls, kept out of the generated code so that no kernel is recompiled."""
    return _opaque(mi.Float, value)


def opaque_int(value: int) -> mi.Int32:
    """As `opaque`, for whole numbers."""
    return _opaque(mi.Int32, value)


@functools.lru_cache(maxsize=512)
def _opaque(kind: type, value: float) -> mi.Float | mi.Int32:
    # Creating one costs a memory allocation and a fill; a run uses few different numbers.
    return dr.opaque(kind, value)


class Divisor:
    """Division of indices below 2^30 by a size that is not part of the generated code.

    Vector units have no integer division. A multiplication by a scaled reciprocal is exact here (Granlund and
    Montgomery 1994): with d' = 2d and l = ⌈log2 d'⌉, ⌊n/d⌋ = ⌊2n · (⌊2^(31+l)/d'⌋ + 1) / 2^(31+l)⌋ for 2n < 2^31.
    """

    def __init__(self, size: int) -> None:
        bits = (2 * size - 1).bit_length()
        factor = 2 ** (31 + bits) // (2 * size) + 1
        self.size = opaque_int(size)
        self.factor, self.shift = _opaque(mi.UInt32, factor), _opaque(mi.UInt32, bits - 1)

    def split(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        """Quotient and remainder."""
        quotient = dr.mul_hi(index << 1, self.factor) >> self.shift
        return quotient, index - quotient * mi.UInt32(self.size)


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
        row, x = Divisor(w).split(dr.arange(mi.UInt32, d * h * w) if chosen is None else chosen)
        z, y = Divisor(h).split(row)
        size = mi.Vector3i(*(opaque_int(n) for n in (w, h, d)))
        return cls(shape, size, mi.Int32(x), mi.Int32(y), mi.Int32(z), chosen)

    @property
    def number(self) -> mi.UInt32:
        """Storage index of every cell."""
        return dr.arange(mi.UInt32, math.prod(self.shape)) if self.chosen is None else self.chosen

    def own(self, values: mi.Float, channels: int = 1) -> list[mi.Float]:
        """All channels of the cells themselves."""
        return [values] if channels == 1 and self.chosen is None else gather(values, self.number, channels)

    def index(self, x: mi.Int32, y: mi.Int32, z: mi.Int32) -> mi.UInt32:
        """Storage index of cell (x, y, z), which must lie inside the grid."""
        return mi.UInt32(dr.fma(dr.fma(z, self.size.y, y), self.size.x, x))


def gather(values: mi.Float, index: mi.UInt32, channels: int, active: mi.Bool | bool = True) -> list[mi.Float]:
    """All channels of the cells at `index`; inactive lanes read 0."""
    if channels == 1:
        return [dr.gather(mi.Float, values, index, active)]
    return [dr.gather(mi.Float, values, index * channels + c, active) for c in range(channels)]


def stored(value: mi.Float | mi.Bool) -> mi.Float | mi.Bool:
    """The value as an array in memory, written with the next evaluation, and through the cache.

    On CPUs `dr.eval` itself writes past the cache, and a gather that follows waits until such a write is done. That
    makes a kernel that gathers several times slower (measured: 36 ms instead of 4 for one gather of 3 million floats).
    """
    target = dr.empty(type(value), dr.width(value))
    dr.scatter(target, value, dr.arange(mi.UInt32, dr.width(value)), mode=dr.ReduceMode.NoConflicts)
    return target


class Trilinear:
    """Trilinear interpolation at `cell + offset`: the eight surrounding cells and their weights.

    Args:
        cells: cells that the offsets start from.
        offset: displacement in cells, components (x, y, z).
        outside: "zero" (cells outside the grid hold 0) or "edge" (they repeat the nearest cell).
    """

    def __init__(self, cells: Cells, offset: mi.Vector3f, outside: str) -> None:
        offset = dr.clip(offset, -_FARTHEST, _FARTHEST)
        base = dr.floor(offset)
        self.fraction = offset - base
        steps = mi.Vector3i(base)
        low = (cells.x + steps.x, cells.y + steps.y, cells.z + steps.z)
        #: For each axis, the coordinate of the lower and the upper cell, and whether each lies in the grid.
        coordinates, inside = [], []
        for axis in range(3):
            pair = [low[axis], low[axis] + 1]
            if outside == "edge":
                coordinates.append([dr.clip(i, 0, cells.size[axis] - 1) for i in pair])
                inside.append([mi.Bool(True)] * 2)
            else:
                # Negative coordinates are large without their sign.
                coordinates.append(pair)
                inside.append([mi.UInt32(i) < mi.UInt32(cells.size[axis]) for i in pair])
        self.corners = [
            (
                (a, b, c),
                cells.index(coordinates[0][a], coordinates[1][b], coordinates[2][c]),
                inside[0][a] & inside[1][b] & inside[2][c],
            )
            for c in (0, 1)
            for b in (0, 1)
            for a in (0, 1)
        ]

    def read(self, values: mi.Float, channels: int) -> list[list[mi.Float]]:
        """Values of the eight cells: one list of channels per corner."""
        return [gather(values, index, channels, active) for _, index, active in self.corners]

    def value(self, corners: list[list[mi.Float]]) -> list[mi.Float]:
        """Interpolated value of every channel, from the corner values."""
        x, y, z = self.fraction
        return [
            self._along(z, self._along(y, self._along(x, list(channel))))[0] for channel in zip(*corners, strict=True)
        ]

    def gradient(self, corners: list[list[mi.Float]]) -> list[mi.Vector3f]:
        """Derivative of every channel's interpolated value with respect to the position, per cell."""
        x, y, z = self.fraction
        result = []
        for channel in zip(*corners, strict=True):
            in_x = self._along(x, list(channel))
            in_y = self._along(y, in_x)
            slope_x = self._along(z, self._along(y, self._differences(list(channel))))
            slope_y = self._along(z, self._differences(in_x))
            result.append(mi.Vector3f(*slope_x, *slope_y, *self._differences(in_y)))
        return result

    @staticmethod
    def _differences(values: list[mi.Float]) -> list[mi.Float]:
        """Upper minus lower value of each pair."""
        return [upper - lower for lower, upper in zip(values[::2], values[1::2], strict=True)]

    @staticmethod
    def _along(fraction: mi.Float, values: list[mi.Float]) -> list[mi.Float]:
        """Linear interpolation of each pair: the corners change fastest along x, then along y."""
        pairs = zip(values[::2], values[1::2], strict=True)
        return [dr.fma(fraction, upper - lower, lower) for lower, upper in pairs]

    def splat(self, target: RepeatableSum, values: list[mi.Float]) -> None:
        """Transpose of `value`: add each channel's weighted value to the eight cells; a value of 0 costs nothing."""
        for corner, index, active in self.corners:
            weight = mi.Float(1)
            for axis, upper in enumerate(corner):
                weight *= self.fraction[axis] if upper else 1 - self.fraction[axis]
            for c, value in enumerate(values):
                slot = index if len(values) == 1 else index * len(values) + c
                target.add(slot, weight * value, active & (value != 0))


class RepeatableSum:
    """A scatter-add whose result does not depend on the order of the additions.

    Floating-point atomics add in whatever order the threads arrive and give other bits in every run. Here each
    value is rounded to a multiple of a power of two and added as a 64-bit integer, which is exact. The unit is the
    smallest one for which `count` additions of `bound` cannot overflow: no coarser than 2^-30 of the bound for up to
    2^31 additions to a slot, so finer than float32 for all but the smallest addends.

    Args:
        size: number of slots.
        bound: no value added is larger than this in magnitude (a number on the device, width 1).
        count: no slot receives more values than this.
    """

    def __init__(self, size: int, bound: mi.Float, count: int) -> None:
        self.total = dr.zeros(mi.Int64, size)
        # Clearing the mantissa bits leaves the power of two below the bound; all scalings are then exact.
        # The floor keeps the scale finite in float32.
        exponent = dr.reinterpret_array(mi.UInt32, dr.maximum(bound, 2.0**-60)) & 0x7F800000
        self.unit = dr.reinterpret_array(mi.Float, exponent) * opaque(2.0 ** -(61 - max(count, 1).bit_length()))
        self.scale = dr.rcp(self.unit)

    def add(self, index: mi.UInt32, value: mi.Float, active: mi.Bool | bool = True) -> None:
        """Add `value` to the slot at `index`."""
        dr.scatter_reduce(dr.ReduceOp.Add, self.total, mi.Int64(dr.round(value * self.scale)), index, active)

    def result(self) -> mi.Float:
        """The sums in float32."""
        return mi.Float(self.total) * self.unit

    def at(self, index: mi.UInt32) -> mi.Float:
        """The sums of some slots in float32."""
        return mi.Float(dr.gather(mi.Int64, self.total, index)) * self.unit


def largest_magnitude(values: mi.Float) -> mi.Float:
    """max |values| as a number that stays on the device."""
    return dr.max(dr.abs(values)) if dr.width(values) else mi.Float(0)
