"""Loss terms on the GoogLeNet features of images of the smoke.

    objective = Style("fire.png", {"conv2/3x3": 1.0}) + 0.5 * Semantic("inception_4b/pool_proj", (16,))
    bound = objective.bind(net, height, width)      # once per octave: computes the targets
    bound = bound.calibrated(first_images)          # each term's image gradient gets RMS 1
    loss = bound(images)                            # (N, H, W) → scalar

A bound term gives the loss of each view, and the objective sums them over a batch; lower is better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from tnst_mi.errors import InputError
from tnst_mi.losses.evaluation import BoundTerm, Features, as_rgb
from tnst_mi.losses.feature_maps import resampled
from tnst_mi.losses.guided import Guide, mean_gram, mean_over_view
from tnst_mi.losses.objective import Term
from tnst_mi.losses.pictures import GreyImage, read_image, resized
from tnst_mi.network.googlenet import LOGITS, GoogLeNet


@dataclass(frozen=True, eq=False)
class Semantic(Term):
    """Activate channels of a layer: L = -mean F_c + damping · mean |F_k| over the other channels k.

    This is how the authors' program maximises the mean; the paper's Eq. 5 is `Match`.
    """

    layer: str
    channels: Sequence[int]
    damping: float = 0.0

    @property
    def name(self) -> str:
        """The layer and its channels."""
        return f"semantic {self.layer}:{','.join(map(str, self.channels))}"

    def bind_term(self, net: GoogLeNet, height: int, width: int) -> BoundTerm:
        """Check the layer and the channels; there are no targets."""
        if not self.channels:
            raise InputError(f"semantic layer {self.layer!r}: no channel is given; name at least one")
        net.check_channels(self.layer, self.channels)
        layer = net.resolve(self.layer)
        rest = set(range(net.channels(self.layer))) - set(self.channels)
        # Kept on the device, where lists would be sent anew in every evaluation.
        chosen, others = (
            torch.tensor(sorted(channels), dtype=torch.long, device=_parameter(net).device)
            for channels in (set(self.channels), rest)
        )

        def loss(features: Features, guide: Guide | None) -> Tensor:
            values = features[layer]
            found = -mean_over_view(values.index_select(1, chosen), guide)
            if self.damping and rest:
                found = found + self.damping * mean_over_view(values.index_select(1, others).abs(), guide)
            return found

        return BoundTerm((layer,), loss)


@dataclass(frozen=True, eq=False)
class ClassTag(Term):
    """Make the network recognise a class, such as "volcano": L = -logit."""

    tag: str

    @property
    def name(self) -> str:
        """The tag."""
        return f"tag {self.tag}"

    def bind_term(self, net: GoogLeNet, height: int, width: int) -> BoundTerm:
        """Look up the tag."""
        return Semantic(LOGITS, (net.class_index(self.tag),)).bind_term(net, height, width)


@dataclass(frozen=True, eq=False)
class Match(Term):
    """Match a map M of features: L = mean (F - M)² (paper Eq. 5).

    M has the layer's C channels, or one for all of them, and any height and width: (C, H, W), or what broadcasts to
    that. It is resampled to the size that the layer has in each octave (`feature_maps.resampled`).
    """

    layer: str
    target_map: np.ndarray

    @property
    def name(self) -> str:
        """The layer."""
        return f"match {self.layer}"

    def bind_term(self, net: GoogLeNet, height: int, width: int) -> BoundTerm:
        """Resample the map to the layer; raises `InputError` if its channels are not the layer's."""
        layer = net.resolve(self.layer)
        blank = torch.zeros(1, height, width).to(_parameter(net))
        shape = net(as_rgb(blank), layers=[layer])[layer].shape[1:]
        target = torch.as_tensor(np.asarray(self.target_map)).to(_parameter(net))
        return _match(layer, resampled(target, shape, self.name))


@dataclass(frozen=True, eq=False)
class Content(Term):
    """Match the features of a picture: L = mean (F - F_picture)² (paper Eq. 5).

    The picture, a path or a `GreyImage`, is converted to grey, cropped and resized as in `Style`; its alpha is ignored.
    """

    image: str | Path | GreyImage
    layer: str
    picture: GreyImage = field(init=False)

    def __post_init__(self) -> None:
        """Read the picture immediately; raises `InputError` if it cannot be used."""
        object.__setattr__(self, "picture", _grey_image(self.image))

    @property
    def name(self) -> str:
        """The picture and the layer."""
        return f"content {self.picture.name} {self.layer}"

    def bind_term(self, net: GoogLeNet, height: int, width: int) -> BoundTerm:
        """Evaluate the network on the picture."""
        layer = net.resolve(self.layer)
        return _match(layer, _picture_features(net, self.picture.fitted(height, width), [layer])[layer][0])


@dataclass(frozen=True, eq=False)
class Style(Term):
    """Match the Gram matrices G = FᵀF of a picture (paper Eq. 6 and 7).

    L = Σ_l w_l ‖G_l - G_l(picture)‖² / ‖G_l(picture)‖², the relative squared distance, or, with the `distance` "paper",
    Eq. 7: L = Σ_l w_l ‖G_l - G_l(picture)‖² / (4 C_l² A_l²) with the channels C and the area A of each layer. There,
    each layer keeps the magnitude of its own features and, at equal weights, one layer dominates (conv2/3x3 of the BVLC
    network outweighs inception_3b/output by 38 to 1). With division by the target's norm, layers of equal weight
    contribute equally.

    The picture, a path or a `GreyImage`, is centre-cropped and resized to the image, so that the areas are equal;
    its alpha, resized to the feature map, multiplies its features.
    """

    image: str | Path | GreyImage
    layers: Mapping[str, float]
    distance: str = "gram"
    picture: GreyImage = field(init=False)

    def __post_init__(self) -> None:
        """Read the picture immediately; raises `InputError` if it cannot be used."""
        if not self.layers:
            raise InputError("style layers: there is none; name at least one")
        object.__setattr__(self, "picture", _grey_image(self.image))

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
        picture = self.picture.fitted(height, width)
        where = f"where it is used (its centre, with the aspect {width}:{height})"
        _require_opaque(picture.alpha, picture.name, where)
        # The picture itself is judged, since in images of a few pixels any is flat.
        if self.picture.flat(height, width):
            raise InputError(
                f"{picture.name}: one grey all over {where}, which is no style; use a picture with structure there"
            )
        grams = {}
        for layer, values in _picture_features(net, picture, list(weights)).items():
            if values.ndim != 4:
                raise InputError(f"style layer {layer!r}: it has no positions to sum over; use a layer before it")
            if picture.alpha is not None:
                rows, columns = values.shape[2:]
                alpha = resized(picture.alpha, rows, columns)
                _require_opaque(alpha, picture.name, where)
                values = values * torch.as_tensor(alpha).to(values)
            grams[layer] = mean_gram(values)
            if not grams[layer].any():
                raise InputError(
                    f"{picture.name}: no channel of style layer {layer!r} responds to it; use another layer, or check "
                    "the network's weights"
                )
        # `mean_gram` is G / A already, which leaves 4 C² of Eq. 7's divisor.
        scales = {
            layer: weights[layer] / (4 * len(gram[0]) ** 2 if self.distance == "paper" else gram.square().sum())
            for layer, gram in grams.items()
        }

        def loss(features: Features, guide: Guide | None) -> Tensor:
            distances = [
                scales[layer] * (mean_gram(features[layer], guide) - gram).square().flatten(1).sum(1)
                for layer, gram in grams.items()
            ]
            return torch.stack(distances).sum(0)

        return BoundTerm(tuple(grams), loss)


def _require_opaque(alpha: np.ndarray | None, name: str, where: str) -> None:
    """Raise `InputError` if nothing of a picture is seen."""
    if alpha is not None and not alpha.any():
        raise InputError(f"{name}: transparent {where}; use a picture that is opaque there")


def _match(layer: str, target: Tensor) -> BoundTerm:
    def loss(features: Features, guide: Guide | None) -> Tensor:
        return mean_over_view((features[layer] - target).square(), guide)

    return BoundTerm((layer,), loss)


def _grey_image(image: str | Path | GreyImage) -> GreyImage:
    return image if isinstance(image, GreyImage) else read_image(image)


def _picture_features(net: GoogLeNet, picture: GreyImage, layers: Sequence[str]) -> Features:
    return net(as_rgb(torch.as_tensor(picture.grey)[None].to(_parameter(net))), layers=layers)


def _parameter(net: GoogLeNet) -> Tensor:
    """A tensor with the network's device and precision."""
    return next(net.parameters())
