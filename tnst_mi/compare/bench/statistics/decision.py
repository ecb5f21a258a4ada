"""What chance alone does not explain: families of tests, and how many false alarms they can raise together.

By construction, if all means are equal within their allowances and the batches are normal, the probability of any
alarm at all is at most `FALSE_ALARMS`: it is divided evenly among the families, and within each by Holm's procedure
(A simple sequentially rejective multiple test procedure, 1979), which holds however the tests depend on each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tnst_mi.compare.bench.statistics.batches import Batches, Difference, comparable, difference, missed
from tnst_mi.compare.bench.statistics.student import quantile, two_sided_tail

#: Probability that a comparison of two that agree finds fault.
FALSE_ALARMS = 1e-3

#: Twice the probability with which a difference that is stated as detectable is missed.
_MISSES = 0.2


@dataclass(frozen=True, eq=False)
class Family:
    """Tests of one kind. Arrays have an element for each.

    Attributes:
        name: of the kind, such as "means".
        labels: what each is about.
        left, right: the means.
        left_error, right_error: their standard errors.
        left_degrees, right_degrees: degrees of freedom of these; 0 if free of noise.
        difference: left minus right.
        allowance: the difference that does not count.
        size: what differences are relative to where they are stated in percent.
        missed: the probability of what batches that are all the same have found, see `batches.missed`; 1 elsewhere.
        tested: False where nothing can be said, see `batches.comparable`.
    """

    name: str
    labels: Sequence[str]
    left: np.ndarray
    right: np.ndarray
    left_error: np.ndarray
    right_error: np.ndarray
    left_degrees: np.ndarray
    right_degrees: np.ndarray
    difference: Difference
    allowance: np.ndarray
    size: np.ndarray
    missed: np.ndarray
    tested: np.ndarray

    @property
    def tail(self) -> np.ndarray:
        """The probability of so large a difference by chance, 1 where nothing is tested."""
        beyond = np.maximum(np.abs(self.difference.value) - self.allowance, 0.0)
        error = self.difference.standard_error
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(beyond > 0, beyond / error, 0.0)
        tail = np.where(self.missed < 1, self.missed, two_sided_tail(t, self.difference.degrees))
        return np.where(self.tested, tail, 1.0)

    @property
    def scores(self) -> np.ndarray:
        """Differences in standard errors; NaN where nothing is tested or there is no noise."""
        error = self.difference.standard_error
        noisy = self.tested & (error > 0)
        return np.where(noisy, self.difference.value / np.where(noisy, error, 1.0), np.nan)


def detectable(families: Sequence[Family], most: float = FALSE_ALARMS) -> list[np.ndarray]:
    """For each test of each family, the true difference that is found nine times in ten; NaN where none is tested.

    By the first step of Holm's procedure, which allows least: further ones find smaller differences.
    """
    return [_detectable(member, most / max(len(families), 1) / max(len(member.labels), 1)) for member in families]


def _detectable(tests: Family, level: float) -> np.ndarray:
    degrees = np.floor(tests.difference.degrees).astype(int)
    errors = np.zeros(degrees.shape)
    for count in np.unique(degrees):
        errors[degrees == count] = _quantile(level, int(count)) + _quantile(_MISSES, int(count))
    # Without noise, degrees of freedom mean nothing.
    noise = tests.difference.standard_error
    found = tests.allowance + np.where(noise > 0, errors * noise, 0.0)
    return np.where(tests.tested & (tests.missed == 1), found, np.nan)


@lru_cache
def _quantile(probability: float, degrees: int) -> float:
    return quantile(probability, degrees)


def family(
    name: str,
    labels: Sequence[str],
    left: Batches,
    right: Batches,
    allowance: np.ndarray,
    size: np.ndarray | float = 1.0,
) -> Family:
    """Tests of the elements of two estimates, flattened; `allowance` and `size` are broadcast to their shape."""
    found = difference(left, right)
    allowance, size = (np.broadcast_to(each, left.mean.shape) for each in (allowance, size))
    unlikely = missed(left, right, allowance)
    return Family(
        name,
        labels,
        left.mean.ravel(),
        right.mean.ravel(),
        left.standard_error.ravel(),
        right.standard_error.ravel(),
        np.full(left.mean.size, left.degrees),
        np.full(right.mean.size, right.degrees),
        Difference(found.value.ravel(), found.standard_error.ravel(), found.degrees.ravel()),
        allowance.ravel(),
        size.ravel(),
        unlikely.ravel(),
        (comparable(left, right) | (unlikely <= FALSE_ALARMS)).ravel(),
    )


def merged(families: Sequence[Family]) -> list[Family]:
    """One family for each name, with the tests of all of that name."""
    by_name: dict[str, list[Family]] = {}
    for member in families:
        by_name.setdefault(member.name, []).append(member)
    return [_joined(name, members) for name, members in by_name.items()]


def _joined(name: str, members: Sequence[Family]) -> Family:
    def together(pick: Callable[[Family], np.ndarray]) -> np.ndarray:
        return np.concatenate([pick(member) for member in members])

    return Family(
        name,
        [label for member in members for label in member.labels],
        together(lambda member: member.left),
        together(lambda member: member.right),
        together(lambda member: member.left_error),
        together(lambda member: member.right_error),
        together(lambda member: member.left_degrees),
        together(lambda member: member.right_degrees),
        Difference(
            together(lambda member: member.difference.value),
            together(lambda member: member.difference.standard_error),
            together(lambda member: member.difference.degrees),
        ),
        together(lambda member: member.allowance),
        together(lambda member: member.size),
        together(lambda member: member.missed),
        together(lambda member: member.tested),
    )


def alarms(families: Sequence[Family], most: float = FALSE_ALARMS) -> list[np.ndarray]:
    """For each family, which of its tests find a difference that chance does not explain.

    Args:
        families: all that is tested together.
        most: the probability of any alarm if there is nothing to find.
    """
    return [holm(member.tail, most / max(len(families), 1)) for member in families]


def holm(tails: np.ndarray, most: float) -> np.ndarray:
    """Which hypotheses Holm's procedure rejects, where the probability of any false rejection may be `most`."""
    order = np.argsort(tails)
    allowed = most / np.arange(len(tails), 0, -1)
    failed = tails[order] > allowed
    count = int(failed.argmax()) if failed.any() else len(tails)
    rejected = np.zeros(len(tails), bool)
    rejected[order[:count]] = True
    return rejected
