"""Building blocks that keep kernels few and fast: opaque numbers, integer division, and memory access."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError


def opaque(value: float) -> mi.Float:
    """A number that changes between calls, kept out of the generated code so that no kernel is recompiled."""
    return _opaque(mi.Float, value)


def opaque_int(value: int) -> mi.Int32:
    """Like `opaque`, for integers."""
    return _opaque(mi.Int32, value)


@functools.lru_cache(maxsize=512)
def _opaque(kind: type, value: float) -> mi.Float | mi.Int32:
    # Creating one costs a memory allocation and a fill; a run uses few distinct numbers.
    return dr.opaque(kind, value)


def on_device(kind: type, values: Sequence[float] | np.ndarray) -> Any:
    """Numbers as an array that kernels read from memory.

    One made of a numpy array would share its memory, whose alignment is part of the generated code where an array has a
    single value: now and then a kernel would be compiled again.
    """
    array = kind(np.asarray(values).tolist())
    dr.make_opaque(array)
    return array


#: Arrays have fewer values than this; see `Divisor`.
LARGEST_COUNT = 1 << 30


def require_indexable(count: int, what: str = "an array") -> None:
    """Check that an array of `count` values can be indexed.

    Raises:
        InputError: it is too large.
    """
    if count >= LARGEST_COUNT:
        raise InputError(f"{what} of {count} values, expected fewer than {LARGEST_COUNT}: resample to a coarser grid")


class Divisor:
    """Division of indices below 2^30 by a size that is not part of the generated code.

    Vector units lack integer division. Multiplication by a scaled reciprocal is exact here (Granlund and
    Montgomery 1994): with d' = 2d and l = ⌈log2 d'⌉, ⌊n/d⌋ = ⌊2n · (⌊2^(31+l)/d'⌋ + 1) / 2^(31+l)⌋ for 2n < 2^31.
    """

    def __init__(self, size: int) -> None:
        bits = (2 * size - 1).bit_length()
        factor = 2 ** (31 + bits) // (2 * size) + 1
        self.size = opaque_int(size)
        self.factor, self.shift = _opaque(mi.UInt32, factor), _opaque(mi.UInt32, bits - 1)

    def split_first(self, count: int) -> tuple[mi.UInt32, mi.UInt32]:
        """Quotient and remainder of the indices from 0 to `count` − 1.

        Raises:
            InputError: there are too many.
        """
        require_indexable(count)
        return self.split(dr.arange(mi.UInt32, count))

    def split(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        """Quotient and remainder."""
        quotient = dr.mul_hi(index << 1, self.factor) >> self.shift
        return quotient, index - quotient * mi.UInt32(self.size)


def gather(values: mi.Float, index: mi.UInt32, channels: int, active: mi.Bool | bool = True) -> list[mi.Float]:
    """All channels of the cells at `index`; inactive lanes read 0."""
    if channels == 1:
        return [dr.gather(mi.Float, values, index, active)]
    return [dr.gather(mi.Float, values, index * channels + c, active) for c in range(channels)]


def stored(value: mi.Float | mi.Bool) -> mi.Float | mi.Bool:
    """The value as an array in memory, written through the cache at the next evaluation.

    On CPUs `dr.eval` itself bypasses the cache when it writes, and a subsequent gather waits for the write to complete.
    This makes a gathering kernel several times slower (measured: 36 ms instead of 4 ms for one gather of 3 million
    floats).
    """
    target = dr.empty(type(value), dr.width(value))
    dr.scatter(target, value, dr.arange(mi.UInt32, dr.width(value)), mode=dr.ReduceMode.NoConflicts)
    return target
