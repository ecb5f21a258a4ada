"""Trilinear interpolation and its transpose: the eight cells around a position, and their weights.

`Trilinear` takes displacements from cell centres, measured in cells: their fractional part is exact in float32 for a
grid of any size. `ClampedStencil` takes arbitrary positions.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.grid import Cells, Shape
from tnst_mi.fields.kernels import gather, opaque, opaque_int
from tnst_mi.fields.sums import RepeatableSum

#: Displacements are clamped to this many cells, so that they always fit a 32-bit index.
_FARTHEST = float(2**20)


class Trilinear:
    """Trilinear interpolation at `cell + offset`: the eight surrounding cells and their weights.

    Args:
        cells: the cells from whose centres the offsets start.
        offset: displacement in cells, components (x, y, z).
        outside: "zero" (cells outside the grid hold 0) or "edge" (they repeat the nearest cell).
    """

    def __init__(self, cells: Cells, offset: mi.Vector3f, outside: str) -> None:
        offset = dr.clip(offset, -_FARTHEST, _FARTHEST)
        base = dr.floor(offset)
        self.fraction = offset - base
        #: From the cell to the lowest of the eight.
        self.steps = mi.Vector3i(base)
        low = (cells.x + self.steps.x, cells.y + self.steps.y, cells.z + self.steps.z)
        #: For each axis, the coordinate of the lower and the upper cell, and whether each lies in the grid.
        coordinates, inside = [], []
        for axis in range(3):
            pair = [low[axis], low[axis] + 1]
            if outside == "edge":
                coordinates.append([dr.clip(i, 0, cells.size[axis] - 1) for i in pair])
                inside.append([mi.Bool(True)] * 2)
            else:
                # Reinterpreted as unsigned, negative coordinates are large.
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

    def shares(self, values: list[mi.Float]) -> list[list[mi.Float]]:
        """Transpose of `value`: what each of the eight cells gets of every channel's value."""
        result = []
        for corner, _, _ in self.corners:
            weight = mi.Float(1)
            for axis, upper in enumerate(corner):
                weight *= self.fraction[axis] if upper else 1 - self.fraction[axis]
            result.append([weight * value for value in values])
        return result

    def add(self, target: RepeatableSum, shares: list[list[mi.Float]], active: mi.Bool | bool = True) -> None:
        """Add such shares to the eight cells; zeros cost nothing."""
        for (_, index, inside), values in zip(self.corners, shares, strict=True):
            for c, value in enumerate(values):
                slot = index if len(values) == 1 else index * len(values) + c
                target.add(slot, value, inside & active & (value != 0))

    def splat(self, target: RepeatableSum, values: list[mi.Float]) -> None:
        """Add the shares of every channel's value to the eight cells."""
        self.add(target, self.shares(values))


def larger(a: mi.Float, b: mi.Float | float) -> mi.Float:
    """The larger of two numbers, neither of them NaN: a single instruction, unlike `dr.maximum`."""
    return dr.select(a > b, a, b)


def smaller(a: mi.Float, b: mi.Float | float) -> mi.Float:
    """The smaller of two numbers, as in `larger`."""
    return dr.select(a < b, a, b)


class ClampedStencil:
    """Trilinear interpolation in a grid that repeats its outermost cells, as gridvolume does inside its box.

    Args:
        shape: (D, H, W).
        position: (x, y, z) in cells from the centre of cell 0.

    Attributes:
        position: as given.
        lower: the cell with the lowest indices among the eight around the position.
    """

    def __init__(self, shape: Shape, position: mi.Vector3f) -> None:
        d, h, w = shape
        self.position = position
        # Stay inside the grid along every axis; along an axis of a single cell, both cells are the same.
        lower, fraction = [], []
        for x, n in zip(position, (w, h, d), strict=True):
            clamped = smaller(larger(x, 0), opaque(n - 1))
            lower.append(dr.minimum(mi.Int32(clamped), opaque_int(max(n - 2, 0))))
            fraction.append(clamped - mi.Float(lower[-1]))
        self.lower, self.fraction = mi.Vector3i(*lower), mi.Vector3f(*fraction)
        index = mi.UInt32(dr.fma(dr.fma(lower[2], opaque_int(h), lower[1]), opaque_int(w), lower[0]))
        to_next = [opaque_int(stride if n > 1 else 0) for stride, n in ((1, w), (w, h), (w * h, d))]
        x, y, z = (mi.UInt32(stride) for stride in to_next)
        #: Storage indices of the eight cells; x changes fastest.
        self.indices = [k + i for k in (index, index + y, index + z, index + z + y) for i in (0, x)]

    def read(self, values: mi.Float, channels: int) -> list[list[mi.Float]]:
        """Values of the eight cells: one list of channels per cell."""
        return [gather(values, index, channels) for index in self.indices]

    def value(self, corners: list[list[mi.Float]]) -> list[mi.Float]:
        """Interpolated value of every channel, from the values of the eight cells."""
        for t in self.fraction:
            corners = [
                [dr.fma(b - a, t, a) for a, b in zip(low, high, strict=True)]
                for low, high in zip(corners[::2], corners[1::2], strict=True)
            ]
        return corners[0]

    def splat(self, target: RepeatableSum, value: mi.Float | mi.Color3f) -> None:
        """Transpose of `value`: add each channel's weighted value to the eight cells."""
        values = [value] if isinstance(value, mi.Float) else list(value)
        weights = [mi.Float(1)]
        for t in reversed(self.fraction):
            weights = [weight * factor for weight in weights for factor in (1 - t, t)]
        for weight, index in zip(weights, self.indices, strict=True):
            for c, value in enumerate(values):
                target.add(index if len(values) == 1 else index * len(values) + c, weight * value)
