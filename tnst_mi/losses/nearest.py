"""Nearest-neighbour feature matching (Zhang et al. 2022, ARF; Kolkin et al. 2022, NNST): strokes instead of statistics.

Every position of a layer is drawn towards the one of the picture that resembles it most. All pairs are looked at, in
chunks whose memory is bounded.
"""

from __future__ import annotations

import torch
from torch import Tensor

from tnst_mi.losses.guided import Guide, LayerLoss, LayerTarget

#: Bytes of the similarities that are held at once; those of one position to the whole picture may exceed it.
LARGEST_SIMILARITIES = 1 << 25

#: Length below which features have no direction, relative to the mean length of those of the picture: their derivative
#: would grow without bound.
_SHORT = 1e-3


def nearest_distance(target: LayerTarget, weight: float) -> LayerLoss:
    """weight · the mean over positions of the least cosine distance 1 - ⟨f, s⟩ / (‖f‖ ‖s‖) to a position of the target.

    Which one that is takes no part in the derivative. Positions with less than half the largest weight are left out of
    the target.
    """
    values, guide = target
    points = values[0].flatten(1).T
    if guide is not None:
        weights = guide.weights(*values.shape[2:])[0]
        points = points[weights >= weights.max() / 2]
    shortest = _SHORT * points.norm(dim=1).mean()
    candidates = _unit(points, shortest)

    def loss(values: Tensor, guide: Guide | None) -> Tensor:
        own = _unit(values.flatten(2).transpose(1, 2).flatten(0, 1), shortest)
        nearest = candidates[_most_similar(own.detach(), candidates)]
        distances = 1 - (own * nearest).sum(1).unflatten(0, (len(values), -1))
        if guide is None:
            return weight * distances.mean(1)
        return weight * (guide.weights(*values.shape[2:]) * distances).sum(1)

    return loss


def _unit(points: Tensor, shortest: Tensor) -> Tensor:
    """Points (P, C) at length 1, but for those that are shorter than `shortest`."""
    return points / points.norm(dim=1, keepdim=True).clamp_min(shortest)


def _most_similar(points: Tensor, candidates: Tensor) -> Tensor:
    """For each of the unit vectors (P, C), the index of the candidate (Q, C) with the largest product."""
    at_once = max(1, LARGEST_SIMILARITIES // (len(candidates) * candidates.element_size()))
    return torch.cat([(part @ candidates.T).argmax(1) for part in points.split(at_once)])
