"""Texture: how far the features of pictures are distributed from those of a style, by the sliced Wasserstein distance.

Of two sets of vectors, the sliced Wasserstein distance (Bonneel et al. 2015; as a texture statistic, Heitz et al. 2021)
is that of their projections on a direction, which is the distance of their sorted values, root mean square over many
directions. It sees all of a distribution; a Gram matrix sees only its second moments.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from quality_measures.crops import Picture, drawn
from quality_measures.judge import features, shares
from tnst_mi import GoogLeNet

#: Directions on which features are projected, and quantiles that are compared on each.
DIRECTIONS, QUANTILES = 128, 512

#: Features that are compared of each layer, at most: every n-th, if there are more.
MOST = 4096


def sliced_wasserstein(one: Tensor, other: Tensor, directions: int = DIRECTIONS, seed: int = 0) -> float:
    """Sliced Wasserstein distance W₂ ≥ 0 of two sets of vectors, (N, C) and (M, C), in the unit of their components.

    The same seed gives the same directions. Sets of different size are compared by 512 quantiles.
    """
    generator = torch.Generator().manual_seed(seed)
    axes = torch.randn(one.shape[1], directions, generator=generator, dtype=torch.float64)
    axes = (axes / axes.norm(dim=0)).to(one.device)
    projected = [(vectors.double() @ axes).sort(dim=0).values for vectors in (one, other)]
    if len(one) != len(other):
        projected = [_quantiles(values) for values in projected]
    return float((projected[0] - projected[1]).square().mean().sqrt())


def _quantiles(ordered: Tensor) -> Tensor:
    """Evenly spaced quantiles (512, K), interpolated, of sorted values (N, K)."""
    place = torch.linspace(0, len(ordered) - 1, QUANTILES, dtype=ordered.dtype, device=ordered.device)
    low = place.floor().long()
    high = (low + 1).clamp(max=len(ordered) - 1)
    return torch.lerp(ordered[low], ordered[high], (place - low)[:, None])


def samples(judge: GoogLeNet, pictures: Sequence[Picture], seed: int = 0) -> dict[str, Tensor]:
    """The judge's features (N, C) by layer, at positions inside the pieces that are drawn from pictures of one size."""
    grey, inside = drawn(pictures, seed)
    found = {}
    for layer, values in features(judge, grey).items():
        # Only a position that is wholly outside has nothing of the smoke; pieces of thin smoke may have no other whole.
        counted = shares(inside, *values.shape[2:]) >= 0.5
        vectors = values.permute(0, 2, 3, 1)[counted]
        found[layer] = vectors[:: -(-len(vectors) // MOST)]
    return found


def texture_distances(judge: GoogLeNet, pictures: Sequence[Picture], style: Picture, seed: int = 0) -> dict[str, float]:
    """Sliced Wasserstein distance of pictures to a style, all of one size, by layer of the judge.

    The style is taken as if seen as often as the pictures, with the same seeds: of itself it has a distance of 0.
    """
    of_style = samples(judge, [style] * len(pictures), seed)
    of_pictures = samples(judge, pictures, seed)
    return {layer: sliced_wasserstein(of_pictures[layer], of_style[layer], seed=seed) for layer in of_style}


def relative_texture(after: dict[str, float], before: dict[str, float]) -> float:
    """The distances of a stylization relative to those of the unstylized smoke, mean over the layers.

    1 is no nearer to the style than the input.
    """
    return float(np.mean([after[layer] / before[layer] for layer in before]))
