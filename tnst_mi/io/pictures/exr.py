"""OpenEXR pictures: one float32 luminance channel, or red, green and blue, with the render settings in the header."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR

from tnst_mi.io.atomic import write_failure, written_whole


def write_exr(path: Path, image: np.ndarray, attributes: dict[str, float | str | tuple[float, float]]) -> None:
    """Write a picture losslessly.

    Args:
        path: the file, ending in .exr.
        image: (H, W), stored as channel Y, or (H, W, 3), stored as R, G and B; linear values, row 0 at the top.
        attributes: header entries by name.
    """
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **attributes}
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    with written_whole(path) as temporary, OpenEXR.File(header, {"Y" if pixels.ndim == 2 else "RGB": pixels}) as file:
        try:
            file.write(str(temporary))
        except RuntimeError as error:
            raise write_failure(temporary, str(error)) from error


def read_exr(path: Path) -> np.ndarray:
    """Read a picture that `write_exr` wrote: (H, W) or (H, W, 3) float32."""
    with OpenEXR.File(str(path)) as file:
        channels = file.channels()
        return np.array(channels["Y" if "Y" in channels else "RGB"].pixels)
