"""Pictures beside each other, with their names; and two pictures as a wipe and as their difference."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tnst_mi.io.pictures.png import eight_bits
from tnst_mi.losses.pictures import resized

#: Rows of pictures, at least, as far as a row of them fits into this many columns.
_LEAST_HEIGHT, _WIDEST = 400, 2400

#: Of the height of pictures, that of their names and the gap between them.
_CAPTION, _GAP = 1 / 16, 1 / 100

#: Width of the line of a wipe.
_LINE = 2

#: The second of two pictures is brighter: orange; the first is: blue.
_BRIGHTER, _DARKER = np.array([1.0, 0.55, 0.1]), np.array([0.15, 0.5, 1.0])


def row(panels: Sequence[tuple[str, np.ndarray]], least: int = _LEAST_HEIGHT) -> np.ndarray:
    """Pictures of one height side by side on black, each below its name; small ones are enlarged.

    Args:
        panels: names with pictures (H, W) or (H, W, 3) in [0, 1], one or more.
        least: rows of the pictures, to which smaller ones are enlarged by an integer factor.

    Returns:
        (rows, columns, 3) in [0, 1].
    """
    factor = _factor(panels[0][1].shape[0], sum(picture.shape[1] for _, picture in panels), least)
    pictures = [_enlarged(picture, factor) for _, picture in panels]
    height = pictures[0].shape[0]
    caption, gap = max(14, round(_CAPTION * height)), max(2, round(_GAP * height))
    width = sum(picture.shape[1] for picture in pictures) + gap * (len(pictures) - 1)
    sheet = Image.new("RGB", (width, height + caption))
    pen, font, left = ImageDraw.Draw(sheet), ImageFont.load_default(0.7 * caption), 0
    for (name, _), picture in zip(panels, pictures, strict=True):
        sheet.paste(Image.fromarray(eight_bits(picture)), (left, caption))
        pen.text((left + gap, caption / 2), _fitting(name, font, picture.shape[1] - gap), "white", font, anchor="lm")
        left += picture.shape[1] + gap
    return np.asarray(sheet, np.float32) / 255


def wipe(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The left half of one picture (H, W) or (H, W, 3), the right half of another, and a white line, enlarged."""
    a, b = (_enlarged(picture, _factor(picture.shape[0], picture.shape[1], _LEAST_HEIGHT)) for picture in (a, b))
    middle = a.shape[1] // 2
    return np.concatenate([a[:, :middle], np.ones((a.shape[0], _LINE, 3)), b[:, middle:]], axis=1)


def difference(a: np.ndarray, b: np.ndarray, scale: float) -> np.ndarray:
    """Where the second picture (H, W) is brighter, in orange, and where the first is, in blue: (H, W, 3) in [0, 1].

    Of pictures (H, W, 3), the size of the difference of each channel.
    """
    if a.ndim == 3 or b.ndim == 3:
        first, second = both_coloured(a, b)
        return np.clip(np.abs(scale * (second - first)), 0.0, 1.0)
    signed = np.clip(scale * (b - a), -1.0, 1.0)[..., None]
    return np.where(signed > 0, signed * _BRIGHTER, -signed * _DARKER)


def both_coloured(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two pictures, each (H, W) or (H, W, 3): both in colour if one of them is."""
    if a.ndim == b.ndim:
        return a, b
    return (a, np.repeat(b[..., None], 3, axis=2)) if a.ndim == 3 else (np.repeat(a[..., None], 3, axis=2), b)


def on_canvas(picture: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """A picture (H, W) or (H, W, 3) in the middle of a black one that is at least as large."""
    above, left = (rows - picture.shape[0]) // 2, (columns - picture.shape[1]) // 2
    below, right = rows - picture.shape[0] - above, columns - picture.shape[1] - left
    return np.pad(picture, ((above, below), (left, right), *[(0, 0)] * (picture.ndim - 2)))


def _factor(rows: int, columns: int, least: int) -> int:
    """By which pictures are enlarged that have so many rows, and columns in a row of them."""
    return max(1, min(-(-least // rows), _WIDEST // columns))


def _enlarged(picture: np.ndarray, factor: int) -> np.ndarray:
    """A picture in colours, enlarged."""
    colours = picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
    if factor == 1:
        return colours
    rows, columns = factor * picture.shape[0], factor * picture.shape[1]
    return np.stack([resized(colours[..., channel], rows, columns) for channel in range(3)], axis=2)


def _fitting(name: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int) -> str:
    """A name that is at most so wide; its end is kept, where numbers are."""
    shown = name
    while len(shown) > 1 and font.getlength(shown) > width:
        shown = "…" + shown.removeprefix("…")[1:]
    return shown
