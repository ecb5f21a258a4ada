"""Bounding boxes of the smoke, in cells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: Slices of z, y and x.
Region = tuple[slice, slice, slice]


def smoke_box(density: np.ndarray, margin: int) -> Region | None:
    """The bounding box of all smoke of a density (D, H, W), extended by `margin` cells within the grid.

    None if there is no smoke.
    """
    if not density.any():
        return None
    z, y, x = (_along(density, axis, margin) for axis in range(3))
    return z, y, x


def _along(density: np.ndarray, axis: int, margin: int) -> slice:
    occupied = np.flatnonzero(density.any(axis=tuple({0, 1, 2} - {axis})))
    return slice(max(int(occupied[0]) - margin, 0), min(int(occupied[-1]) + 1 + margin, density.shape[axis]))


def hull(boxes: Sequence[Region]) -> Region:
    """The smallest box that contains all the given boxes, of which there is at least one."""
    z, y, x = (slice(min(s.start for s in parts), max(s.stop for s in parts)) for parts in zip(*boxes, strict=True))
    return z, y, x
