"""Sliced Wasserstein distances of features (Heitz et al. 2021): all their moments, by their shadows on lines.

A layer has a point in the space of its C channels for each position. The squared Wasserstein distance W² of two sets of
points on a line is known in closed form: sorted, the i-th belongs to the i-th, and W² is the mean of their squared
differences. Random directions show all that tells two sets apart; the axes, where each channel is looked at alone, show
the histograms of the channels (Risser et al. 2017).

Sets of different sizes are compared by quantiles: the i-th of P numbers belongs to the target's of (i + 1/2) / P. Of
positions of different weight, one whose weight lies between the shares a and b of all weight belongs to the target's
quantiles from a to b: to their mean, and their variance is a part of W². Else W² would jump where numbers change
places.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from tnst_mi.losses.guided import Guide, LayerLoss, LayerTarget
from tnst_mi.losses.sorting import order_of

#: Share of all weight below which a position has none, but for rounding.
_NO_WIDTH = 1e-13


def directions(target: LayerTarget, seed: Sequence[int]) -> Tensor:
    """As many random unit vectors as the target has channels, the rows of (C, C).

    Args:
        target: features of a layer.
        seed: integers ≥ 0; equal ones give equal directions, on any machine.
    """
    channels = target.values.shape[1]
    drawn = np.random.default_rng(list(seed)).normal(size=(channels, channels))
    return torch.as_tensor(drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).to(target.values)


def sliced_distance(target: LayerTarget, weight: float, lines: Tensor | None) -> LayerLoss:
    """weight · C / mean ‖y‖² · the mean over the lines of W², with the target's features y: 1 for features that are 0.

    The derivative is that of (x - T(x))² with the transport T to the target kept as it is, which is that of W² itself.

    Args:
        target: features of a layer, of C channels.
        weight: of the layer.
        lines: unit vectors (K, C); None for the axes of the channels.
    """
    values, weights = _points(target)
    mean_square = (values.square().sum(0) * weights).sum()
    scale = weight * values.shape[0] / mean_square
    quantiles = _Quantiles(_shadows(values, lines), None if target.guide is None else weights)

    def loss(values: Tensor, guide: Guide | None) -> Tensor:
        shadows = _shadows(values.flatten(2), lines)
        if guide is None:
            wanted = _transported(shadows.detach(), quantiles)
            return scale * (shadows - wanted).square().mean((1, 2))
        weights = guide.weights(*values.shape[2:])[:, None]
        wanted, variance = _transported_weighted(shadows.detach(), weights, quantiles)
        return scale * (weights * ((shadows - wanted).square() + variance)).sum(2).mean(1)

    return loss


class _Quantiles:
    """The quantiles of K sets of Q numbers.

    Args:
        values: (K, Q).
        weights: (Q,), above 0, of the numbers; None if all are equal.
    """

    def __init__(self, values: Tensor, weights: Tensor | None) -> None:
        order = order_of(values)
        self._sorted = values.gather(-1, order)
        self._own = None if weights is None else weights[order]

    # In double precision are sums of which differences are taken: a position may have a millionth of all weight.

    @cached_property
    def _widths(self) -> Tensor:
        """(K, Q): the share of each number in all weight."""
        own = torch.ones_like(self._sorted) if self._own is None else self._own
        return own.double() / own.double().sum(-1, keepdim=True)

    @cached_property
    def _ends(self) -> Tensor:
        """(K, Q): the share of all up to each."""
        return self._widths.cumsum(-1)

    @cached_property
    def _sums(self) -> list[Tensor]:
        """(K, Q) each: integrals, up to each, of the quantiles and of their squares."""
        return [(self._widths * self._sorted.double() ** power).cumsum(-1) for power in (1, 2)]

    def even(self, count: int) -> Tensor:
        """(K, count): those of (i + 1/2) / count."""
        numbers = torch.arange(count, dtype=self._sorted.dtype, device=self._sorted.device)
        levels = (numbers + 0.5) / count
        return self.at(levels.expand(len(self._sorted), -1)[None])[0]

    def at(self, levels: Tensor) -> Tensor:
        """(N, K, P): those of levels (N, K, P) in [0, 1]."""
        return self._sorted.expand(len(levels), -1, -1).gather(2, self._places(levels))

    def between(self, ends: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and variance (N, K, P) of those between each of levels (N, K, P), which rise, and the one before, or 0.

        Args:
            ends: in double precision.
        """
        places = self._places(ends)
        beyond = self._ends.expand(len(ends), -1, -1).gather(2, places) - ends
        quantile = self._sorted.double().expand(len(ends), -1, -1).gather(2, places)
        zero = torch.zeros_like(ends[..., :1])
        widths = torch.diff(ends, dim=2, prepend=zero)
        means = []
        for power, sums in zip((1, 2), self._sums, strict=True):
            up_to = sums.expand(len(ends), -1, -1).gather(2, places) - beyond * quantile**power
            found = torch.diff(up_to, dim=2, prepend=zero) / widths.clamp_min(torch.finfo(widths.dtype).tiny)
            # Positions without weight have no part of the integral.
            means.append(torch.where(widths > _NO_WIDTH, found, quantile**power))
        mean, square = means
        return mean.to(self._sorted), (square - mean.square()).clamp_min(0).to(self._sorted)

    def _places(self, levels: Tensor) -> Tensor:
        """Which of the numbers is the quantile of each of some levels (N, K, P)."""
        views, lines, count = levels.shape
        last = self._sorted.shape[1] - 1
        if self._own is None:
            found = (levels * (last + 1)).long()
        else:
            flat = levels.to(self._ends).transpose(0, 1).reshape(lines, -1).contiguous()
            found = torch.searchsorted(self._ends, flat).view(lines, views, count).transpose(0, 1)
        return found.clamp_max(last)


def _shadows(points: Tensor, lines: Tensor | None) -> Tensor:
    """Where points (…, C, P) lie along lines (K, C), or along the axes: (…, K, P)."""
    return points if lines is None else lines @ points


def _points(target: LayerTarget) -> tuple[Tensor, Tensor]:
    """The features (C, Q) of the positions of a target that have a weight, and the weights (Q,), which sum to 1."""
    values, guide = target
    flat = values[0].flatten(1)
    if guide is None:
        return flat, flat.new_full((flat.shape[1],), 1 / flat.shape[1])
    weights = guide.weights(*values.shape[2:])[0]
    return flat[:, weights > 0], weights[weights > 0]


def _transported(shadows: Tensor, quantiles: _Quantiles) -> Tensor:
    """The quantiles (N, K, P) to which numbers (N, K, P) belong."""
    order = order_of(shadows)
    return torch.empty_like(shadows).scatter_(2, order, quantiles.even(shadows.shape[2]).expand_as(shadows))


def _transported_weighted(shadows: Tensor, weights: Tensor, quantiles: _Quantiles) -> tuple[Tensor, Tensor]:
    """Mean and variance of the quantiles to which numbers (N, K, P) with weights (N, 1, P) belong, likewise."""
    # Last come those without weight: they then do not even decide how sums are rounded.
    order = order_of(shadows.masked_fill(weights == 0, torch.inf))
    ends = weights.expand_as(shadows).gather(2, order).double().cumsum(-1)
    ends = ends / ends[..., -1:].clamp_min(torch.finfo(ends.dtype).tiny)
    mean, variance = (
        torch.empty_like(shadows).scatter_(2, order, found) for found in quantiles.between(ends.clamp_max(1))
    )
    return mean, variance
