"""OpenEXR pictures: one float32 luminance channel, or red, green and blue, with the render settings in the header."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenEXR

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import write_failure, written_whole
from tnst_mi.machine.gate import opening

#: Channels of a picture that is wholly used: red, green, blue and alpha.
_COLOURS = 4


def write_exr(path: Path, image: np.ndarray, attributes: Mapping[str, float | str | tuple[float, ...]]) -> None:
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


def header_numbers(path: Path) -> dict[str, float]:
    """The numbers in the header of a picture, by name, such as the exposure of one of ours.

    Raises:
        Exception: whatever the library does of files that it cannot read.
    """
    with OpenEXR.File(str(path), header_only=True) as file:
        return {name: float(value) for name, value in file.header().items() if isinstance(value, int | float)}


def read_linear(path: Path, most: int) -> np.ndarray:
    """Read the colours of a picture of any program: (H, W, 3) float32, or (H, W, 4) with alpha, not premultiplied.

    Args:
        path: the file.
        most: the largest number of pixels to read.

    Raises:
        InputError: it is damaged or too large, or has neither red, green and blue nor luminance.
    """
    values = read_premultiplied(path, most)
    return values if values.shape[-1] == 3 else _not_premultiplied(values[..., :3], values[..., 3])


def read_premultiplied(path: Path, most: int) -> np.ndarray:
    """The same as the file holds it: what reaches the camera, (H, W, 3), or with alpha (H, W, 4), by which nothing is
    divided. See `read_linear`."""
    try:
        _require_bounded(path, most)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except (InputError, MemoryError):
        raise
    except Exception as error:  # the library raises RuntimeError and others on damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: unreadable picture ({reason}); save it again as PNG or OpenEXR") from None
    # Multi-layer files have channels such as `ViewLayer.Combined.R`; the first layer counts.
    layers = dict.fromkeys(name.rpartition(".")[0] for name in channels)
    for layer in layers:
        colours = {letter: channels.get(f"{layer}.{letter}" if layer else letter) for letter in "RGBYA"}
        found = [colours[letter] for letter in "RGB"]
        if all(colour is None for colour in found):
            found = [colours["Y"]] * 3
        if any(colour is None for colour in found):
            continue
        values = np.stack([np.asarray(colour, np.float32) for colour in found], axis=-1)
        if colours["A"] is None:
            return values
        return np.concatenate([values, np.asarray(colours["A"], np.float32)[..., None]], axis=-1)
    raise InputError(f"{path}: has the channels {', '.join(channels)}, expected R, G and B, or Y")


def _require_bounded(path: Path, most: int) -> None:
    """Check by the headers how much there is to read: the library reads all channels of all parts, used or not."""
    total = 0
    with OpenEXR.File(str(path), header_only=True) as file:
        for part in file.parts:
            low, high = part.header["dataWindow"]
            columns, rows = (int(end) - int(start) + 1 for start, end in zip(low, high, strict=True))
            if columns * rows > most:
                raise InputError(f"{path}: the picture has more than {most} pixels; make it smaller")
            total += columns * rows * len(part.header["channels"])
    if total > _COLOURS * most:
        raise InputError(
            f"{path}: its layers have {total} values, expected at most {_COLOURS * most}; save it without layers that "
            "are not needed, or make it smaller"
        )


def _not_premultiplied(values: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    colours = np.divide(values, alpha[..., None], out=np.zeros_like(values), where=alpha[..., None] > 0)
    return np.concatenate([colours, alpha[..., None]], axis=-1)


def read_exr(path: Path) -> np.ndarray:
    """Read a picture that `write_exr` wrote: (H, W) or (H, W, 3) float32.

    Raises:
        InputError: it is missing or damaged.
    """
    with opening(path, "an OpenEXR picture of a run"), OpenEXR.File(str(path)) as file:
        channels = file.channels()
        return np.array(channels["Y" if "Y" in channels else "RGB"].pixels)
