"""Pictures that the page sends: read by the readers for untrusted ones, and written again as what these have read."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from tnst_mi.errors import InputError
from tnst_mi.io.pictures.png import eight_bits
from tnst_mi.losses.pictures import GreyImage, read_image
from tnst_mi.machine.terminal import displayable, one_line


def read_upload(name: str, body: bytes) -> GreyImage:
    """Read a picture that was sent.

    Args:
        name: that it had where it came from, for messages.
        body: the bytes of its file.

    Raises:
        InputError: it cannot be read as a picture.
    """
    with tempfile.TemporaryDirectory(prefix="tnst_mi-") as folder:
        path = Path(folder) / "uploaded"
        path.write_bytes(body)
        try:
            return read_image(path)
        except InputError as error:
            raise InputError(one_line(str(error).replace(str(path), displayable(name)))) from None


def as_png(pixels: np.ndarray, alpha: np.ndarray | None = None) -> bytes:
    """A picture (H, W) or (H, W, 3) in [0, 1] as PNG of 8 bits, with its transparency (H, W) in [0, 1] if any."""
    picture, encoded = Image.fromarray(eight_bits(pixels)), io.BytesIO()
    if alpha is not None:
        picture.putalpha(Image.fromarray(eight_bits(alpha)))
    picture.save(encoded, "PNG")
    return encoded.getvalue()


def picture_as_png(picture: GreyImage) -> bytes:
    """A picture as PNG of 8 bits, with its colours and its transparency."""
    return as_png(picture.colours if picture.coloured else picture.grey, picture.alpha)
