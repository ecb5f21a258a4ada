"""Write dense grids as OpenVDB files: nonzero voxels become active voxels in leaves, the rest is background.

The file version is 224, as OpenVDB 6.2 to 12 write it; Blender and Houdini read it.
"""

from __future__ import annotations

import itertools
import math
import struct
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tnst_mi.io.atomic import written_whole
from tnst_mi.io.grids.vdb.metadata import Value, written_metadata, written_string, written_transform
from tnst_mi.io.grids.vdb.reader import MAGIC
from tnst_mi.io.grids.vdb.tree import LEAF_EDGE, LEAF_VOXELS
from tnst_mi.io.grids.vdb.values import ACTIVE_MASK, BLOSC, ZIP, written_run

#: Supported compressions by name.
COMPRESSIONS = {"blosc": BLOSC | ACTIVE_MASK, "zip": ZIP | ACTIVE_MASK, "none": ACTIVE_MASK}

_VERSION = struct.pack("<3I?", 224, 10, 0, True)
_COUNT = struct.Struct("<i")
_COUNTS = struct.Struct("<2I")
_COORDINATE = struct.Struct("<3i")
_OFFSETS = struct.Struct("<3q")
_COMPRESSION = struct.Struct("<I")

# Children along an edge of the two kinds of internal nodes, and voxels along that edge.
_UPPER, _UPPER_EDGE = 32, 4096
_LOWER, _LOWER_EDGE = 16, 128

# Every inactive value of a node is the background.
_BACKGROUND = b"\0"


@dataclass(frozen=True)
class DenseGrid:
    """A grid to write.

    Attributes:
        name: name of the grid.
        values: (Z, Y, X) or (Z, Y, X, 3), float32.
        first: coordinates (X, Y, Z) of the first voxel.
        voxel_size: edge of a voxel, in units of the scene.
        translation: position of voxel (0, 0, 0) in the scene.
    """

    name: str
    values: np.ndarray
    first: tuple[int, int, int] = (0, 0, 0)
    voxel_size: float = 1.0
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)


def write_vdb(
    path: Path, grids: Sequence[DenseGrid], metadata: dict[str, tuple[str, Value]], compression: str = "blosc"
) -> None:
    """Write an OpenVDB file.

    Args:
        path: the file.
        grids: its grids, with distinct names.
        metadata: (type, value) by name, such as {"creator": ("string", "tnst_mi")}.
        compression: one of COMPRESSIONS.
    """
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(MAGIC + _VERSION + str(uuid.uuid4()).encode("ascii"))
        file.write(written_metadata(metadata) + _COUNT.pack(len(grids)))
        for grid in grids:
            leaves, bits = _leaves_of(grid), COMPRESSIONS[compression]
            description = _description(grid, leaves, compression) + b"".join(_topology(leaves, bits))
            values = b"".join(_buffers(leaves, bits))
            file.write(written_string(grid.name) + written_string(_tree_type(grid)) + written_string(""))
            start = file.tell() + _OFFSETS.size
            file.write(_OFFSETS.pack(start, start + len(description), start + len(description) + len(values)))
            file.write(description)
            file.write(values)


@dataclass(frozen=True)
class _Leaves:
    """The nonzero leaves of a grid in file order: (N, 3), (N, 512) and (N, 512[, 3])."""

    origins: np.ndarray
    active: np.ndarray
    values: np.ndarray


def _tree_type(grid: DenseGrid) -> str:
    return "Tree_vec3s_5_4_3" if grid.values.ndim == 4 else "Tree_float_5_4_3"


def _leaves_of(grid: DenseGrid) -> _Leaves:
    """Cut a dense grid into leaves, and keep those with a nonzero value."""
    first = np.array(grid.first)
    before = first % LEAF_EDGE
    extents = np.array(grid.values.shape[2::-1])
    after = -(before + extents) % LEAF_EDGE
    margins = [*zip(before[::-1], after[::-1], strict=True), *[(0, 0)] * (grid.values.ndim - 3)]
    padded = np.pad(grid.values.astype("<f4", copy=False), margins)
    counts = [extent // LEAF_EDGE for extent in padded.shape[:3]]
    shape = grid.values.shape[3:]
    blocks = padded.reshape(*itertools.chain.from_iterable((count, LEAF_EDGE) for count in counts), *shape)
    # (bZ, Z, bY, Y, bX, X) to (bX, bY, bZ), X, Y, Z.
    blocks = blocks.transpose(4, 2, 0, 5, 3, 1, *range(6, blocks.ndim)).reshape(-1, LEAF_VOXELS, *shape)
    active = (blocks != 0.0).reshape(len(blocks), LEAF_VOXELS, -1).any(axis=2)
    kept = active.any(axis=1)
    places = np.stack(np.unravel_index(np.flatnonzero(kept), counts[::-1]), axis=1)
    origins = places * LEAF_EDGE + (first - before)
    order = _file_order(origins)
    return _Leaves(origins[order], active[kept][order], blocks[kept][order])


def _file_order(origins: np.ndarray) -> np.ndarray:
    """The permutation that sorts leaves by upper node, then lower node, then position within it, X slowest."""
    keys = [origins // _UPPER_EDGE, origins // _LOWER_EDGE, origins]
    return np.lexsort([key[:, axis] for key in reversed(keys) for axis in (2, 1, 0)])


def _description(grid: DenseGrid, leaves: _Leaves, compression: str) -> bytes:
    metadata: dict[str, tuple[str, Value]] = {
        "class": ("string", "unknown" if grid.values.ndim == 4 else "fog volume"),
        "file_compression": ("string", f"{compression} + active values"),
        "file_voxel_count": ("int64", int(leaves.active.sum())),
        "is_saved_as_half_float": ("bool", False),
        "name": ("string", grid.name),
    }
    transform = written_transform(grid.voxel_size, grid.translation)
    return _COMPRESSION.pack(COMPRESSIONS[compression]) + written_metadata(metadata) + transform


def _topology(leaves: _Leaves, compression: int) -> Iterator[bytes]:
    """The nodes of the tree from the root down, without the values of the leaves."""
    yield _COUNT.pack(1)
    yield b"\0" * (math.prod(leaves.values.shape[2:]) * 4)
    uppers = list(_groups(leaves.origins, _UPPER_EDGE))
    yield _COUNTS.pack(0, len(uppers))
    for upper, inside in uppers:
        yield _COORDINATE.pack(*(int(coordinate) for coordinate in upper))
        lowers = list(_groups(leaves.origins[inside], _LOWER_EDGE))
        yield _branches(np.array([origin for origin, _ in lowers]) - upper, _UPPER, _LOWER_EDGE, compression)
        for lower, below in lowers:
            chosen = slice(inside.start + below.start, inside.start + below.stop)
            yield _branches(leaves.origins[chosen] - lower, _LOWER, LEAF_EDGE, compression)
            yield np.packbits(leaves.active[chosen], axis=1, bitorder="little").tobytes()


def _groups(origins: np.ndarray, edge: int) -> Iterator[tuple[np.ndarray, slice]]:
    """The nodes that sorted leaves belong to, each with the slice of its leaves."""
    nodes = origins // edge
    starts = np.flatnonzero(np.r_[True, (nodes[1:] != nodes[:-1]).any(axis=1)][: len(nodes)])
    for start, stop in itertools.pairwise([*starts.tolist(), len(nodes)]):
        yield nodes[start] * edge, slice(start, stop)


def _branches(offsets: np.ndarray, count: int, edge: int, compression: int) -> bytes:
    """An internal node with children only: its child mask, no active tile, and an empty run of values."""
    mask = np.zeros((count,) * 3, bool)
    mask[tuple((offsets // edge).T)] = True
    masks = np.packbits(mask, bitorder="little").tobytes() + b"\0" * (count**3 // 8)
    return masks + _BACKGROUND + written_run(b"", 1, compression)


def _buffers(leaves: _Leaves, compression: int) -> Iterator[bytes]:
    """The values of the leaves, active voxels only."""
    masks = np.packbits(leaves.active, axis=1, bitorder="little")
    itemsize = leaves.values.itemsize
    for mask, active, values in zip(masks, leaves.active, leaves.values, strict=True):
        yield mask.tobytes() + _BACKGROUND
        yield written_run(values[active].tobytes(), itemsize, compression)
