"""Images of the smoke as the network takes them."""

from __future__ import annotations

from torch import Tensor

#: The name, among layers, of the image itself: three channels of display values.
PIXELS = "pixels"


def as_rgb(images: Tensor, in_colour: bool = True) -> Tensor:
    """Turn (N, H, W) grey, or (N, H, W, 3), into (N, 3, H, W), without copying but for what is made grey.

    Args:
        images: of the smoke.
        in_colour: whether colours are to be seen; else their mean is.
    """
    if images.ndim == 4 and in_colour:
        return images.permute(0, 3, 1, 2)
    grey = images.mean(3) if images.ndim == 4 else images
    return grey[:, None].expand(-1, 3, -1, -1)
