"""How large a part of a tree may be made dense: a file of a few kilobytes can tell of a box of any size.

Memory has to be in proportion to the bytes of the file. Its voxels would be no measure, since thousands of tiles, each
of thousands of them, take a few bytes.
"""

from __future__ import annotations

from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.geometry.boxes import Box, size, words
from tnst_mi.io.grids.vdb.file_format.tree import LEAF_EDGE, LEAF_VOXELS
from tnst_mi.machine.environment import free_memory
from tnst_mi.machine.terminal import amount

#: Largest dense grid that is made from a tree, in cells.
LARGEST_BOX = 1 << 28

# Measured bytes per cell and component that it takes to expand a tree and make a frame's grid from it.
_CELL_BYTES = 14

# A dense grid may take so many bytes for each byte of its file. A plume 8 voxels in radius along the diagonal of 512³
# voxels takes 2200 (in half precision, compressed), with its velocity 3100, one 4 voxels in radius 4000.
_LARGEST_RATIO = 10_000

# Smaller grids, in cells and bytes, do no harm, whatever the file.
_HARMLESS_CELLS, _HARMLESS_BYTES = 1 << 24, 300_000_000


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
    need, free = _need(box, components), free_memory()
    if free is not None and need > free:
        raise InputError(f"{spans}, which take {amount(need)}, and {amount(free)} are free; {remedy}")


def is_out_of_proportion(box: Box, components: int, stored: int) -> bool:
    """Whether memory for a box of a file's grids would be out of proportion to the file.

    Args:
        box: the box, in voxels.
        components: number of components of all grids together.
        stored: bytes of the file.
    """
    need = _need(box, components)
    harmless = size(box) <= _HARMLESS_CELLS and need <= _HARMLESS_BYTES
    return not harmless and need > _LARGEST_RATIO * stored


def _need(box: Box, components: int) -> int:
    """Bytes that a box takes; whole leaves are expanded."""
    return size((box[0] // LEAF_EDGE, box[1] // LEAF_EDGE)) * LEAF_VOXELS * components * _CELL_BYTES
