"""Smoke from three sides, as its own light shows it: a picture of what is in a grid, whatever the cameras were."""

from __future__ import annotations

import numpy as np

#: Of each side the axis along which is looked, and which axes of the grid (z, y, x) are turned round before: the
#: viewer is at +z, at +x, and at +y.
_SIDES = ((0, (0, 1)), (2, (2, 1, 0)), (1, (1,)))


def three_sides(extinction: np.ndarray, colours: np.ndarray | None = None) -> np.ndarray:
    """What smoke of brightness 1 shows to the front, to the right and upwards, side by side: white, its opacity.

    Args:
        extinction: (D, H, W) per cell, y up.
        colours: (D, H, W, 3); None for white smoke.

    Returns:
        (rows, columns), or (rows, columns, 3) in colour: the sides at one scale, each in the middle of its column, with
        a cell for a pixel.
    """
    images = [_seen(extinction, colours, axis, turned) for axis, turned in _SIDES]
    rows = max(image.shape[0] for image in images)
    return np.concatenate([_centred(image, rows) for image in images], axis=1)


def _seen(extinction: np.ndarray, colours: np.ndarray | None, axis: int, turned: tuple[int, ...]) -> np.ndarray:
    along = np.flip(extinction, turned)
    if colours is None:
        image = 1 - np.exp(-along.sum(axis=axis))
    else:
        # After turning, what is nearest to the viewer comes first.
        light = np.moveaxis(along, axis, 0)
        tint = np.moveaxis(np.flip(colours, turned), axis, 0)
        transmittance = np.exp(-np.cumsum(light, axis=0))
        before = np.concatenate([np.ones_like(transmittance[:1]), transmittance[:-1]])
        image = np.einsum("kij,kijc->ijc", before - transmittance, tint)
    # Along x, what is left is (z, y), of which y goes down the picture.
    return (image.swapaxes(0, 1) if axis == 2 else image).astype(np.float32)


def _centred(image: np.ndarray, rows: int) -> np.ndarray:
    above = (rows - image.shape[0]) // 2
    margin = [(above, rows - image.shape[0] - above), (1, 1), (0, 0)]
    return np.pad(image, margin[: image.ndim])
