"""Smoothing and band normalisation of the gradient, which gives every iteration the same small step size.

The Laplacian pyramid (Burt and Adelson 1983) splits a field into bands; each is divided by its root mean square,
so that low frequencies move as much as high ones (paper section 4; reference kernel [1, 4, 6, 4, 1]/16 per axis).

The cost of these filters is in reading neighbours. Adjacent cells share neighbours, so a thread computes a run or a
block of cells and reads each neighbour once. None of this is differentiated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.kernels import Divisor, opaque, opaque_int, require_indexable
from tnst_mi.machine.backend import on_gpu

#: Lower bound of the divisor of a band, so that an empty band stays empty.
FLOOR = 1e-10

#: Spatial axes of (D, H, W) and (D, H, W, C) tensors: channels are never mixed.
_AXES = (0, 1, 2)


class _PerThread(NamedTuple):
    """How much a thread computes. More work shares more reads, but evicts what it reads from a CPU's cache, does not
    fit a GPU's registers, and makes longer code, which takes the host longer to trace.

    Attributes:
        blur, reduction: consecutive results along the axis of the blur and of the reduction.
        expansion: consecutive coarse cells of the interpolation; each becomes two fine cells on every axis.
    """

    blur: int
    reduction: int
    expansion: int


#: Measured: with the CPU's numbers, a GPU's thread would read 54 values of the expansion and write 32.
_ON_CPU, _ON_GPU = _PerThread(8, 4, 4), _PerThread(4, 2, 1)

#: No cell is written twice, so the writes of a thread need no ordering (which would take a kernel for each).
_ONCE = dr.ReduceMode.NoConflicts


def _per_thread() -> _PerThread:
    return _ON_GPU if on_gpu() else _ON_CPU


class _Runs:
    """A pass along one axis: each thread reads a segment of a line of cells and writes `run` cells of the result.

    Args:
        field: (D, H, W) or (D, H, W, C).
        axis: the axis of the pass.
        length: number of cells of the result along the axis.
        run: number of them that a thread computes.
        boundary: "nearest", "reflect" or "zero": rule for reads outside the field, up to `margin` cells from it.
    """

    def __init__(
        self, field: mi.TensorXf, axis: int, length: int, run: int, boundary: str = "nearest", margin: int = 0
    ) -> None:
        shape = list(field.shape)
        self.source, self.source_length, shape[axis] = field.array, shape[axis], length
        self.shape, self.boundary, self.margin = tuple(shape), boundary, margin
        require_indexable(max(dr.width(field.array), math.prod(shape)))
        self.result = dr.empty(mi.Float, math.prod(shape))

        inner, runs = math.prod(shape[axis + 1 :]), -(-length // run)
        row, offset = Divisor(inner).split_first(math.prod(shape[:axis]) * runs * inner)
        outer, number = Divisor(runs).split(row)
        #: Position of the thread's first result along the axis.
        self.first = mi.Int32(number) * run
        self.length, self.last, self.inner = opaque_int(length), opaque_int(self.source_length - 1), opaque_int(inner)
        self.source_start = mi.Int32(outer) * opaque_int(self.source_length * inner) + mi.Int32(offset)
        self.start = mi.Int32(outer) * opaque_int(length * inner) + mi.Int32(offset)

    def read(self, position: mi.Int32) -> mi.Float:
        """The source at a position along the axis."""
        inside: mi.Bool | bool = True
        if self.boundary == "zero":
            inside = (position >= 0) & (position <= self.last)
        elif self.boundary == "reflect":
            # Reflection at both ends is periodic with twice the length.
            period = 2 * self.source_length
            ahead = opaque_int(period * -(-self.margin // period))
            position = mi.Int32(Divisor(period).split(mi.UInt32(position + ahead))[1])
            position = dr.minimum(position, opaque_int(period - 1) - position)
        index = self.source_start + dr.clip(position, 0, self.last) * self.inner
        return dr.gather(mi.Float, self.source, mi.UInt32(index), inside)

    def write(self, values: list[mi.Float]) -> mi.TensorXf:
        """Store the results of each thread; returns the whole field."""
        for step, value in enumerate(values):
            position = self.first + step
            index = mi.UInt32(self.start + position * self.inner)
            dr.scatter(self.result, value, index, position < self.length, _ONCE)
        dr.eval(self.result)
        return mi.TensorXf(self.result, self.shape)


def gaussian(field: mi.TensorXf, sigma: float, boundary: str = "reflect", axes: Sequence[int] = _AXES) -> mi.TensorXf:
    """Gaussian blur along z, y and x, truncated at 4 σ and normalised; channels are blurred separately.

    Args:
        field: (D, H, W) or (D, H, W, C).
        sigma: standard deviation in cells; 0 returns the field.
        boundary: "reflect" (the border cell is duplicated), "nearest", or "zero".
        axes: which of the axes 0, 1 and 2 to blur along.
    """
    if sigma <= 0:
        return field
    radius = math.floor(4 * sigma + 0.5)
    half = [math.exp(-0.5 * (i / sigma) ** 2) for i in range(radius + 1)]
    total = half[0] + 2 * math.fsum(half[1:])
    weights = [opaque(w / total) for w in half]
    for axis in axes:
        field = _blurred(field, axis, weights, boundary)
    return field


def _blurred(field: mi.TensorXf, axis: int, weights: list[mi.Float], boundary: str) -> mi.TensorXf:
    radius = len(weights) - 1
    run = _per_thread().blur
    runs = _Runs(field, axis, field.shape[axis], run, boundary, radius)
    values = [runs.read(runs.first + k) for k in range(-radius, run + radius)]
    return runs.write([_weighted(values[i : i + 2 * radius + 1], weights) for i in range(run)])


def _weighted(values: list[mi.Float], weights: list[mi.Float]) -> mi.Float:
    """Sum of an odd number of values with symmetric weights, given from the middle outwards."""
    middle = len(values) // 2
    total = values[middle] * weights[0]
    for i in range(1, middle + 1):
        total = dr.fma(values[middle - i] + values[middle + i], weights[i], total)
    return total


def reduce(field: mi.TensorXf) -> mi.TensorXf:
    """Blur with [1, 4, 6, 4, 1]/16 and keep every second cell, ⌈n/2⌉ of n, on each spatial axis."""
    for axis in _AXES:
        field = _reduced(field, axis)
    return field


def _reduced(field: mi.TensorXf, axis: int) -> mi.TensorXf:
    weights = [mi.Float(6 / 16), mi.Float(4 / 16), mi.Float(1 / 16)]
    run = _per_thread().reduction
    runs = _Runs(field, axis, (field.shape[axis] + 1) // 2, run)
    values = [runs.read(2 * runs.first + k) for k in range(-2, 2 * run + 1)]
    return runs.write([_weighted(values[2 * i : 2 * i + 5], weights) for i in range(run)])


def _interpolated(values: list) -> list:
    """Twice as many fine values, from coarse ones with a neighbour at either end (constants are preserved)."""
    result = []
    for before, here, after in zip(values, values[1:], values[2:], strict=False):
        result += [(before + 6 * here + after) * (1 / 8), (here + after) * 0.5]
    return result


class _Expansion:
    """A reduced field, interpolated to a fine shape: 2 × 2 × 2 fine cells for each coarse cell of a thread."""

    def __init__(self, coarse: mi.TensorXf, shape: tuple[int, ...]) -> None:
        self.values, channels = coarse.array, math.prod(shape[3:])
        block = _per_thread().expansion
        blocks = [-(-n // 2) for n in shape[:2]] + [-(-shape[2] // (2 * block))]
        rest, channel = Divisor(channels).split_first(math.prod(blocks) * channels)
        rest, x = Divisor(blocks[2]).split(rest)
        z, y = Divisor(blocks[1]).split(rest)
        first = [mi.Int32(z), mi.Int32(y), mi.Int32(x) * block]
        #: By axis, for each coarse cell that the thread reads: its share of the storage index.
        self.coarse: list[list[mi.Int32]] = []
        #: By axis, for each fine cell of the thread: its share of the storage index, and whether it is in the grid.
        self.fine: list[list[tuple[mi.Int32, mi.Bool]]] = []
        for axis, cells in enumerate((1, 1, block)):
            length, fine_length = opaque_int(coarse.shape[axis] - 1), opaque_int(shape[axis])
            stride, fine_stride = (
                opaque_int(math.prod(tuple(lengths[axis + 1 : 3])) * channels) for lengths in (coarse.shape, shape)
            )
            own = mi.Int32(channel) if axis == 2 else 0
            self.coarse.append([dr.clip(first[axis] + i, 0, length) * stride + own for i in range(-1, cells + 1)])
            positions = [2 * first[axis] + i for i in range(2 * cells)]
            self.fine.append([(i * fine_stride + own, i < fine_length) for i in positions])

    def cells(self) -> Iterator[tuple[mi.Float, mi.UInt32, mi.Bool]]:
        """The fine cells of a thread: interpolated value, storage index, and whether the cell lies in the grid."""
        depths, heights, widths = self.coarse
        lines = []
        for z in depths:
            rows = [z + y for y in heights]
            lines.append([_interpolated([self._read(row + x) for x in widths]) for row in rows])
        depths, heights, widths = self.fine
        columns = [[(z + y, in_z & in_y) for z, in_z in depths] for y, in_y in heights]
        for i, (x, in_x) in enumerate(widths):
            planes = [_interpolated([line[i] for line in plane]) for plane in lines]
            for j, column in enumerate(columns):
                values = _interpolated([plane[j] for plane in planes])
                for value, (row, inside) in zip(values, column, strict=True):
                    yield value, mi.UInt32(row + x), inside & in_x

    def _read(self, index: mi.Int32) -> mi.Float:
        return dr.gather(mi.Float, self.values, mi.UInt32(index))


def expand(field: mi.TensorXf, shape: tuple[int, ...]) -> mi.TensorXf:
    """Interpolate a reduced field back to `shape` with the same kernel (constants are preserved)."""
    result = dr.empty(mi.Float, math.prod(shape))
    for value, index, inside in _Expansion(field, shape).cells():
        dr.scatter(result, value, index, inside, _ONCE)
    dr.eval(result)
    return mi.TensorXf(result, shape)


def _band(field: mi.TensorXf, coarse: mi.TensorXf) -> tuple[mi.TensorXf, mi.Float]:
    """The detail that the coarse field lacks, field − expand(coarse), and its root mean square."""
    shape = tuple(field.shape)
    result, squares = dr.empty(mi.Float, math.prod(shape)), mi.Float(0)
    for value, index, inside in _Expansion(coarse, shape).cells():
        difference = dr.gather(mi.Float, field.array, index, inside) - value
        dr.scatter(result, difference, index, inside, _ONCE)
        squares += dr.select(inside, dr.square(difference), 0)
    dr.eval(result, squares)
    return mi.TensorXf(result, shape), dr.sqrt(dr.sum(squares) * (1 / opaque(math.prod(shape))))


def _joined(band: mi.TensorXf, size: mi.Float, coarse: mi.TensorXf) -> mi.TensorXf:
    """band / size + expand(coarse)."""
    shape = tuple(band.shape)
    result, scale = dr.empty(mi.Float, math.prod(shape)), 1 / size
    for value, index, inside in _Expansion(coarse, shape).cells():
        value = dr.fma(dr.gather(mi.Float, band.array, index, inside), scale, value)
        dr.scatter(result, value, index, inside, _ONCE)
    dr.eval(result)
    return mi.TensorXf(result, shape)


def split(field: mi.TensorXf, levels: int) -> list[mi.TensorXf]:
    """Bands from the finest to the coarsest, then the residual: `levels` + 1 tensors."""
    bands = []
    for _ in range(levels):
        coarse = reduce(field)
        bands.append(_band(field, coarse)[0])
        field = coarse
    return [*bands, field]


def merge(bands: list[mi.TensorXf]) -> mi.TensorXf:
    """Inverse of `split`, exact up to rounding."""
    field = bands[-1]
    for band in reversed(bands[:-1]):
        field = _joined(band, opaque(1.0), field)
    return field


def root_mean_square(field: mi.TensorXf) -> mi.Float:
    """Root mean square over all cells and channels, kept on the device."""
    return dr.sqrt(dr.mean(dr.square(field.array)))


def normalise(field: mi.TensorXf, levels: int = 3) -> mi.TensorXf:
    """Divide every band by its root mean square (one number for all channels, floor 1e-10) and merge them.

    Equivalent to the following, in fewer kernels:

        bands = split(field, levels)
        bands = [band / max(root_mean_square(band), FLOOR) for band in bands]
        return merge(bands)

    Args:
        field: gradient (D, H, W) or (D, H, W, 3).
        levels: number of bands besides the residual; 0 normalises the field as a whole.
    """
    bands = []
    for _ in range(levels):
        coarse = reduce(field)
        bands.append(_band(field, coarse))
        field = coarse
    result = mi.TensorXf(field.array / dr.maximum(root_mean_square(field), FLOOR), tuple(field.shape))
    while bands:
        band, size = bands.pop()
        result = _joined(band, dr.maximum(size, FLOOR), result)
    return result
