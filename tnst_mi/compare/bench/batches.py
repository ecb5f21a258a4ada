"""Independent estimates of the same numbers, their mean, and the difference of two such means."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from tnst_mi.compare.bench.student import quantile

#: The scatter of batches is trusted if no single value is shared by more than this part of them.
_MOST_EQUAL = 0.5

#: Numbers that differ by less than this part of the largest are the same in float32.
_ROUNDING = 2.0**-16

_EDGES = 4
"""Tiles along each edge of a view."""


@dataclass(frozen=True, eq=False)
class Batches:
    """Independent estimates of an array; a single one is free of noise.

    Attributes:
        values: (batches, …) float64.
        rare: whether a path that is seldom found may count for much: what is the same in all batches is then no
            certainty. Not so where rays are marched, and only their places in a pixel are random.
    """

    values: np.ndarray
    rare: bool = True

    @property
    def exact(self) -> bool:
        """Whether it has no noise."""
        return len(self.values) == 1

    @property
    def mean(self) -> np.ndarray:
        """Of the batches."""
        return self.values.mean(0)

    @property
    def standard_error(self) -> np.ndarray:
        """Of the mean; 0 if it has no noise."""
        if self.exact:
            return np.zeros(self.values.shape[1:])
        return self.values.std(0, ddof=1) / np.sqrt(len(self.values))

    @property
    def half_width(self) -> np.ndarray:
        """Half the width of the 95% confidence interval of the mean, by Student's t."""
        return np.zeros(self.values.shape[1:]) if self.exact else self.standard_error * quantile(0.05, self.degrees)

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the standard error."""
        return len(self.values) - 1

    @property
    def commonest(self) -> np.ndarray:
        """Of the batches, the largest part that has one value, up to the rounding of a film."""
        unit = _ROUNDING * float(np.abs(self.values).max(initial=0.0)) or 1.0
        ordered = np.sort(np.rint(self.values / unit), axis=0)
        longest, run = np.ones(ordered.shape[1:], int), np.ones(ordered.shape[1:], int)
        for before, after in itertools.pairwise(ordered):
            run = np.where(before == after, run + 1, 1)
            longest = np.maximum(longest, run)
        return longest / len(ordered)

    def first(self, count: int) -> Batches:
        """Of the first batches alone."""
        return self._like(self.values[: 1 if self.exact else count])

    def means(self) -> Batches:
        """The mean of each view and channel: from (batches, V, H, W, C) to (batches, V, C)."""
        return self._like(self.values.mean((2, 3)))

    def tiles(self) -> Batches:
        """The mean of each tile: from (batches, V, H, W, C) to (batches, V, rows, columns, C), 4 by 4 at most."""
        rows, columns = (np.array_split(np.arange(n), min(n, _EDGES)) for n in self.values.shape[2:4])
        split = [
            np.stack([self.values[:, :, r[0] : r[-1] + 1, c[0] : c[-1] + 1].mean((2, 3)) for c in columns], 2)
            for r in rows
        ]
        return self._like(np.stack(split, 2))

    def _like(self, values: np.ndarray) -> Batches:
        return Batches(values, self.rare)


def comparable(left: Batches, right: Batches) -> np.ndarray:
    """Which elements of two estimates can be tested.

    Where a path seldom counts, most batches may have the same value: their scatter is then too small by chance, and
    they are not tested. Nor are those that all have the same value against one free of noise, since such a path may
    have been missed altogether. But two noisy sides find about as many such paths, so that one on which all batches
    are the same can be held against one whose batches differ, or are all the same too.
    """
    sides = [side for side in (left, right) if not side.exact and side.rare]
    shares = [side.commonest for side in sides]
    varying = [share <= _MOST_EQUAL for share in shares]
    if len(sides) < 2 or left.exact or right.exact:
        return np.all([np.ones(left.mean.shape, bool), *varying], axis=0)
    known = [vary | (share == 1) for vary, share in zip(varying, shares, strict=True)]
    return known[0] & known[1]


def certain_beside(derivative: Batches, another: Batches) -> Batches:
    """A derivative as it is to be tested, by another estimate of it from as many paths: numbers (batches,) each.

    One that is the same in all batches may have missed the paths that count. If most batches of the other vary, such
    paths are found, and none of them carries the derivative, as with a tight majorant: it is then no chance.
    """
    found = derivative.commonest == 1 and another.commonest <= _MOST_EQUAL
    return replace(derivative, rare=False) if found else derivative


@dataclass(frozen=True, eq=False)
class Difference:
    """Left minus right, elementwise.

    Attributes:
        value: the difference of the means.
        standard_error: of it; 0 if neither has noise.
        degrees: of freedom, by Welch and Satterthwaite; 1 where there is no noise.
    """

    value: np.ndarray
    standard_error: np.ndarray
    degrees: np.ndarray

    @property
    def half_width(self) -> np.ndarray:
        """Half the width of its 95% confidence interval."""
        whole = np.floor(self.degrees).astype(int)
        widths = np.array([quantile(0.05, n) for n in range(1, int(whole.max(initial=1)) + 1)])
        return self.standard_error * widths[whole - 1]


def difference(left: Batches, right: Batches) -> Difference:
    """Of two estimates of arrays of one shape."""
    degrees = [np.full(side.mean.shape, float(side.degrees)) for side in (left, right)]
    return welch(left.mean, left.standard_error, degrees[0], right.mean, right.standard_error, degrees[1])


def welch(
    left: np.ndarray,
    left_error: np.ndarray,
    left_degrees: np.ndarray,
    right: np.ndarray,
    right_error: np.ndarray,
    right_degrees: np.ndarray,
) -> Difference:
    """Left minus right from means, their standard errors and degrees of freedom (0: no noise), arrays of one shape."""
    sides = ((left_error**2, left_degrees), (right_error**2, right_degrees))
    total = left_error**2 + right_error**2
    weights = sum(square**2 / np.maximum(degrees, 1) for square, degrees in sides)
    noisy = weights > 0
    degrees = np.divide(total**2, weights, out=np.ones_like(total), where=noisy)
    # Rounding may leave a hair less than the smaller of both.
    least = np.min([np.where(degrees > 0, degrees, np.inf) for _, degrees in sides], axis=0)
    degrees = np.where(noisy & np.isfinite(least), np.maximum(degrees, least), 1.0)
    return Difference(left - right, np.sqrt(total), degrees)
