"""Loss terms on the GoogLeNet features of images of the smoke, all but those of style (`losses.style`).

    objective = Content("face.png", "inception_4d/output") + 0.5 * Semantic("inception_4b/pool_proj", (16,))
    bound = objective.bind(net, height, width)      # once per octave: computes the targets
    bound = bound.calibrated(first_images)          # each term's image gradient gets RMS 1
    loss = bound(images)                            # (N, H, W) → scalar

A bound term gives the loss of each view, and the objective sums them over a batch; lower is better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from tnst_mi.errors import InputError
from tnst_mi.losses.evaluation import BoundTerm, Features
from tnst_mi.losses.feature_maps import resampled
from tnst_mi.losses.guided import Guide, mean_over_view
from tnst_mi.losses.images import as_rgb
from tnst_mi.losses.objective import Term
from tnst_mi.losses.pictures import GreyImage, read_image
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
            torch.tensor(sorted(channels), dtype=torch.long, device=parameter_of(net).device)
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
        blank = torch.zeros(1, height, width).to(parameter_of(net))
        shape = net(as_rgb(blank), layers=[layer])[layer].shape[1:]
        target = torch.as_tensor(np.asarray(self.target_map)).to(parameter_of(net))
        return _match(layer, resampled(target, shape, self.name))


@dataclass(frozen=True, eq=False)
class PictureTerm(Term):
    """A term of a picture, a path or a `GreyImage`, which is read immediately.

    Raises:
        InputError: it cannot be used.
    """

    image: str | Path | GreyImage
    picture: GreyImage = field(init=False)

    def __post_init__(self) -> None:
        """Read the picture."""
        picture = self.image if isinstance(self.image, GreyImage) else read_image(self.image)
        object.__setattr__(self, "picture", picture)


@dataclass(frozen=True, eq=False)
class Content(PictureTerm):
    """Match the features of a picture: L = mean (F - F_picture)² (paper Eq. 5).

    The picture, a path or a `GreyImage`, is cropped and resized as in `Style`, and grey unless the smoke is in
    `colour`; its alpha is ignored.
    """

    layer: str
    colour: bool = False

    @property
    def name(self) -> str:
        """The picture and the layer."""
        return f"content {self.picture.name} {self.layer}"

    def bind_term(self, net: GoogLeNet, height: int, width: int) -> BoundTerm:
        """Evaluate the network on the picture."""
        layer = net.resolve(self.layer)
        picture = self.picture.fitted(height, width)
        target = picture_features(net, picture, [layer], self.colour)[layer][0]
        return _match(layer, target)._replace(in_colour=self.colour and self.picture.coloured)


def _match(layer: str, target: Tensor) -> BoundTerm:
    def loss(features: Features, guide: Guide | None) -> Tensor:
        return mean_over_view((features[layer] - target).square(), guide)

    return BoundTerm((layer,), loss)


def picture_features(net: GoogLeNet, picture: GreyImage, layers: Sequence[str], colour: bool = False) -> Features:
    """The features of a picture, grey or in colour, by layer, (1, C, H, W) or (1, C)."""
    pixels = torch.as_tensor(picture.colours if colour else picture.grey)
    return net(as_rgb(pixels[None].to(parameter_of(net))), layers=layers)


def parameter_of(net: GoogLeNet) -> Tensor:
    """A tensor with the network's device and precision."""
    return next(net.parameters())
