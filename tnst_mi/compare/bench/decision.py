"""What chance alone does not explain: families of tests, and how many false alarms they can raise together.

By construction, if all means are equal within their allowances and the batches are normal, the probability of any
alarm at all is at most `FALSE_ALARMS`: it is divided evenly among the families, and within each by Holm's procedure
(A simple sequentially rejective multiple test procedure, 1979), which holds however the tests depend on each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tnst_mi.compare.bench.batches import Batches, Difference, comparable, difference
from tnst_mi.compare.bench.student import two_sided_tail

#: Probability that a comparison of two that agree finds fault.
FALSE_ALARMS = 1e-3


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
        tested: False where the batches do not differ enough, see `batches.comparable`.
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
    tested: np.ndarray

    @property
    def tail(self) -> np.ndarray:
        """The probability of so large a difference by chance, 1 where nothing is tested."""
        beyond = np.maximum(np.abs(self.difference.value) - self.allowance, 0.0)
        error = self.difference.standard_error
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(beyond > 0, beyond / error, 0.0)
        return np.where(self.tested, two_sided_tail(t, self.difference.degrees), 1.0)

    @property
    def scores(self) -> np.ndarray:
        """Differences in standard errors; NaN where nothing is tested or there is no noise."""
        error = self.difference.standard_error
        noisy = self.tested & (error > 0)
        return np.where(noisy, self.difference.value / np.where(noisy, error, 1.0), np.nan)


def family(name: str, labels: Sequence[str], left: Batches, right: Batches, allowance: np.ndarray) -> Family:
    """Tests of the elements of two estimates, flattened; `allowance` is broadcast to their shape."""
    found = difference(left, right)
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
        np.broadcast_to(allowance, left.mean.shape).ravel(),
        comparable(left, right).ravel(),
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
