"""Values of one grid at the cells of another: an exact permutation where cells coincide, else trilinear interpolation.

Grids are arrays (Z, Y, X) or (Z, Y, X, C) of the values in a box of voxels.
"""

from __future__ import annotations

import itertools

import numpy as np

from tnst_mi.geometry.affine import Affine
from tnst_mi.geometry.boxes import Box, extents, image

#: Cells that are interpolated at once.
_BATCH = 1 << 20


def needed_box(cells: Box, voxels_of: Affine) -> Box:
    """The voxels from which `resampled` takes the values of a box of cells."""
    box = image(cells, voxels_of)
    return box if voxels_of.whole else (box[0] - 1, box[1] + 1)


def resampled(values: np.ndarray, box: Box, cells: Box, voxels_of: Affine) -> np.ndarray:
    """The values at a box of cells.

    Args:
        values: (Z, Y, X) or (Z, Y, X, C), the values of the voxels of `box`.
        box: where they are; beyond it, the values at its border go on.
        cells: the cells whose values are wanted.
        voxels_of: from cells to voxels.

    Returns:
        An array of the cells' extents (Z, Y, X), of the values' type if it permutes them, else float32.
    """
    if voxels_of.whole and _holds(box, image(cells, voxels_of)):
        return _permuted(values, box, cells, voxels_of)
    shape = tuple(int(extent) for extent in extents(cells)[::-1])
    result = np.empty((*shape, *values.shape[3:]), np.float32)
    rows = np.stack(np.meshgrid(*(np.arange(n) for n in shape[1:]), indexing="ij"), axis=-1)[..., ::-1]
    at_once = max(1, _BATCH // max(1, shape[1] * shape[2]))
    for start in range(0, shape[0], at_once):
        layers = np.arange(start, min(start + at_once, shape[0]))
        points = np.empty((len(layers), *shape[1:], 3))
        points[..., :2] = rows
        points[..., 2] = layers[:, None, None]
        result[layers] = _interpolated(values, voxels_of(points + cells[0]) - box[0])
    return result


def _holds(box: Box, inner: Box) -> bool:
    return bool((box[0] <= inner[0]).all() and (inner[1] <= box[1]).all())


def _permuted(values: np.ndarray, box: Box, cells: Box, voxels_of: Affine) -> np.ndarray:
    low, high = (corner - box[0] for corner in image(cells, voxels_of))
    (x0, y0, z0), (x1, y1, z1) = low.tolist(), high.tolist()
    part = values[z0 : z1 + 1, y0 : y1 + 1, x0 : x1 + 1]
    axes = np.rint(voxels_of.matrix).astype(int)
    # Axis a of the voxels runs along axis sources[a] of the cells, or against it. Arrays have the axes reversed.
    sources = np.abs(axes).argmax(axis=1)
    against = tuple(2 - a for a in range(3) if axes[a, sources[a]] < 0)
    order = [2 - int(np.flatnonzero(sources == 2 - axis)[0]) for axis in range(3)]
    turned = np.flip(part, against) if against else part
    return np.ascontiguousarray(turned.transpose(*order, *range(3, values.ndim)))


def _interpolated(values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Trilinear interpolation at points (…, 3), in voxels from the first one."""
    highest = np.array(values.shape[2::-1]) - 1
    points = np.clip(points, 0, highest)
    base = np.minimum(np.floor(points).astype(np.int64), np.maximum(highest - 1, 0))
    part = (points - base).astype(np.float32)
    total: np.ndarray | float = 0.0
    for corner in itertools.product((0, 1), repeat=3):
        weight = np.prod(np.where(corner, part, 1 - part), axis=-1, dtype=np.float32)
        x, y, z = np.moveaxis(np.minimum(base + corner, highest), -1, 0)
        taken = values[z, y, x].astype(np.float32, copy=False)
        total = total + weight.reshape(*weight.shape, *(1,) * (values.ndim - 3)) * taken
    return np.asarray(total, np.float32)
