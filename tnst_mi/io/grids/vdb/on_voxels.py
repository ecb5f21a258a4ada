"""A frame's grids back on the voxels of their file, where these do not coincide with the cells."""

from __future__ import annotations

import numpy as np

from tnst_mi.geometry.affine import Affine
from tnst_mi.geometry.boxes import Box, grown
from tnst_mi.geometry.placement import OwnVoxels
from tnst_mi.geometry.resampling import resampled


def interpolated(array: np.ndarray, cells_of: Affine, cells: Box, box: Box) -> np.ndarray:
    """A frame's grid at voxels that do not coincide with its cells; 0 beyond it."""
    padded = np.pad(array, [*[(1, 1)] * 3, *[(0, 0)] * (array.ndim - 3)])
    return resampled(padded, grown(cells, 1), box, cells_of)


def interpolated_change(array: np.ndarray, own: OwnVoxels, cells: Box, box: Box, floor: bool = True) -> np.ndarray:
    """The file's own values with what has changed at the cells; where nothing has, they stay as they were.

    Args:
        array: (Z, Y, X), the values at the cells now.
        own: the voxels, with the file's values.
        cells: the cells, counted from the first.
        box: the voxels whose values are wanted, which hold those of `own`.
        floor: whether values stay at 0 or more.
    """
    if own.values is None or own.box is None:
        raise ValueError("the file's own values are needed")
    change = array - resampled(own.values, own.box, cells, own.voxels_of)
    margins = [*zip((own.box[0] - box[0])[::-1], (box[1] - own.box[1])[::-1], strict=True)]
    before = np.pad(own.values.astype(np.float32), margins, constant_values=own.outside)
    changed = interpolated(change, own.voxels_of.inverse(), cells, box)
    after = before + changed
    return np.where(changed == 0, before, np.maximum(after, 0) if floor else after)
