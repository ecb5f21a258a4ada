"""What a pixel is taken to be, by what the renderer makes of the extinction along its ray.

Smoke of brightness c before a background b shows c A + b (1 − A), where A = 1 − exp(−∫ σ) is its opacity. Our own
images of emission and absorption (paper Eq. 11) are of this kind with c = 1/γ and b = 0, since
∫ d exp(−γ ∫ d) = (1 − exp(−γ ∫ d)) / γ. So the extinction σ = γ d is what images decide, and γ only its unit.

Where c or b is not known, it is solved for in each step: pixels are linear in both, so that for given opacities the
best ones are those of a linear least-squares problem, and what is left depends on σ alone (variable projection, Golub
and Pereyra 1973). Thin smoke shows c σ alone: c is found only as well as smoke is thick somewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

#: The brightness to begin with, if it is to be found, over the largest value of any picture.
BRIGHTER = 1.25

#: Opacities of less than this, squared and averaged, tell nothing of the brightness.
_NOTHING = 1e-8


@dataclass
class ImageModel:
    """The brightness of smoke and the value of the background, both linear, and which of them is to be found.

    Attributes:
        brightness, background: in units of the pictures' peak.
        find_brightness, find_background: whether they are to be found.
    """

    brightness: float
    background: float
    find_brightness: bool = False
    find_background: bool = False

    @property
    def complete(self) -> bool:
        """Whether there is nothing to be found."""
        return not (self.find_brightness or self.find_background)

    def pixels(self, opacity: Tensor, background: Tensor | None) -> Tensor:
        """The values of pixels, by the smoke's opacity and a picture of the background, if there is one."""
        behind = self.background if background is None else background
        return self.brightness * opacity + behind * (1 - opacity)

    def fit(self, views: Sequence[tuple[Tensor, Tensor, Tensor, Tensor | None]]) -> None:
        """Find what is to be found, for given opacities: of each view opacity, values, weights and background."""
        normal, right = torch.zeros(2, 2, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
        for opacity, values, weights, behind in views:
            opacity, weights = opacity.detach().double().cpu(), weights.double().cpu()
            columns = [opacity, 1 - opacity]
            rest = values.double().cpu() - (0 if behind is None else behind.double().cpu() * columns[1])
            if behind is not None:
                columns[1] = torch.zeros_like(opacity)
            for i in range(2):
                right[i] += (weights * columns[i] * rest).sum()
                for j in range(2):
                    normal[i, j] += (weights * columns[i] * columns[j]).sum()
        count = sum(opacity.numel() for opacity, *_ in views)
        if normal[0, 0] < _NOTHING * count:
            return
        chosen = [i for i, wanted in enumerate((self.find_brightness, self.find_background)) if wanted]
        known = torch.tensor([self.brightness, self.background], dtype=torch.float64)
        known[chosen] = 0
        # Of views that all have pictures of their background, there is no other one to find.
        chosen = [i for i in chosen if normal[i, i] > 0]
        solved = torch.linalg.lstsq(normal[chosen][:, chosen], (right - normal @ known)[chosen, None]).solution
        for i, value in zip(chosen, solved[:, 0].tolist(), strict=True):
            if i == 0:
                self.brightness = max(value, 1e-3)
            else:
                self.background = max(value, 0.0)
