"""Scatter-add whose result is bit-identical in every run."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.kernels import opaque


class RepeatableSum:
    """A scatter-add whose result does not depend on the order of the additions.

    Floating-point atomics add in the order in which threads arrive, so that the bits differ from run to run. Here each
    value is rounded to a multiple of a power of two and added as a 64-bit integer, which is exact. The unit is the
    smallest for which `count` additions of `bound` cannot overflow: no coarser than 2^-30 of the bound for up to 2^31
    additions to a slot, hence finer than float32 for all but the smallest addends.

    Args:
        size: number of slots.
        bound: upper limit on the magnitude of any value added (a number on the device, width 1).
        count: upper limit on the number of values added to a slot.
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
        """The sums of the slots at `index` in float32."""
        return mi.Float(dr.gather(mi.Int64, self.total, index)) * self.unit


def largest_magnitude(values: mi.Float) -> mi.Float:
    """max |values|, kept on the device; infinite where a value is NaN, so that sums of it are NaN."""
    if not dr.width(values):
        return mi.Float(0)
    return dr.max(dr.select(dr.isnan(values), dr.inf, dr.abs(values)))
