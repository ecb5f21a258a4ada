"""Style and content pictures: reading them as grey with Pillow, cropping and resizing them to an octave."""

from __future__ import annotations

import importlib
import math
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from tnst_mi.errors import InputError
from tnst_mi.io.pictures.exr import read_linear
from tnst_mi.io.pictures.radiance import MAGIC as RADIANCE
from tnst_mi.io.pictures.radiance import read_radiance
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.losses.tone_mapping import tone_mapped
from tnst_mi.machine.gate import decoding, silenced

# Only formats that Pillow decodes in-process: others, such as EPS, would start external programs.
PICTURE_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "GIF", "WEBP", "PPM", "AVIF", "HEIF")
#: All formats that are read.
READABLE = (*PICTURE_FORMATS, "OpenEXR", "Radiance HDR")
SIXTEEN_BIT_MODES = ("I", "I;16", "I;16L", "I;16B", "I;16N")


_OPENEXR = b"\x76\x2f\x31\x01"

#: Brands of files in the container that AVIF and HEIC share.
_AVIF, _HEIC = (b"avif", b"avis"), (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")

#: Pixels of a picture that a file of any size may have, and those for each of its bytes beyond that: for files that
#: Pillow reads, and for those of high dynamic range, whose pixels take more memory.
_PIXELS, _LINEAR_PIXELS = (1 << 24, 160), (1 << 23, 4)

#: Difference of the channels of a pixel up to which it counts as grey: what compressing a grey picture leaves.
_COLOURLESS = 8 / 255

#: Standard deviation of grey below which a picture is nearly flat.
_FLAT = 0.02


@dataclass(frozen=True, eq=False)
class GreyImage:
    """A grey picture with an optional mask, and the colours that it was made grey from.

    Attributes:
        name: The name in logs and errors, e.g. the file name.
        grey: (H, W) float32 in [0, 1], row 0 at the top.
        alpha: (H, W) float32 in [0, 1], 1 where the picture counts; None means everywhere.
        remarks: What is worth saying about it.
        rgb: (H, W, 3) float32 in [0, 1], the display values of its colours; None if it has none.

    Raises:
        InputError: A value is not finite.
    """

    name: str
    grey: np.ndarray
    alpha: np.ndarray | None = None
    remarks: tuple[str, ...] = ()
    rgb: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        for plane in (self.grey, self.alpha, self.rgb):
            if plane is not None and not np.isfinite(plane).all():
                bad = int((~np.isfinite(plane)).sum())
                raise InputError(f"{self.name}: {bad} of {plane.size} pixels are not finite, expected values in [0, 1]")

    @property
    def colours(self) -> np.ndarray:
        """(H, W, 3): the colours, or the grey three times."""
        return np.repeat(self.grey[..., None], 3, axis=2) if self.rgb is None else self.rgb

    @property
    def coloured(self) -> bool:
        """Whether the channels differ visibly anywhere."""
        return self.rgb is not None and float(np.ptp(self.rgb, axis=2).max()) > _COLOURLESS

    @property
    def mean_colour(self) -> np.ndarray:
        """(3,): the mean of the colours where the picture counts."""
        weights = np.ones_like(self.grey) if self.alpha is None else self.alpha
        total = float(weights.sum(dtype=np.float64))
        return (np.einsum("ij,ijc->c", weights, self.colours, dtype=np.float64) / total).astype(np.float32)

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
        rgb = None if self.rgb is None else resized(self.rgb, height, width, box)
        return GreyImage(self.name, resized(self.grey, height, width, box), alpha, rgb=rgb)


def read_image(path: str | Path) -> GreyImage:
    """Read a picture as grey: the mean of its three 8-bit channels / 255; alpha and colours are kept separately.

    Palette, one-bit, grey, colour and CMYK pictures are converted to 8-bit RGB, 16-bit grey ones are divided by 65535.
    EXIF orientation is applied; only the first frame of an animation is read. OpenEXR and Radiance pictures are linear:
    with values above 1 they are tone mapped (`tnst_mi.losses.tone_mapping`), otherwise they get the curve of sRGB.

    Raises:
        InputError: The file is missing, unreadable, has more pixels than Pillow's limit (`PIL.Image.MAX_IMAGE_PIXELS`)
            or than a file of its size may have, is less than 2 pixels wide or high, or is wholly transparent.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such picture file; give the path of a PNG or JPEG picture")
    with decoding(path, "a picture"), silenced():
        pixels, full_scale, remarks = _decode(path)
    height, width = pixels.shape[:2]
    if min(height, width) < 2:
        raise InputError(f"{path}: the picture has {width} x {height} pixels; use one of at least 2 x 2")
    if pixels.ndim == 2:
        return GreyImage(path.name, grey := pixels.astype(np.float32) / full_scale, None, remarks + _flatness(grey))
    grey = pixels[..., :3].mean(-1, dtype=np.float32) / full_scale
    rgb = pixels[..., :3].astype(np.float32) / full_scale
    if pixels.shape[-1] == 3:
        return GreyImage(path.name, grey, None, remarks + _flatness(grey), rgb)
    if not pixels[..., 3].any():
        raise InputError(f"{path}: alpha is 0 in every pixel; use a picture that is not wholly transparent")
    flatness = _flatness(grey[pixels[..., 3] > 0])
    return GreyImage(path.name, grey, pixels[..., 3].astype(np.float32) / full_scale, remarks + flatness, rgb)


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
    """Resize one (H, W) plane, or the box (left, top, right, bottom) of it, to (height, width); or several, (H, W, C).

    Pillow's BICUBIC in float32: Keys' kernel with a = -1/2, widened when shrinking so that it antialiases.
    Its overshoot is clipped to [0, 1].
    """
    if plane.ndim == 3:
        return np.stack([resized(channel, height, width, box) for channel in np.moveaxis(plane, -1, 0)], axis=-1)
    image = Image.fromarray(np.ascontiguousarray(plane, np.float32))
    return np.clip(np.asarray(image.resize((width, height), Image.Resampling.BICUBIC, box)), 0.0, 1.0)


def _flatness(grey: np.ndarray) -> tuple[str, ...]:
    if grey.size == 0 or grey.std() >= _FLAT:
        return ()
    return (f"is nearly flat (grey from {grey.min():.2f} to {grey.max():.2f}), which leaves little to take on",)


def _decode(path: Path) -> tuple[np.ndarray, np.float32, tuple[str, ...]]:
    """The pixels as stored, (H, W), (H, W, 3) or (H, W, 4), their full-scale value, which maps to 1, and remarks."""
    with path.open("rb") as file:
        start = file.read(64)
    if start.startswith((_OPENEXR, *RADIANCE)):
        most = _most_pixels(path, _LINEAR_PIXELS)
        linear = read_linear(path, most) if start.startswith(_OPENEXR) else read_radiance(path, most)
        if not np.isfinite(linear).all():
            raise InputError(f"{path}: {int((~np.isfinite(linear)).sum())} values are not finite; mend the picture")
        if linear[..., :3].max() > 1.0:
            shown = tone_mapped(linear[..., :3])
            remark = "has a high dynamic range: tone mapped (Reinhard, log mean 0.18, then sRGB)"
        else:
            shown = srgb(np.maximum(linear[..., :3], 0.0))
            remark = "is linear, up to 1 at most: taken as that of a display (sRGB)"
        return np.concatenate([shown, np.clip(linear[..., 3:], 0.0, 1.0)], axis=-1), np.float32(1), (remark,)
    return *decoded_by_pillow(path, start), ()


def decoded_by_pillow(path: Path, start: bytes) -> tuple[np.ndarray, np.float32]:
    """The pixels of a file as stored, (H, W), (H, W, 3) or (H, W, 4), and their full-scale value, which maps to 1.

    Args:
        path: the file.
        start: its first bytes, by which some formats are known.

    Raises:
        InputError: it is unreadable, or has more pixels than a file of its size may have.
    """
    formats = _known_formats(path, start)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path, formats=formats) as file:
                if file.width * file.height > (most := _most_pixels(path, _PIXELS)):
                    raise InputError(f"{path}: the picture has more than {most} pixels; make it smaller")
                return _pixels(ImageOps.exif_transpose(file))
    except (InputError, MemoryError):
        raise
    except (Image.DecompressionBombWarning, Image.DecompressionBombError):
        limit = Image.MAX_IMAGE_PIXELS
        raise InputError(f"{path}: the picture has more than {limit} pixels; make it smaller") from None
    except UnidentifiedImageError:
        raise InputError(f"{path}: not a picture in a known format; use one of {', '.join(READABLE)}") from None
    except Exception as error:  # Pillow's decoders raise many types on damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: unreadable picture ({reason}); save it again as PNG or JPEG") from None


def _most_pixels(path: Path, bounds: tuple[int, int]) -> int:
    """The largest number of pixels that is read of a file: a small one that claims many is a bomb."""
    always, per_byte = bounds
    limit = Image.MAX_IMAGE_PIXELS or sys.maxsize
    return min(limit, max(always, per_byte * path.stat().st_size))


def _known_formats(path: Path, start: bytes) -> list[str]:
    """The formats that Pillow can read here, given how a file starts, which may need more than Pillow."""
    brands = start[8:] if start[4:8] == b"ftyp" else b""
    Image.init()
    if any(brand in brands for brand in _AVIF):
        if "AVIF" not in Image.OPEN:
            raise InputError(f"{path}: AVIF needs Pillow 11.3 or later (pip install -U pillow); or save it as PNG")
    elif any(brand in brands for brand in _HEIC):
        try:
            importlib.import_module("pillow_heif").register_heif_opener()
        except ImportError:
            raise InputError(f"{path}: HEIC needs pillow-heif (pip install pillow-heif); or save it as PNG") from None
    return [name for name in PICTURE_FORMATS if name in Image.OPEN]


def _pixels(image: Image.Image) -> tuple[np.ndarray, np.float32]:
    if image.mode == "F":
        raise ValueError("floating-point pixels have no known range")
    if image.mode in SIXTEEN_BIT_MODES:
        pixels = np.asarray(image)
        if pixels.min() < 0 or pixels.max() > 65535:
            raise ValueError(f"pixels from {pixels.min()} to {pixels.max()} are not 16-bit")
        return pixels, np.float32(65535)
    if image.mode in ("1", "L") and not image.has_transparency_data:
        return np.asarray(image.convert("L")), np.float32(255)  # a third of the memory of three equal channels
    return np.asarray(image.convert("RGBA" if image.has_transparency_data else "RGB")), np.float32(255)
