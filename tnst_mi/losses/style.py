"""The style of a picture: its statistics in some layers of the network, whatever is where.

What is compared of the features of a layer is a choice, and so is whether all positions of an image count or those that
show smoke; `losses.gram`, `losses.sliced` and `losses.nearest` have the formulas, and docs/losses.md when to use which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tnst_mi.errors import InputError
from tnst_mi.losses.evaluation import BoundTerm, Features
from tnst_mi.losses.gram import gram_distance, paper_distance
from tnst_mi.losses.guided import Guide, LayerLoss, LayerTarget
from tnst_mi.losses.nearest import nearest_distance
from tnst_mi.losses.pictures import resized
from tnst_mi.losses.sizes import coarser_sizes, layer_at
from tnst_mi.losses.sliced import directions, sliced_distance
from tnst_mi.losses.terms import PictureTerm, picture_features
from tnst_mi.network.googlenet import GoogLeNet

#: The seed of what a loss draws where none is given.
_SEED = (0,)


@dataclass(frozen=True, eq=False)
class Style(PictureTerm):
    """Match the statistics that the features of a picture have in some layers: L = Σ_l w_l distance_l.

    Distances are relative to what the picture's features are, so that layers of equal weight contribute equally; only
    "paper" has the constants of Eq. 7 instead, by which one layer dominates.

    The picture is centre-cropped and resized to the image, and grey unless the smoke is in colour. Its alpha, resized
    to the feature map, multiplies its features, as an image of smoke is black where there is none; in statistics of the
    smoke it is the weight of a position instead.

    Args:
        image: a path or a `GreyImage`.
        layers: weights w_l by layer.
        distance: one of `tnst_mi.choices.STYLE_LOSSES`.
        statistics: one of `tnst_mi.choices.STYLE_STATISTICS`.
        colour: whether the picture's colours count.
        octaves: number of sizes in which an image is seen: its own, and those of coarser octaves, all alike.
        ratio: of the sizes of neighbouring octaves.

    Raises:
        InputError: the picture cannot be used, or there is no layer.
    """

    layers: Mapping[str, float]
    distance: str = "gram"
    statistics: str = "image"
    colour: bool = False
    octaves: int = 1
    ratio: float = 1.8

    def __post_init__(self) -> None:
        """Read the picture."""
        if not self.layers:
            raise InputError("style layers: there is none; name at least one")
        super().__post_init__()

    @property
    def name(self) -> str:
        """The picture."""
        return f"style {self.picture.name}"

    def bind_term(self, net: GoogLeNet, height: int, width: int) -> BoundTerm:
        """Evaluate the network on the picture."""
        weights: dict[str, float] = {}
        for layer, weight in self.layers.items():
            # A layer may occur twice, under its name and under an alias.
            weights[net.resolve(layer)] = weights.get(net.resolve(layer), 0.0) + weight
        coarser = coarser_sizes(height, width, self.ratio, self.octaves - 1)
        targets = {
            layer_at(layer, size): (target, weights[layer] / (1 + len(coarser)))
            for size in (None, *coarser)
            for layer, target in self._targets(net, list(weights), *(size or (height, width))).items()
        }

        def drawn(seed: Sequence[int]) -> BoundTerm:
            losses = {
                layer: self._layer_loss(target, weight, (*seed, number))
                for number, (layer, (target, weight)) in enumerate(targets.items())
            }

            def loss(features: Features, guide: Guide | None) -> Tensor:
                return torch.stack([of_layer(features[layer], guide) for layer, of_layer in losses.items()]).sum(0)

            return BoundTerm(
                tuple(losses),
                loss,
                of_smoke=self.statistics == "smoke",
                drawn=drawn if self.distance == "swd" else None,
                in_colour=self.colour and self.picture.coloured,
            )

        return drawn(_SEED)

    def _targets(self, net: GoogLeNet, layers: Sequence[str], height: int, width: int) -> dict[str, LayerTarget]:
        """The features of the picture by layer."""
        picture = self.picture.fitted(height, width)
        where = f"where it is used (its centre, with the aspect {width}:{height})"
        require_opaque(picture.alpha, picture.name, where)
        # The picture itself is judged, since in images of a few pixels any is flat.
        # In colour it may be a palette of one colour, and have its structure in colours alone.
        if not self.colour and self.picture.flat(height, width):
            raise InputError(
                f"{picture.name}: one grey all over {where}, which is no style; use a picture with structure there"
            )
        targets = {}
        for layer, values in picture_features(net, picture, layers, self.colour).items():
            if values.ndim != 4:
                raise InputError(f"style layer {layer!r}: it has no positions to sum over; use a layer before it")
            guide, seen = None, values
            if picture.alpha is not None:
                rows, columns = values.shape[2:]
                alpha = resized(picture.alpha, rows, columns)
                require_opaque(alpha, picture.name, where)
                opaque = torch.as_tensor(alpha).to(values)
                seen = values * opaque
                if self.statistics == "smoke":
                    guide = Guide(opaque[None])
                else:
                    values = seen
            if not seen.any():
                raise InputError(
                    f"{picture.name}: no channel of style layer {layer!r} responds to it; use another layer, or check "
                    "the network's weights"
                )
            targets[layer] = LayerTarget(values, guide)
        return targets

    def _layer_loss(self, target: LayerTarget, weight: float, seed: Sequence[int]) -> LayerLoss:
        """The loss of a layer; `seed` is that of what it draws."""
        if self.distance == "paper":
            return paper_distance(target, weight)
        if self.distance == "swd":
            return sliced_distance(target, weight, directions(target, seed))
        if self.distance == "nnfm":
            return nearest_distance(target, weight)
        gram = gram_distance(target, weight)
        if self.distance == "gram":
            return gram
        histograms = sliced_distance(target, weight, None)
        return lambda values, guide: gram(values, guide) + histograms(values, guide)


def require_opaque(alpha: np.ndarray | None, name: str, where: str) -> None:
    """Raise `InputError` if nothing of a picture is seen."""
    if alpha is not None and not alpha.any():
        raise InputError(f"{name}: transparent {where}; use a picture that is opaque there")
