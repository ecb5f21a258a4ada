"""Style and content pictures: reading them as grey with Pillow, cropping and resizing them to an octave."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from tnst_mi.errors import InputError

# Only formats that Pillow decodes in-process: others, such as EPS, would start external programs.
PICTURE_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "GIF", "WEBP", "PPM")
SIXTEEN_BIT_MODES = ("I", "I;16", "I;16L", "I;16B", "I;16N")


@dataclass(frozen=True, eq=False)
class GreyImage:
    """A grey picture with an optional mask.

    Attributes:
        name: The name in logs and errors, e.g. the file name.
        grey: (H, W) float32 in [0, 1], row 0 at the top.
        alpha: (H, W) float32 in [0, 1], 1 where the picture counts; None means everywhere.

    Raises:
        InputError: A value is not finite.
    """

    name: str
    grey: np.ndarray
    alpha: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        for plane in (self.grey, self.alpha):
            if plane is not None and not np.isfinite(plane).all():
                bad = int((~np.isfinite(plane)).sum())
                raise InputError(f"{self.name}: {bad} of {plane.size} pixels are not finite, expected values in [0, 1]")

    def flat(self, height: int, width: int) -> bool:
        """Whether the largest centred crop of aspect width:height has the same grey, to 8 bits, wherever it counts."""
        left, top, right, bottom = centred_box(self.grey.shape, height, width)
        crop = slice(int(top), math.ceil(bottom)), slice(int(left), math.ceil(right))
        grey = self.grey[crop] if self.alpha is None else self.grey[crop][self.alpha[crop] > 0]
        return not grey.size or float(np.ptp(grey)) < 1 / 255

    def fitted(self, height: int, width: int) -> GreyImage:
        """Return the largest centred crop of aspect width:height, resized to (height, width)."""
        box = centred_box(self.grey.shape, height, width)
        alpha = None if self.alpha is None else resized(self.alpha, height, width, box)
        return GreyImage(self.name, resized(self.grey, height, width, box), alpha)


def read_image(path: str | Path) -> GreyImage:
    """Read a picture as grey: the mean of its three 8-bit channels / 255; an alpha channel is kept separately.

    Palette, one-bit, grey, colour and CMYK pictures are converted to 8-bit RGB, 16-bit grey ones are divided by 65535.
    EXIF orientation is applied; only the first frame of an animation is read.

    Raises:
        InputError: The file is missing, unreadable, has more pixels than Pillow's limit
            (`PIL.Image.MAX_IMAGE_PIXELS`), is less than 2 pixels wide or high, or is wholly transparent.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such picture file; give the path of a PNG or JPEG picture")
    pixels, full_scale = _decode(path)
    height, width = pixels.shape[:2]
    if min(height, width) < 2:
        raise InputError(f"{path}: the picture has {width} x {height} pixels; use one of at least 2 x 2")
    if pixels.ndim == 2:
        return GreyImage(path.name, pixels.astype(np.float32) / full_scale)
    grey = pixels[..., :3].mean(-1, dtype=np.float32) / full_scale
    if pixels.shape[-1] == 3:
        return GreyImage(path.name, grey)
    if not pixels[..., 3].any():
        raise InputError(f"{path}: alpha is 0 in every pixel; use a picture that is not wholly transparent")
    return GreyImage(path.name, grey, pixels[..., 3].astype(np.float32) / full_scale)


def centred_box(shape: tuple[int, int], height: int, width: int) -> tuple[float, float, float, float]:
    """Return (left, top, right, bottom) in pixels of the largest centred crop of aspect width:height."""
    rows, columns = shape
    box_width = min(columns, rows * width / height)
    box_height = min(rows, columns * height / width)
    left, top = (columns - box_width) / 2, (rows - box_height) / 2
    return left, top, left + box_width, top + box_height


def resized(
    plane: np.ndarray, height: int, width: int, box: tuple[float, float, float, float] | None = None
) -> np.ndarray:
    """Resize one (H, W) plane, or the box (left, top, right, bottom) of it, to (height, width).

    Pillow's BICUBIC in float32: Keys' kernel with a = -1/2, widened when shrinking so that it antialiases.
    Its overshoot is clipped to [0, 1].
    """
    image = Image.fromarray(np.ascontiguousarray(plane, np.float32))
    return np.clip(np.asarray(image.resize((width, height), Image.Resampling.BICUBIC, box)), 0.0, 1.0)


def _decode(path: Path) -> tuple[np.ndarray, np.float32]:
    """Return the pixels as stored, (H, W), (H, W, 3) or (H, W, 4), and their full-scale value, which maps to 1."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path, formats=PICTURE_FORMATS) as file:
                return _pixels(ImageOps.exif_transpose(file))
    except (Image.DecompressionBombWarning, Image.DecompressionBombError):
        limit = Image.MAX_IMAGE_PIXELS
        raise InputError(f"{path}: the picture has more than {limit} pixels; make it smaller") from None
    except UnidentifiedImageError:
        raise InputError(f"{path}: not a picture in a known format; use one of {', '.join(PICTURE_FORMATS)}") from None
    except Exception as error:  # Pillow's decoders raise many types on damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: unreadable picture ({reason}); save it again as PNG or JPEG") from None


def _pixels(image: Image.Image) -> tuple[np.ndarray, np.float32]:
    if image.mode == "F":
        raise ValueError("floating-point pixels have no known range")
    if image.mode in SIXTEEN_BIT_MODES:
        pixels = np.asarray(image)
        if pixels.min() < 0 or pixels.max() > 65535:
            raise ValueError(f"pixels from {pixels.min()} to {pixels.max()} are not 16-bit")
        return pixels, np.float32(65535)
    return np.asarray(image.convert("RGBA" if image.has_transparency_data else "RGB")), np.float32(255)
