"""The palette of a picture: which colours it has, and how much of each, wherever they are."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tnst_mi.errors import InputError
from tnst_mi.losses.evaluation import BoundTerm, Features
from tnst_mi.losses.guided import Guide, LayerTarget
from tnst_mi.losses.images import PIXELS
from tnst_mi.losses.sliced import sliced_distance
from tnst_mi.losses.style import require_opaque
from tnst_mi.losses.terms import PictureTerm, parameter_of
from tnst_mi.network.googlenet import GoogLeNet

#: The golden ratio.
_PHI = (1 + np.sqrt(5)) / 2


@dataclass(frozen=True, eq=False)
class Palette(PictureTerm):
    """Give the smoke the colours of a picture: the sliced Wasserstein distance of their distributions in RGB.

    Pixels count by the opacity of the smoke, those of the picture by its alpha. Only the colours of the smoke follow
    it: its density takes on no strokes by it.

    Args:
        image: a path or a `GreyImage`, cropped and resized as in `Style`.
    """

    @property
    def name(self) -> str:
        """The picture."""
        return f"palette {self.picture.name}"

    def mean_square(self, height: int, width: int) -> float:
        """The mean of ‖c‖² over the picture's colours c, for images of height x width pixels.

        A third of it times the loss is the squared distance of display values, averaged over the directions.
        """
        picture = self.picture.fitted(height, width)
        return float(np.average(np.square(picture.colours).sum(2), weights=picture.alpha))

    def bind_term(self, net: GoogLeNet, height: int, width: int) -> BoundTerm:
        """Take the colours of the picture, of which the network sees nothing.

        Raises:
            InputError: it is transparent where it is used, or black: distances are relative to how bright it is.
        """
        picture, kind = self.picture.fitted(height, width), parameter_of(net)
        colours = torch.as_tensor(picture.colours).to(kind).permute(2, 0, 1)[None]
        guide = None
        if picture.alpha is not None:
            require_opaque(picture.alpha, picture.name, "where it is used")
            guide = Guide(torch.as_tensor(picture.alpha).to(kind)[None])
        if not self.mean_square(height, width) > 0.0:
            raise InputError(
                f"{picture.name}: black all over where it is used (its centre, with the aspect {width}:{height}), "
                "which is no palette; use a picture with a colour there, or colour = 'off'"
            )
        distance = sliced_distance(LayerTarget(colours, guide), 1.0, _directions().to(kind))

        def loss(features: Features, guide: Guide | None) -> Tensor:
            return distance(features[PIXELS], guide)

        return BoundTerm((PIXELS,), loss, of_smoke=True, of_colour=True)


def _directions() -> Tensor:
    """Unit vectors (31, 3) along all axes of symmetry of an icosahedron.

    No direction of RGB is preferred: the sum of their squares, and of their fourth powers, is the same along each. Else
    grey smoke would be drawn to colours that a grey picture does not have.
    """
    ends = []
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for signs in itertools.product((1.0, -1.0), repeat=2):
            corners = ((0.0, signs[0] * _PHI, 1.0), (0.0, 1 / _PHI, signs[0] * _PHI))
            edges = (1.0, signs[0] * _PHI, signs[1] * _PHI**2)
            ends += [[of[i] for i in (a, b, c)] for of in (*corners, edges)]
        ends.append([float(i == a) for i in range(3)])
    ends += [[1.0, *signs] for signs in itertools.product((1.0, -1.0), repeat=2)]
    lines = np.unique(np.array(ends), axis=0)
    return torch.as_tensor(lines / np.linalg.norm(lines, axis=1, keepdims=True))
