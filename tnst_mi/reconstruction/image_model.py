"""What a pixel is taken to be, by what the renderer makes of the extinction along its ray.

Smoke of brightness c before a background b shows c A + b (1 − A), where A = 1 − exp(−∫ σ) is its opacity. Our own
images of emission and absorption (paper Eq. 11) are of this kind with c = 1/γ and b = 0, since
∫ d exp(−γ ∫ d) = (1 − exp(−γ ∫ d)) / γ. So the extinction σ = γ d is what images decide, and γ only its unit; c is
known, or found together with it, which needs smoke that is thick somewhere: thin smoke shows c σ alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

#: Share of a parameter's scale by which Adam changes it in a step, at most.
RATE = 0.02

#: The brightness at the start, if it is to be found, over the largest value of any picture.
_BRIGHTER = 1.25


@dataclass
class ImageModel:
    """The brightness of smoke and the value of the background, both linear, and whether they are found or given.

    Attributes:
        brightness, background: tensors without dimensions, in units of the pictures' peak.
    """

    brightness: Tensor
    background: Tensor

    @classmethod
    def starting(cls, brightness: float | None, background: float | None, border: float) -> ImageModel:
        """The model at the start.

        Args:
            brightness: what is known of it, in units of the peak; None if it is to be found.
            background: likewise.
            border: typical value of the pixels at the pictures' edges, in the same units.
        """
        return cls(
            torch.tensor(_BRIGHTER if brightness is None else brightness, requires_grad=brightness is None),
            torch.tensor(border if background is None else background, requires_grad=background is None),
        )

    @property
    def unknown(self) -> list[Tensor]:
        """What is to be found."""
        return [value for value in (self.brightness, self.background) if value.requires_grad]

    def pixels(self, opacity: Tensor, background: Tensor | None) -> Tensor:
        """The values of pixels, by the smoke's opacity (V, rows, columns) and pictures of the background, if any."""
        behind = self.background if background is None else background
        return self.brightness * opacity + behind * (1 - opacity)

    def keep_possible(self) -> None:
        """Bring what was changed back to where values are possible: smoke that shines, light that is not negative."""
        with torch.no_grad():
            if self.brightness.requires_grad:
                self.brightness.clamp_(min=1e-3)
            if self.background.requires_grad:
                self.background.clamp_(min=0.0)
