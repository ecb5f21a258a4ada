"""Smoke from three sides, as its own light shows it: a picture of what is in a grid, whatever the cameras were."""

from __future__ import annotations

import numpy as np

#: Of each side the axis along which is looked, and which axes of the grid (z, y, x) are turned round before: the
#: viewer is at +z, at +x, and at +y.
_SIDES = ((0, (0, 1)), (2, (2, 1, 0)), (1, (1,)))


def three_sides(extinction: np.ndarray) -> np.ndarray:
    """The opacity of smoke from the front, from the right and from above, side by side.

    Args:
        extinction: (D, H, W) per cell, y up.

    Returns:
        (rows, columns) from 0 to 1, the sides at one scale, each in the middle of its column, with a cell for a pixel.
    """
    images = [_opacity(extinction, axis, turned) for axis, turned in _SIDES]
    rows = max(image.shape[0] for image in images)
    return np.concatenate([_centred(image, rows) for image in images], axis=1)


def _opacity(extinction: np.ndarray, axis: int, turned: tuple[int, ...]) -> np.ndarray:
    depth = np.flip(extinction, turned).sum(axis=axis, dtype=np.float64)
    # Along x, what is left is (z, y), of which y goes down the picture.
    return (1 - np.exp(-(depth.T if axis == 2 else depth))).astype(np.float32)


def _centred(image: np.ndarray, rows: int) -> np.ndarray:
    above = (rows - image.shape[0]) // 2
    return np.pad(image, ((above, rows - image.shape[0] - above), (1, 1)))
