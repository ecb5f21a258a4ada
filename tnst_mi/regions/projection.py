"""Masks from pictures: what is painted over a view of the smoke, projected along the direction of that view."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.losses.pictures import GreyImage, read_image
from tnst_mi.rendering.cameras.views import View, camera_frame

#: Difference of the proportions of picture and view beyond which they are not of the same frame.
_OTHER_PROPORTIONS = 0.03


#: How far from 0 and 1 grey is neither black nor white, and the share of it in what is not black up to which a picture
#: is in black and white, with soft edges.
_GREY, _SOFT_EDGES = 0.05, 0.25


@dataclass(frozen=True, eq=False)
class Painting:
    """A painted picture as a mask.

    Attributes:
        values: (rows, columns) float32 in [0, 1], row 0 at the top.
        remark: what is to be said of it; may be empty.
    """

    values: np.ndarray
    remark: str = ""


def painted(path: str | Path, size: tuple[int, int]) -> Painting:
    """Read a painted picture as a mask: where it has transparency, what is opaque; otherwise its grey, from 0 to 1.

    So a layer that is painted in any colour over a view counts, and so does a picture in black and white.

    Args:
        path: of the picture.
        size: rows and columns of the view that it was painted over.

    Raises:
        InputError: it cannot be read, is wholly transparent, or has other proportions than the view.
    """
    picture = read_image(path)
    rows, columns = picture.grey.shape
    if abs(columns * size[0] / (rows * size[1]) - 1) > _OTHER_PROPORTIONS:
        raise InputError(
            f"{path}: has {columns}×{rows} pixels, expected the proportions of the view, {size[1]}×{size[0]}; paint "
            "over a picture that tnst-mi rendered, such as images/NAME_before.png, and keep all of its frame"
        )
    if picture.alpha is not None and float(picture.alpha.min()) < 1.0:
        return Painting(picture.alpha)
    return Painting(picture.grey, _of_greys(picture))


def _of_greys(picture: GreyImage) -> str:
    """What is to be said of a picture without transparency that is not in black and white.

    A view that is painted over in white is white where its smoke is, too; and colours count as their grey.
    """
    bright = picture.grey[picture.grey > _GREY]
    if not bright.size or (bright < 1 - _GREY).mean() <= _SOFT_EDGES:
        return ""
    return (
        f"{picture.name} has no transparency, so that what is white counts, and greys and colours in part: "
        f"{picture.grey.mean():.0%} of the picture; if only what is painted is to count, export it as a transparent "
        "layer of its own"
    )


def projected(picture: np.ndarray, view: View, shape: Shape, size: tuple[int, int]) -> np.ndarray:
    """The mask (D, H, W) of a picture: each cell has the value of the point at which it is seen, linear between pixels.

    Args:
        picture: (rows, columns), row 0 at the top, of the whole frame of the view at any resolution.
        view: (azimuth, elevation) in degrees.
        shape: (D, H, W).
        size: rows and columns of the view, whose pixels are as large as cells and whose centre is that of the grid.

    Returns:
        float32; 0 for cells that the view cuts off.
    """
    z, y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    right, up, _ = camera_frame(*view)
    across, along = (axis[2] * z[:, None, None] + axis[1] * y[:, None] + axis[0] * x for axis in (right, -up))
    # From the upper left corner of the frame, in pixels of the picture, whose centres lie at halves.
    row = (along / size[0] + 0.5) * picture.shape[0] - 0.5
    column = (across / size[1] + 0.5) * picture.shape[1] - 0.5
    inside = (np.abs(along) <= size[0] / 2) & (np.abs(across) <= size[1] / 2)
    return np.where(inside, _interpolated(picture, row, column), 0).astype(np.float32)


def _interpolated(picture: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """The picture between its pixels, linearly; its edge repeats beyond."""
    row, column = (np.clip(x, 0, n - 1) for x, n in ((row, picture.shape[0]), (column, picture.shape[1])))
    top, left = np.floor(row).astype(int), np.floor(column).astype(int)
    bottom, right = np.minimum(top + 1, picture.shape[0] - 1), np.minimum(left + 1, picture.shape[1] - 1)
    down, across = row - top, column - left
    upper = picture[top, left] * (1 - across) + picture[top, right] * across
    lower = picture[bottom, left] * (1 - across) + picture[bottom, right] * across
    return upper * (1 - down) + lower * down
