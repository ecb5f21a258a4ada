"""Weighted sums of loss terms on GoogLeNet features: adding and weighting them, and computing their targets.

The terms themselves are in `tnst_mi.losses.terms` and `tnst_mi.losses.style`, and how they are evaluated in
`tnst_mi.losses.evaluation`. Every term is summed over the views of a batch; lower is better.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from numbers import Real

import torch

from tnst_mi.errors import InputError
from tnst_mi.losses.evaluation import BoundObjective, BoundTerm
from tnst_mi.network.googlenet import GoogLeNet


class Objective:
    """A weighted sum of terms. `a + b`, `2 * a` and `-a` make new objectives."""

    def __init__(self, weighted_terms: Iterable[tuple[float, Term]]) -> None:
        """Sum these (weight, term) pairs; raises `InputError` if there are none."""
        self._weighted_terms = tuple(weighted_terms)
        if not self._weighted_terms:
            raise InputError("objective: there is no term; give a style, semantic, tag or content target")

    @property
    def weighted_terms(self) -> tuple[tuple[float, Term], ...]:
        """The (weight, term) pairs, in the order they were added."""
        return self._weighted_terms

    def __add__(self, other: Objective) -> Objective:
        """The sum of both objectives."""
        if not isinstance(other, Objective):
            return NotImplemented
        return Objective(self.weighted_terms + other.weighted_terms)

    def __mul__(self, factor: float) -> Objective:
        """The same terms with every weight multiplied."""
        if not isinstance(factor, Real):
            return NotImplemented
        return Objective((float(factor) * weight, term) for weight, term in self.weighted_terms)

    __rmul__ = __mul__

    def __neg__(self) -> Objective:
        """The objective with its sign reversed."""
        return -1.0 * self

    @property
    def names(self) -> list[str]:
        """A readable name of each term; repeated names are numbered from the second on."""
        seen: Counter[str] = Counter()
        names = []
        for _, term in self.weighted_terms:
            seen[term.name] += 1
            names.append(term.name if seen[term.name] == 1 else f"{term.name} #{seen[term.name]}")
        return names

    def bind(
        self, net: GoogLeNet, height: int, width: int, record: bool = False, sigma: bool = False
    ) -> BoundObjective:
        """Compute the targets for images of height x width pixels, without gradients.

        Args:
            net: The network, on its final device.
            height: Rows of the images.
            width: Columns of the images.
            record: On a GPU, record the differentiated evaluation of small batches and replay it: the same bits in less
                time, for those who evaluate it many times. Recording takes about as long as ten evaluations.
            sigma: Multiply every term of a view by σ, the sum of the view's pixels, and differentiate σ too (paper
                Eq. 2): views that show little smoke count little.

        Raises:
            InputError: A term names a layer, channel or class tag that the network lacks.
        """
        with torch.no_grad():
            terms = [term.bind_term(net, height, width) for _, term in self.weighted_terms]
        weights = [weight for weight, _ in self.weighted_terms]
        return BoundObjective(net, (height, width), self.names, weights, terms, record, sigma)


class Term(Objective):
    """A single loss, which is also an objective: itself with weight 1."""

    @property
    def weighted_terms(self) -> tuple[tuple[float, Term], ...]:
        """The term itself, with weight 1."""
        return ((1.0, self),)

    @property
    def name(self) -> str:
        """The name that logs show."""
        raise NotImplementedError

    def bind_term(self, net: GoogLeNet, height: int, width: int) -> BoundTerm:
        """Compute the targets for images of height x width pixels."""
        raise NotImplementedError
