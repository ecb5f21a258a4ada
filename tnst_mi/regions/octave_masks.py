"""Masks on the grids of octaves, such that nothing changes outside the mask of the full grid.

Fields of a coarse octave are interpolated to finer grids, and what a coarse cell holds reaches beyond it. So a coarse
cell has the least value that the mask has where it reaches; and where fields arrive from elsewhere, a coarser octave or
a neighbouring frame, they are cut off softly at the support of the mask.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from torch.nn import functional

from tnst_mi.fields.grid import Octave
from tnst_mi.fields.resampling import cubic_matrix


def octave_mask(mask: np.ndarray, octave: Octave) -> np.ndarray:
    """The mask (D, H, W) on the grid of an octave: in each cell, the least of the cells that its fields reach.

    Args:
        mask: (D, H, W) on the full grid.
        octave: of the same run.
    """
    if octave.cell_size == 1.0 and octave.shape == mask.shape:
        return mask
    for axis, (n, size) in enumerate(zip(octave.shape, mask.shape, strict=True)):
        reached = cubic_matrix(n, octave.cell_size, size, 1.0) != 0
        values = np.moveaxis(mask, axis, 0)
        least = [values[reached[:, cell]].min(axis=0, initial=1.0) for cell in range(n)]
        mask = np.moveaxis(np.stack(least), 0, axis)
    return np.ascontiguousarray(mask, np.float32)


def well_inside(mask: mi.TensorXf) -> mi.TensorXf:
    """A factor (D, H, W) that is 0 where the mask is 0, and 1 from the third cell inside its support on."""
    inside = (mask.torch() > 0).to(mask.torch().dtype)[None, None]
    # The border of the grid is no border of the mask: pooling leaves out what lies beyond it.
    eroded = -functional.max_pool3d(-inside, 3, 1, 1)
    soft = functional.avg_pool3d(eroded, 3, 1, 1, count_include_pad=False)
    return mi.TensorXf(soft[0, 0].contiguous())
