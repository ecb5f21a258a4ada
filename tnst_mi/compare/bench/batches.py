"""Independent estimates of the same numbers, their mean, and the difference of two such means."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tnst_mi.compare.bench.student import quantile

#: A noisy number is tested only if no single value is shared by more than this part of its batches: where nearly all
#: paths do the same, a few batches can look free of noise without being so.
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
    def testable(self) -> np.ndarray:
        """Whether the batches differ enough for their scatter to be trusted; always without noise."""
        if self.exact or not self.rare:
            return np.ones(self.values.shape[1:], bool)
        # What differs by the rounding of a film alone is the same.
        unit = _ROUNDING * float(np.abs(self.values).max(initial=0.0)) or 1.0
        ordered = np.sort(np.rint(self.values / unit), axis=0)
        half = int(_MOST_EQUAL * len(ordered))
        # More than half are equal if some value is met again that many places further on.
        return ~(ordered[half:] == ordered[: len(ordered) - half]).any(0)

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
