"""Masks on the grids of octaves, and the border that keeps all changes within the masks of the full grid.

On an octave a mask is what its cells hold of it, the mean over each, so that a small region is as much of a coarse grid
as of a fine one. Such means reach beyond the mask, and fields that are interpolated to a finer grid reach further. So
fields end at the border of the full grid's masks. They must not be cut off there: the velocity of a potential is its
derivative, and a jump would be the fastest smoke of all. Within two cells of the octave they fade to 0 instead, be the
mask itself soft or hard.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
import torch

from tnst_mi.fields.grid import Octave
from tnst_mi.fields.resampling import resample_potential, resample_region

#: Cells of an octave within which changes fade to nothing at the border of the regions, even of hard masks: the
#: differences of which velocities are made span as many, and would not see a steeper border as wider.
FADE_CELLS = 2.0


class RegionBorder:
    """The border of the regions of a frame, as an octave sees it.

    Args:
        masks: of the targets, each (D, H, W) on the full grid; their union has the border.
        octave: of the same run.

    Attributes:
        full: the fade (D, H, W) on the full grid: 0 outside all masks, 1 from two cells of the octave within.
    """

    def __init__(self, masks: Sequence[np.ndarray], octave: Octave) -> None:
        self._octave = octave
        union = functools.reduce(np.maximum, masks)
        width = FADE_CELLS * octave.cell_size
        self.full = mi.TensorXf(distance_within(mi.TensorXf(union).torch() > 0, width) / width)

    def fade(self) -> mi.TensorXf:
        """The fade on the grid of the octave, in [0, 1]: the share that is left of any change."""
        return resample_region(self.full, 1.0, self._octave.shape, self._octave.cell_size)

    def restored(self) -> mi.TensorXf:
        """A factor (D, H, W) for fields of the octave that are interpolated to the full grid, in [0, 1].

        It is 0 outside all masks. Within, it turns the fade as the octave has it, blurred, into that of the full grid
        where this is less: fields then end where the masks do, no more steeply than the fade.
        """
        blurred = resample_potential(self.fade(), self._octave.cell_size, self.full.shape, 1.0).array
        wanted = self.full.array
        # Nothing is divided by `blurred` outside, where it may be so small that a GPU takes it for 0 in quotients, yet
        # not in comparisons: 0/0.
        factor = dr.select(wanted > 0, wanted / dr.maximum(blurred, wanted), 0)
        return mi.TensorXf(factor, tuple(self.full.shape))


def border_of(masks: Sequence[np.ndarray | None], octave: Octave) -> RegionBorder | None:
    """The border of the regions of a frame; None if there are none, or one (None) is everywhere."""
    present = [mask for mask in masks if mask is not None]
    return RegionBorder(present, octave) if present and len(present) == len(masks) else None


def octave_mask(mask: np.ndarray, border: RegionBorder | None, octave: Octave) -> mi.TensorXf:
    """The mask (D, H, W) of a target on the grid of an octave: the mean over each cell, faded within the border."""
    full = mi.TensorXf(mask)
    if border is not None:
        full = mi.TensorXf(dr.minimum(full.array, border.full.array), mask.shape)
    return resample_region(full, 1.0, octave.shape, octave.cell_size)


def union_of(masks: Sequence[mi.TensorXf | None]) -> mi.TensorXf | None:
    """The largest of some masks in every cell; None if one of them is everywhere, or there are none."""
    present = [mask for mask in masks if mask is not None]
    if not present or len(present) < len(masks):
        return None
    return functools.reduce(lambda a, b: mi.TensorXf(dr.maximum(a.array, b.array), tuple(a.shape)), present)


def distance_within(inside: torch.Tensor, most: float) -> torch.Tensor:
    """The distance of each cell (D, H, W) to the nearest one outside, in cells, at most `most`; 0 outside.

    The border of the grid is no border of the inside. Exact: the least of squared distances along one axis plus
    squared offsets along the next.
    """
    square = torch.where(inside, most**2, 0.0)
    for axis in range(3):
        nearest = square.clone()
        for offset in range(1, min(math.ceil(most), square.shape[axis])):
            count = square.shape[axis] - offset
            for here, there in ((0, offset), (offset, 0)):
                target = nearest.narrow(axis, here, count)
                torch.minimum(target, square.narrow(axis, there, count) + offset**2, out=target)
        square = nearest
    return square.sqrt()
