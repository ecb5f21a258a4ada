"""Boxes of whole coordinates: their union, growth and size, and where affine maps take them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np

from tnst_mi.geometry.affine import Affine

#: Lowest and highest voxel (X, Y, Z) of a box, both inclusive.
Box = tuple[np.ndarray, np.ndarray]

# Coordinates beyond are taken as these: farther apart than any file's voxels, and without overflow in int64.
_FARTHEST = 2.0**60

# Rounding must not add a layer of cells.
_ROUNDING = 1e-6


def union(boxes: Iterable[Box | None]) -> Box | None:
    """The smallest box that holds all of those given; None if there are none."""
    known = [box for box in boxes if box is not None]
    if not known:
        return None
    return np.min([low for low, _ in known], axis=0), np.max([high for _, high in known], axis=0)


def extents(box: Box) -> np.ndarray:
    """Voxels along each axis, (3)."""
    return box[1] - box[0] + 1


def size(box: Box) -> int:
    """Number of voxels."""
    return math.prod(int(extent) for extent in extents(box))


def grown(box: Box, by: int) -> Box:
    """A box with `by` more voxels on every side."""
    return box[0] - by, box[1] + by


def intersection(box: Box, other: Box) -> Box | None:
    """What two boxes share; None if that is nothing."""
    low, high = np.maximum(box[0], other[0]), np.minimum(box[1], other[1])
    return None if (high < low).any() else (low, high)


def image(box: Box, map: Affine, reach: float = 0.0) -> Box:
    """The smallest box that holds the image of a box, whose voxels count as points with `reach` around them.

    With a reach of 1 these are the voxels between whose trilinear neighbours the image lies.
    """
    corners = map(np.array([*itertools.product(*zip(box[0] - reach, box[1] + reach, strict=True))]))
    low, high = (np.clip(corner, -_FARTHEST, _FARTHEST) for corner in (corners.min(axis=0), corners.max(axis=0)))
    if map.whole and reach == 0.0:
        return np.rint(low).astype(np.int64), np.rint(high).astype(np.int64)
    return np.floor(low + _ROUNDING).astype(np.int64), np.ceil(high - _ROUNDING).astype(np.int64)


def words(box: Box) -> str:
    """The extents of a box, such as "13 × 18 × 10"."""
    return " × ".join(str(int(extent)) for extent in extents(box))
