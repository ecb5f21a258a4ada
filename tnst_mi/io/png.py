"""PNG previews: the linear value clipped to [0, 1] as 8 bits, without gamma or any other tone curve."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from tnst_mi.io.atomic import written_whole


def write_png(path: Path, image: np.ndarray) -> None:
    """Write a grey (H, W) picture, row 0 at the top: 0 is black, 1 and above white."""
    pixels = np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
    with written_whole(path) as temporary:
        Image.fromarray(pixels).save(temporary)
