"""The memory that grids and pictures take: what does not fit is refused before hours go into it."""

from __future__ import annotations

import torch

from tnst_mi.errors import InputError
from tnst_mi.machine import environment
from tnst_mi.machine.backend import torch_device

#: Bytes of a cell, as measured: extinction, derivative, moments, prior, and what renderers keep.
_OF_CELL = 118

#: Bytes of a pixel for each number that it has: as it was read, and in parts of the peak.
_OF_NUMBER = 8

#: Bytes of a pixel besides: its weight.
_OF_PIXEL = 4


def require_memory_for_cells(count: int) -> None:
    """Check that a grid of so many cells fits into the free memory of the device.

    Raises:
        InputError: it does not.
    """
    device = torch_device()
    free = torch.cuda.mem_get_info(device)[0] if device.type == "cuda" else environment.free_memory()
    if count * _OF_CELL > free:
        raise InputError(
            f"memory: {count} cells need about {count * _OF_CELL / 1e9:.1f} GB and {free / 1e9:.1f} GB are free, which "
            f"is enough for {free // _OF_CELL}; take fewer --cells or a smaller --box"
        )


def require_memory_for_pictures(count: int, size: tuple[int, int], numbers: int) -> None:
    """Check that so many pictures of a size (rows, columns) fit into the free memory.

    Args:
        count: of pictures.
        size: of one.
        numbers: of each pixel, in the picture and in that of its background.

    Raises:
        InputError: they do not.
    """
    rows, columns = size
    needed, free = count * rows * columns * (numbers * _OF_NUMBER + _OF_PIXEL), environment.free_memory()
    if needed > free:
        raise InputError(
            f"memory: {count} pictures of {columns} × {rows} pixels need about {needed / 1e9:.1f} GB and "
            f"{free / 1e9:.1f} GB are free; make them smaller (no pixel need be finer than a cell) or use fewer views"
        )
