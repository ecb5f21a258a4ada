"""Independent estimates of the same numbers, their mean, and the difference of two such means."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tnst_mi.compare.bench.statistics.student import quantile

#: The scatter of batches is trusted if so many of them, or half of them, differ from the commonest value.
_LEAST_DIFFERING = 8

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
        paths: of each value.
        ends: below and above which no path can be, such as 0 and ∞ for light.
    """

    values: np.ndarray
    rare: bool = True
    paths: int = 1
    ends: tuple[float, float] = (-math.inf, math.inf)

    @property
    def exact(self) -> bool:
        """Whether it has no noise."""
        return len(self.values) == 1

    @cached_property
    def mean(self) -> np.ndarray:
        """Of the batches."""
        return self.values.mean(0)

    @cached_property
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
    def rounding(self) -> float:
        """The difference up to which numbers are the same."""
        return _ROUNDING * float(np.abs(self.values).max(initial=0.0))

    @cached_property
    def differing(self) -> np.ndarray:
        """How many of the batches have another value than most have, up to the rounding of a film."""
        ordered = np.sort(np.rint(self.values / (self.rounding or 1.0)), axis=0)
        longest, run = np.ones(ordered.shape[1:], int), np.ones(ordered.shape[1:], int)
        for before, after in itertools.pairwise(ordered):
            run = np.where(before == after, run + 1, 1)
            longest = np.maximum(longest, run)
        return len(ordered) - longest

    @property
    def varies(self) -> np.ndarray:
        """Whether enough batches differ for their scatter to be trusted."""
        return self.differing >= min(_LEAST_DIFFERING, len(self.values) // 2)

    def error_about(self, mean: np.ndarray) -> np.ndarray:
        """The standard error that there would be if this were the mean.

        Paths that count for much are seldom found. Where few were, by chance, the mean is near an end and the scatter
        is too small as well, which would be taken for certainty. The scatter of positive numbers grows as their mean
        does at most, if they only become more or larger; so the error is scaled by the distances from the end.
        """
        found, stretch = self.mean, np.ones(self.mean.shape)
        ends = [found - end for end in self.ends if math.isfinite(end)] or [self._distance_of_a_gamma_law()]
        for distance in ends:
            further = np.divide(mean - found, distance, out=np.zeros(found.shape), where=distance != 0)
            stretch = np.maximum(stretch, 1 + further)
        return self.standard_error * stretch

    def _distance_of_a_gamma_law(self) -> np.ndarray:
        """From the mean down to the end of a gamma law of the same scatter and skewness; up, where negative; ∞ of a law
        that is symmetric. Means of few paths of one sign, such as derivatives, are not far from such a law."""
        if self.exact or not self.rare:
            return np.full(self.mean.shape, np.inf)
        away = self.values - self.mean
        second, third = (away**2).mean(0), (away**3).mean(0)
        return np.divide(2 * second**2, third, out=np.full(third.shape, np.inf), where=third != 0)

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
        return replace(self, values=values)


def comparable(left: Batches, right: Batches) -> np.ndarray:
    """Which elements of two estimates can be tested.

    Where a path seldom counts, most batches may have the same value: their scatter is then too small by chance, and
    they are not tested. Nor are those that all have the same value against one free of noise, since such a path may
    have been missed altogether; see `missed`. But two noisy sides find about as many such paths, so that one on which
    all batches are the same can be held against one whose batches differ, or are all the same too. Where both are 0
    nothing is seen, unless neither side has noise.
    """
    seen = (left.values != 0).any(0) | (right.values != 0).any(0)
    sides = [side for side in (left, right) if not side.exact and side.rare]
    known = [side.varies for side in sides]
    if len(sides) == 2:
        known = [varies | (side.differing == 0) for varies, side in zip(known, sides, strict=True)]
    return np.all([seen, *known], axis=0) if sides else np.ones(left.mean.shape, bool)


def missed(left: Batches, right: Batches, allowance: np.ndarray) -> np.ndarray:
    """The probability that all batches of the noisy side are so far from the other, which is free of noise, and the
    same only because paths were missed; 1 where nothing bounds it, and where batches differ.

    With a mean μ between the ends a and b, a path, or a mean of some, is at c > μ or above with probability
    (μ − a)/(c − a) at most, by Markov's inequality, and at c < μ or below with (b − μ)/(b − c). For a side that is
    black this is the bound of Clopper and Pearson.
    """
    if left.exact == right.exact:
        return np.ones(left.mean.shape)
    noisy, exact = (right, left) if left.exact else (left, right)
    same, mean = noisy.values[0], exact.mean
    for end in noisy.ends:
        # Rounding leaves a hair from an end, also beyond it, of what is there.
        same = np.where(np.abs(same - end) <= noisy.rounding, end, same)
    mean = np.clip(mean + np.clip(same - mean, -allowance, allowance), *noisy.ends)
    tail = np.ones(mean.shape)
    for end in noisy.ends:
        if math.isfinite(end):
            # Where all are at the other end, each path is, otherwise each batch is where it is.
            other = noisy.ends[1] if end == noisy.ends[0] else noisy.ends[0]
            count = len(noisy.values) * np.where(same == other, noisy.paths, 1)
            far = np.abs(same - end)
            further = far > np.abs(mean - end)
            ratio = np.divide(np.abs(mean - end), far, out=np.ones(mean.shape), where=further)
            tail = np.minimum(tail, ratio**count)
    return np.where(noisy.differing == 0, tail, 1.0) if noisy.rare else np.ones(mean.shape)


def certain_beside(derivative: Batches, another: Batches) -> Batches:
    """A derivative as it is to be tested, by another estimate of it from as many paths: numbers (batches,) each.

    One that is the same in all batches may have missed the paths that count. If most batches of the other vary, such
    paths are found, and none of them carries the derivative, as with a tight majorant: it is then no chance.
    """
    found = derivative.differing == 0 and another.differing >= len(another.values) // 2
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
    """Of two estimates of arrays of one shape, with the errors that they would have if both means were the same."""
    degrees = [np.full(side.mean.shape, float(side.degrees)) for side in (left, right)]
    common = _common_mean(left, right)
    errors = [side.error_about(common) for side in (left, right)]
    return welch(left.mean, errors[0], degrees[0], right.mean, errors[1], degrees[1])


def _common_mean(left: Batches, right: Batches) -> np.ndarray:
    """Of two estimates, each with the weight of its precision; of an exact side, its own."""
    for side in (left, right):
        if side.exact:
            return side.mean
    variances = [side.standard_error**2 for side in (left, right)]
    weights = [np.divide(1.0, each, out=np.zeros_like(each), where=each > 0) for each in variances]
    total, middle = weights[0] + weights[1], (left.mean + right.mean) / 2
    return np.divide(weights[0] * left.mean + weights[1] * right.mean, total, out=middle, where=total > 0)


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
