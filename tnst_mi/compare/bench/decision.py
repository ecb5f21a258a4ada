"""What chance alone does not explain: families of tests, and how many false alarms they can raise together.

By construction, if all means are equal within their allowances and the batches are normal, the probability of any
alarm at all is at most `FALSE_ALARMS`: it is divided evenly among the families, and within each by Holm's procedure,
which holds however the tests depend on each other (Holm, A simple sequentially rejective multiple test procedure, 1979).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tnst_mi.compare.bench.batches import Batches, Difference, difference
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
        tested: False where the batches do not differ enough, see `Batches.testable`.
    """

    name: str
    labels: Sequence[str]
    left: np.ndarray
    right: np.ndarray
    left_error: np.ndarray
    right_error: np.ndarray
    left_degrees: int
    right_degrees: int
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
        left.degrees,
        right.degrees,
        Difference(found.value.ravel(), found.standard_error.ravel(), found.degrees.ravel()),
        np.broadcast_to(allowance, left.mean.shape).ravel(),
        (left.testable & right.testable).ravel(),
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
