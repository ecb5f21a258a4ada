"""What a pixel is taken to be, by what the renderer makes of the extinction along its ray.

Smoke of brightness c before a background b shows c A + b (1 − A), where A = 1 − exp(−∫ σ) is its opacity. Our own
images of emission and absorption (paper Eq. 11) are of this kind with c = 1/γ and b = 0, since
∫ d exp(−γ ∫ d) = (1 − exp(−γ ∫ d)) / γ. So the extinction σ = γ d is what images decide, and γ only its unit.

Where b is not known, it is solved for in each step: pixels are linear in it. Where c is not known, it is searched for
(`brightness_search`) by the derivative for given emission c σ: since thin smoke shows c σ alone, the extinction σ
changes along with c, and what is left is how pixels saturate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

#: The brightness to begin with, if it is to be found, over the largest value of any picture.
BRIGHTER = 1.5

#: The least transmittance that a pixel is taken to have.
_OPAQUE = 1e-6

#: A background that shines through less than this, squared and averaged, is not found.
_NOTHING = 1e-8

#: Of a view: the opacity as rendered, values and weights of its picture, and a picture of its background, if there is
#: one; all (rows, columns).
SeenView = tuple[Tensor, Tensor, Tensor, Tensor | None]


@dataclass
class ImageModel:
    """The brightness of smoke and the value of the background, and which of them is to be found.

    Attributes:
        brightness, background: in units of the pictures' peak.
        find_brightness, find_background: whether they are to be found.
    """

    brightness: float
    background: float
    find_brightness: bool = False
    find_background: bool = False

    def pixels(self, opacity: Tensor, background: Tensor | None) -> Tensor:
        """The values of pixels, by the smoke's opacity and a picture of the background, if there is one."""
        behind = self.background if background is None else background
        return self.brightness * opacity + behind * (1 - opacity)

    def fit_background(self, views: Sequence[SeenView]) -> None:
        """Solve for the background of the views that have no picture of it."""
        products, squares, pixels = 0.0, 0.0, 0
        for opacity, values, weights, behind in views:
            if behind is None:
                through = 1 - opacity
                rest = values - self.brightness * opacity
                products += float((weights * through * rest).sum(dtype=torch.float64))
                squares += float((weights * through * through).sum(dtype=torch.float64))
                pixels += opacity.numel()
        if squares > _NOTHING * pixels:
            self.background = max(products / squares, 0.0)

    def slope(self, views: Sequence[SeenView]) -> float:
        """The derivative of the mean square difference between pixels and pictures with respect to 1 / brightness.

        That for given emission: the optical depth of each pixel is in proportion to 1 / brightness.
        """
        total, pixels = 0.0, 0
        for opacity, values, weights, behind in views:
            transmittance = (1 - opacity).clamp(_OPAQUE, 1.0)
            contrast = self.brightness - (self.background if behind is None else behind)
            by_brightness = opacity + contrast / self.brightness * transmittance * transmittance.log()
            rest = self.pixels(opacity, behind) - values
            total += float((weights * 2 * rest * by_brightness).sum(dtype=torch.float64))
            pixels += opacity.numel()
        return -(self.brightness**2) * total / pixels
