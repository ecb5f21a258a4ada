"""The trilinear stencil of a grid that continues its outermost cells."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.grid import RepeatableSum, Shape, gather, opaque, opaque_int


def larger(a: mi.Float, b: mi.Float | float) -> mi.Float:
    """The larger of two numbers, neither of them NaN: a single instruction, unlike `dr.maximum`."""
    return dr.select(a > b, a, b)


def smaller(a: mi.Float, b: mi.Float | float) -> mi.Float:
    """As `larger`."""
    return dr.select(a < b, a, b)


class ClampedStencil:
    """Trilinear interpolation in a grid that repeats its outermost cells, as gridvolume does inside its box.

    Args:
        shape: (D, H, W).
        position: (x, y, z) in cells from the centre of cell 0.

    Attributes:
        position: as given.
        lower: of the eight cells around the position, the one of the lowest indices.
    """

    def __init__(self, shape: Shape, position: mi.Vector3f) -> None:
        d, h, w = shape
        self.position = position
        # No axis may lead out of the grid; along one of a single cell, the two cells are the same.
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
