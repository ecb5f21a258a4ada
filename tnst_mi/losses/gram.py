"""Distances of Gram matrices (Gatys et al. 2016; paper Eq. 6 and 7): second moments of the features of a layer."""

from __future__ import annotations

from torch import Tensor

from tnst_mi.losses.guided import Guide, LayerLoss, LayerTarget


def mean_gram(values: Tensor, guide: Guide | None = None) -> Tensor:
    """FᵀF / area, (N, C, C), of features (N, C, H, W): the products of channels, averaged over the positions."""
    flat = values.flatten(2)
    if guide is None:
        return flat @ flat.transpose(1, 2) / flat.shape[2]
    return (flat * guide.weights(*values.shape[2:])[:, None]) @ flat.transpose(1, 2)


def gram_distance(target: LayerTarget, weight: float) -> LayerLoss:
    """weight · ‖G - Gₛ‖² / ‖Gₛ‖², with the Gram matrix Gₛ of the target: 1 for features that are 0."""
    gram = mean_gram(*target)
    return _scaled_distance(gram, weight / gram.square().sum())


def paper_distance(target: LayerTarget, weight: float) -> LayerLoss:
    """weight · ‖G - Gₛ‖² / (4 C² A²), of C channels and A positions (paper Eq. 7).

    Layers keep the magnitude of their features: conv2/3x3 of the BVLC network outweighs inception_3b/output by 38 to 1.
    """
    gram = mean_gram(*target)
    # `mean_gram` is G / A already, which leaves 4 C² of the divisor.
    return _scaled_distance(gram, weight / (4 * len(gram[0]) ** 2))


def _scaled_distance(gram: Tensor, scale: Tensor | float) -> LayerLoss:
    def loss(values: Tensor, guide: Guide | None) -> Tensor:
        return scale * (mean_gram(values, guide) - gram).square().flatten(1).sum(1)

    return loss
