"""Smoothing and band normalisation of the gradient, the step that makes every iteration the same small change.

The Laplacian pyramid (Burt and Adelson 1983) splits a field into bands; each is divided by its root mean square,
so that low frequencies move as much as high ones (paper section 4; reference kernel [1, 4, 6, 4, 1]/16 per axis).
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from tnst_mi.grid import Divisor, opaque_int

#: Bands are divided by no less than this: an empty one stays empty.
FLOOR = 1e-10

#: Spatial axes of (D, H, W) and (D, H, W, C) tensors: channels are never mixed.
_AXES = (0, 1, 2)


def gaussian(field: mi.TensorXf, sigma: float, boundary: str = "reflect") -> mi.TensorXf:
    """Gaussian blur along z, y and x, truncated at 4 σ and normalised; channels are blurred separately.

    Args:
        field: (D, H, W) or (D, H, W, C).
        sigma: standard deviation in cells; 0 returns the field.
        boundary: "reflect" (the border cell is duplicated), "nearest", or "zero".
    """
    if sigma <= 0:
        return field
    radius = math.floor(4 * sigma + 0.5)
    weights = [math.exp(-0.5 * (i / sigma) ** 2) for i in range(-radius, radius + 1)]
    total = math.fsum(weights)
    return dr.convolve(field, [w / total for w in weights], axis=_AXES, boundary=boundary)


class _Axis:
    """Reads a tensor along one axis, at clamped positions, into a tensor of another length on that axis."""

    def __init__(self, field: mi.TensorXf, axis: int, length: int) -> None:
        shape = list(field.shape)
        length_before, shape[axis] = shape[axis], length
        self.values, self.shape = field.array, tuple(shape)
        inner = math.prod(shape[axis + 1 :])
        row, offset = Divisor(inner).split(dr.arange(mi.UInt32, math.prod(shape)))
        outer, coordinate = Divisor(length).split(row)
        #: Coordinate of every target element along the axis.
        self.coordinate = mi.Int32(coordinate)
        self.last = opaque_int(length_before - 1)
        self.inner, self.offset = opaque_int(inner), mi.Int32(offset)
        self.base = mi.Int32(outer) * opaque_int(length_before)

    def read(self, coordinate: mi.Int32) -> mi.Float:
        clamped = dr.clip(coordinate, 0, self.last)
        return dr.gather(mi.Float, self.values, mi.UInt32((self.base + clamped) * self.inner + self.offset))

    def store(self, values: mi.Float) -> mi.TensorXf:
        dr.eval(values)
        return mi.TensorXf(values, self.shape)


def reduce(field: mi.TensorXf) -> mi.TensorXf:
    """Blur with [1, 4, 6, 4, 1]/16 and keep every second cell, ⌈n/2⌉ of n, on each spatial axis."""
    for axis in _AXES:
        a = _Axis(field, axis, (field.shape[axis] + 1) // 2)
        i = 2 * a.coordinate
        outer, middle = a.read(i - 2) + a.read(i + 2), a.read(i - 1) + a.read(i + 1)
        field = a.store((outer + 4 * middle + 6 * a.read(i)) * (1 / 16))
    return field


def expand(field: mi.TensorXf, shape: tuple[int, ...]) -> mi.TensorXf:
    """Interpolate a reduced field back to `shape` with the same kernel (a constant stays that constant)."""
    for axis in _AXES:
        a = _Axis(field, axis, shape[axis])
        i = a.coordinate // 2
        here, after = a.read(i), a.read(i + 1)
        even = (a.read(i - 1) + 6 * here + after) * (1 / 8)
        odd = (here + after) * 0.5
        field = a.store(dr.select((a.coordinate & 1) == 0, even, odd))
    return field


def split(field: mi.TensorXf, levels: int) -> list[mi.TensorXf]:
    """Bands from the finest to the coarsest, then the residual: `levels` + 1 tensors."""
    bands = []
    for _ in range(levels):
        coarse = reduce(field)
        bands.append(field - expand(coarse, tuple(field.shape)))
        field = coarse
    return [*bands, field]


def merge(bands: list[mi.TensorXf]) -> mi.TensorXf:
    """Inverse of `split`, exact up to rounding."""
    field = bands[-1]
    for band in reversed(bands[:-1]):
        field = band + expand(field, tuple(band.shape))
    return field


def root_mean_square(field: mi.TensorXf) -> mi.Float:
    """Root of the mean square over all cells and channels, as a number that stays on the device."""
    return dr.sqrt(dr.mean(dr.square(field.array)))


def normalise(field: mi.TensorXf, levels: int = 3) -> mi.TensorXf:
    """Divide every band by its root mean square (one number for all channels, floor 1e-10) and merge them.

    Args:
        field: gradient (D, H, W) or (D, H, W, 3).
        levels: number of bands besides the residual; 0 normalises the field as a whole.
    """
    bands = split(field, levels)
    return merge([mi.TensorXf(b.array / dr.maximum(root_mean_square(b), FLOOR), tuple(b.shape)) for b in bands])
