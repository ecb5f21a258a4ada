"""8-bit PNG pictures from values clipped to [0, 1]; callers that want the sRGB curve apply it themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from tnst_mi.io.atomic import written_whole


def write_png(path: Path, image: np.ndarray) -> None:
    """Write a grey (H, W) or colour (H, W, 3) picture, row 0 at the top: 0 is black, 1 and above white."""
    with written_whole(path) as temporary:
        Image.fromarray(eight_bits(image)).save(temporary)


def eight_bits(image: np.ndarray) -> np.ndarray:
    """Clip values to [0, 1] and quantise them to 0 to 255."""
    return np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)


def srgb(linear: np.ndarray) -> np.ndarray:
    """Clip linear values to [0, 1] and apply the sRGB curve (IEC 61966-2-1), for pictures meant for viewing."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
