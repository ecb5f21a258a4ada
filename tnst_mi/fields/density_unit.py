"""The unit of density of a sequence: the reference density that counts as 1 in masks, extinction and steps.

Simulations measure density in units of their own: smoke of maximum 0.05 is the same smoke as of maximum 1. A run
multiplies all densities by one factor, 1 / their reference density, and its results come back in the input's units.
"""

from __future__ import annotations

import math

import numpy as np

#: The reference density is this percentile of the smoky cells.
PERCENTILE = 0.99

#: Smoky cells are the densest ones that hold this share of all smoke. The others are haze: advection leaves tails of
#: tiny values over much of a grid, often in more cells than there are in the smoke.
SMOKE = 0.99

#: So many of a frame's densest cells, but no more than 1% of those that are not empty, may be stray: they count as
#: being as dense as the next one, lest a single hot cell hold nearly all of the smoke.
STRAY = 4

#: Factor from 1 beyond which the density of thick smoke is unusual where γ, masks and looks mean that of 1.
_UNUSUAL = 4.0

#: Cells with less than this share of a frame's densest ones need not be counted: together they are less than a few.
_NEGLIGIBLE = 1e-7

#: Low bits of a float32 that do not distinguish values: they are counted to a relative 2⁻¹⁵.
_IGNORED_BITS = 8


class ReferenceDensity:
    """The 99th percentile of the smoky cells of all frames, collected frame by frame in bounded memory.

    It scales with the density: exactly for factors that are powers of two, else to a relative 3e-5.
    """

    def __init__(self) -> None:
        # By class of nearly equal values, in rising order: the number of cells, and the sum of their densities.
        self._classes, self._counts, self._sums = np.zeros(0, np.uint32), np.zeros(0), np.zeros(0)

    def add(self, density: np.ndarray) -> None:
        """Count the cells of a frame (D, H, W), float32, finite and ≥ 0."""
        filled = density[density > 0]
        if not filled.size:
            return
        densest = densest_but_stray(filled)
        counted = np.sort(np.minimum(filled[filled >= _NEGLIGIBLE * float(densest)], densest))
        # The bits of positive floats are in the order of their values, and a power of two changes their exponent alone.
        classes, first = np.unique(counted.view(np.uint32) >> _IGNORED_BITS, return_index=True)
        counts = np.diff(np.append(first, counted.size)).astype(float)
        sums = np.add.reduceat(counted.astype(np.float64), first)
        self._classes, place = np.unique(np.concatenate([self._classes, classes]), return_inverse=True)
        self._counts, self._sums = (
            np.bincount(place, np.concatenate([earlier, new]))
            for earlier, new in ((self._counts, counts), (self._sums, sums))
        )

    @property
    def value(self) -> float:
        """The reference density; 0 if there is no smoke."""
        if not self._classes.size:
            return 0.0
        held = np.cumsum(self._sums)
        smoky = int(np.searchsorted(held, (1 - SMOKE) * held[-1]))
        below = np.cumsum(self._counts[smoky:])
        at = smoky + int(np.searchsorted(below, PERCENTILE * below[-1]))
        return float(self._sums[at] / self._counts[at])

    def scale(self, given: float | str = "auto") -> float:
        """The factor of all densities: the one given, or for "auto" 1 / the reference density (1 without smoke)."""
        if not isinstance(given, str):
            return given
        return 1.0 / self.value if self.value > 0 else 1.0


def densest_but_stray(densities: np.ndarray) -> np.float32:
    """The largest of some densities (N,) but for those that may be stray."""
    rank = densities.size - 1 - min(STRAY, densities.size // 100)
    return np.partition(densities, rank)[rank]


def is_unusual(thick: float) -> bool:
    """Whether the density of thick smoke, 0 if there is none, is far from 1."""
    return thick > 0 and not 1 / _UNUSUAL < thick < _UNUSUAL


def scaled(density: np.ndarray, factor: float) -> np.ndarray:
    """A density (D, H, W) float32 times a positive factor, which may be beyond the range of float32."""
    if factor == 1.0:
        return density
    mantissa, exponent = math.frexp(factor)
    return np.ldexp(density, exponent) * np.float32(mantissa)
