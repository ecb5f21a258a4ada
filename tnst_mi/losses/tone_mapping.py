"""Tone mapping: pictures of high dynamic range as the display values that the network knows.

Reinhard et al. 2002, with the brightest value as white: luminances are scaled such that their logarithmic mean is 0.18,
L ↦ L (1 + L / L_white²) / (1 + L) brings them into [0, 1], and the sRGB curve follows. The unit of the values does not
matter.
"""

from __future__ import annotations

import numpy as np

from tnst_mi.io.pictures.srgb import LUMINANCE, srgb

_MIDDLE_GREY = 0.18


def tone_mapped(linear: np.ndarray) -> np.ndarray:
    """Display values of a picture.

    Args:
        linear: (H, W, 3), linear, finite; negative values count as 0.

    Returns:
        (H, W, 3) float32 in [0, 1].
    """
    linear = np.maximum(linear, 0.0, dtype=np.float32)
    # In double precision: float32 has values whose sum, or whose ratio to the mean, it has not.
    luminance = linear @ LUMINANCE.astype(np.float64)
    if not luminance.any():
        return np.zeros(linear.shape, np.float32)
    scale = _MIDDLE_GREY / np.exp(np.log(luminance[luminance > 0]).mean())
    white = scale * luminance.max()
    for colours, row in zip(linear, luminance, strict=True):
        scaled = scale * row
        factor = scale * (1 + scaled / white**2) / (1 + scaled)
        colours[...] = np.minimum(colours * factor[:, None], 1.0)
    return srgb(linear)
