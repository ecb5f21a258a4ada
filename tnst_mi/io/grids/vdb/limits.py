"""How large a part of a tree may be made dense: the size of a file does not bound its box."""

from __future__ import annotations

from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.geometry.boxes import Box, size, words
from tnst_mi.io.grids.vdb.file_format.tree import LEAF_EDGE, LEAF_VOXELS
from tnst_mi.machine.environment import free_memory

#: Largest dense grid that is made from a tree, in cells.
LARGEST_BOX = 1 << 28

# Measured bytes per cell and component that it takes to expand a tree and make a frame's grid from it.
_CELL_BYTES = 14

# Below this share of stored voxels, boxes of more than so many cells count as a mistake.
_EMPTIEST, _HARMLESS = 1e-3, 1 << 23


def require_small(path: Path, box: Box, components: int = 1, remedy: str = "crop the grid") -> None:
    """Check that a box of a file's grids can be made dense.

    Args:
        path: the file.
        box: the box, in voxels.
        components: number of components of all grids together.
        remedy: what to do about it.

    Raises:
        InputError: it has too many cells, for our limit or for the free memory.
    """
    spans = f"{path}: its voxels span {words(box)} cells"
    if size(box) > LARGEST_BOX:
        raise InputError(f"{spans}, expected at most {LARGEST_BOX} in all; {remedy}")
    # Whole leaves are expanded.
    blocks = size((box[0] // LEAF_EDGE, box[1] // LEAF_EDGE))
    need, free = blocks * LEAF_VOXELS * components * _CELL_BYTES, free_memory()
    if free is not None and need > free:
        raise InputError(f"{spans}, which take {need / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free; {remedy}")


def is_almost_empty(box: Box, stored_voxels: int) -> bool:
    """Whether memory for a box would be out of proportion to the voxels that the file has values for."""
    return size(box) > max(_HARMLESS, stored_voxels / _EMPTIEST)
