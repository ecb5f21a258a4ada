"""Guided statistics (Gatys et al. 2017): averages over a region of an image instead of over all of it.

The weight of a position of a layer is the average share of the region in the pixels that it stands for. All means of
features are Σ w F / Σ w then, and Gram matrices Σ w F Fᵀ / Σ w.

The smoke is such a region too, for statistics of a style: background pixels of an image of smoke are no texture. Its
share of a pixel is its opacity there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

#: Sum of weights below which a region is not seen in a view. A tenth of a pixel would still be 0.1.
_UNSEEN = 1e-3


class Guide:
    """Where a region is seen in a batch of views.

    Args:
        shares: (N, H, W), the share of each pixel that is the region's, in [0, 1]; never differentiated.

    Attributes:
        seen: (N,), 1 for views in which the region is seen, else 0.
    """

    def __init__(self, shares: Tensor) -> None:
        self._shares = shares
        self.seen = (shares.flatten(1).sum(1) > _UNSEEN).to(shares.dtype)
        self._by_size: dict[tuple[int, int], Tensor] = {}

    def of(self, views: slice) -> Guide:
        """The same for some of the views."""
        return Guide(self._shares[views])

    def weights(self, rows: int, columns: int) -> Tensor:
        """Weights (N, rows · columns) of the positions of a layer; they sum to 1 where the region is seen, else 0."""
        if (rows, columns) not in self._by_size:
            of_areas = functional.adaptive_avg_pool2d(self._shares[:, None], (rows, columns)).flatten(1)
            total = of_areas.sum(1, keepdim=True)
            self._by_size[rows, columns] = (
                self.seen[:, None] * of_areas / total.clamp_min(torch.finfo(total.dtype).tiny)
            )
        return self._by_size[rows, columns]

    def mean(self, values: Tensor) -> Tensor:
        """The means (N, C) of features (N, C, H, W) over the region."""
        return (values.flatten(2) * self.weights(*values.shape[2:])[:, None]).sum(2)


class Guides(NamedTuple):
    """Where terms look in a batch of views.

    Attributes:
        region: where the region of a target is seen; None if it is everywhere.
        smoke: how opaque its smoke is there, for statistics of the smoke; None if they are those of the region.
    """

    region: Guide | None = None
    smoke: Guide | None = None

    def of(self, views: slice) -> Guides:
        """The same for some of the views."""
        return Guides(*(None if guide is None else guide.of(views) for guide in self))

    def needed(self, of_smoke: bool) -> Guides:
        """What some terms need of them: the smoke only if one takes statistics of it."""
        return self if of_smoke else Guides(self.region)

    def of_term(self, of_smoke: bool) -> Guide | None:
        """The one of a term, by whether that takes statistics of the smoke."""
        return self.region if self.smoke is None or not of_smoke else self.smoke


#: All positions of all views count alike.
UNGUIDED = Guides()


def mean_over_view(values: Tensor, guide: Guide | None) -> Tensor:
    """The mean of the features (N, C, H, W) or (N, C) of each view, over its region if there is one: (N,)."""
    if guide is None or values.ndim == 2:
        return values.flatten(1).mean(1)
    return guide.mean(values).mean(1)


class LayerTarget(NamedTuple):
    """What the features of a layer are compared with.

    Attributes:
        values: the features (1, C, H, W) of a picture.
        guide: the weights of their positions; None if all are equal.
    """

    values: Tensor
    guide: Guide | None


#: The loss (N,) of each of N views by the features (N, C, H, W) of one layer and, if there is one, their guide.
LayerLoss = Callable[[Tensor, Guide | None], Tensor]
