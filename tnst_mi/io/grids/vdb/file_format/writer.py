"""Write dense grids as OpenVDB files: sparse, with the voxels that are not background active.

Leaves of one value become tiles, and nodes of such tiles a larger tile, as OpenVDB's `pruneTiles` does. The file
version is 224, as OpenVDB 6.2 to 12 write it; Blender and Houdini read it.
"""

from __future__ import annotations

import math
import struct
import uuid
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.geometry.affine import Affine
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.grids.vdb.file_format.metadata import written_metadata, written_string, written_transform
from tnst_mi.io.grids.vdb.file_format.reader import HALF, MAGIC, SEPARATOR, Grid
from tnst_mi.io.grids.vdb.file_format.tree import LEAF_EDGE, LEAF_VOXELS
from tnst_mi.io.grids.vdb.file_format.values import ACTIVE_MASK, BLOSC, ZIP, written_run

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

# The names of types of values, by the type of a number and whether there are three of it.
_TYPES = {
    ("float32", 0): "float",
    ("float64", 0): "double",
    ("int32", 0): "int32",
    ("float32", 1): "vec3s",
    ("float64", 1): "vec3d",
}

# Largest value of half precision.
_LARGEST_HALF = 65504.0


@dataclass(frozen=True)
class DenseGrid:
    """A grid to write.

    Attributes:
        name: name of the grid; several may share one.
        values: (Z, Y, X) or (Z, Y, X, 3) of float32 or float64, or (Z, Y, X) of int32.
        first: coordinates (X, Y, Z) of the first voxel.
        voxel_size: edge of a voxel, in units of the scene.
        translation: position of voxel (0, 0, 0) in the scene.
        transform: from voxels to the scene, in place of the two before.
        metadata: (type, value) by name, besides those that follow from the values.
        half: whether values are stored in half precision, where the largest fits it.
        background: the value of all other voxels: of each component, or (3,).
        grid_class: its class; "" for that which follows from the values.
    """

    name: str
    values: np.ndarray
    first: tuple[int, int, int] = (0, 0, 0)
    voxel_size: float = 1.0
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    transform: Affine | None = None
    metadata: Mapping[str, tuple[str, Any]] = field(default_factory=dict)
    half: bool = False
    background: float | np.ndarray = 0.0
    grid_class: str = ""


def write_vdb(
    path: Path,
    grids: Iterable[DenseGrid | Grid],
    metadata: Mapping[str, tuple[str, Any]],
    compression: str = "blosc",
) -> None:
    """Write an OpenVDB file.

    Args:
        path: the file.
        grids: its grids, each written before the next one is asked for; those of another file are copied as they are.
        metadata: (type, value) by name, such as {"creator": ("string", "tnst_mi")}.
        compression: one of COMPRESSIONS.
    """
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(MAGIC + _VERSION + str(uuid.uuid4()).encode("ascii"))
        file.write(written_metadata(metadata))
        place, names = file.tell(), list[str]()
        file.write(_COUNT.pack(0))
        for grid in grids:
            tree_type, description, values = _copied(grid) if isinstance(grid, Grid) else _encoded(grid, compression)
            # Grids of one name are told apart by a number.
            number = f"{SEPARATOR}{names.count(grid.name)}" if grid.name in names else ""
            names.append(grid.name)
            file.write(written_string(grid.name + number) + written_string(tree_type) + written_string(""))
            start = file.tell() + _OFFSETS.size
            file.write(_OFFSETS.pack(start, start + len(description), start + len(description) + len(values)))
            file.write(description)
            file.write(values)
        file.seek(place)
        file.write(_COUNT.pack(len(names)))


def _encoded(grid: DenseGrid, compression: str) -> tuple[str, bytes, bytes]:
    """The type of a grid's tree, its description with all of the tree but the values of its leaves, and these."""
    tree = _TreeWriter(grid, COMPRESSIONS[compression])
    return tree.type, _description(grid, tree, compression) + b"".join(tree.topology()), b"".join(tree.buffers())


def _copied(grid: Grid) -> tuple[str, bytes, bytes]:
    """The same of a grid of another file, as it is there.

    Raises:
        InputError: its transform is of an unsupported kind, or the file has become shorter.
    """
    start, leaves, end = grid.span
    with grid.path.open("rb") as file:
        file.seek(start)
        data = file.read(end - start)
    if len(data) != end - start:
        raise InputError(f"{grid.path}: has changed since it was read; read the frames again")
    described = _COMPRESSION.pack(grid.compression) + written_metadata(grid.stored)
    described += written_transform(grid.stored_affine)
    return grid.tree_type, described + data[: leaves - start], data[leaves - start :]


def _description(grid: DenseGrid, tree: _TreeWriter, compression: str) -> bytes:
    metadata: dict[str, tuple[str, Any]] = {
        **grid.metadata,
        "class": ("string", grid.grid_class or ("unknown" if grid.values.ndim == 4 else "fog volume")),
        "file_compression": ("string", f"{compression} + active values"),
        "file_voxel_count": ("int64", tree.active_voxels),
        "is_saved_as_half_float": ("bool", tree.half),
        "name": ("string", grid.name),
    }
    transform = grid.transform or Affine.scaling(grid.voxel_size, grid.translation)
    return _COMPRESSION.pack(COMPRESSIONS[compression]) + written_metadata(metadata) + written_transform(transform)


@dataclass(frozen=True)
class _Nodes:
    """Leaves or tiles of one size in file order: their origins (N, 3), and their values, (N, 512[, 3]) or (N[, 3])."""

    origins: np.ndarray
    values: np.ndarray

    def __getitem__(self, chosen: np.ndarray | slice) -> _Nodes:
        return _Nodes(self.origins[chosen], self.values[chosen])


class _TreeWriter:
    """Encodes the tree of a grid."""

    def __init__(self, grid: DenseGrid, compression: int) -> None:
        self._compression, self._shape = compression, grid.values.shape[3:]
        # Values that half precision cannot hold are kept as they are.
        self._dtype = np.dtype(grid.values.dtype.newbyteorder("<"))
        floats = self._dtype.kind == "f"
        self.half = grid.half and floats and bool(np.abs(grid.values).max(initial=0) <= _LARGEST_HALF)
        self.type = f"Tree_{_TYPES[self._dtype.name, len(self._shape)]}_5_4_3{HALF if self.half else ''}"
        self._background = np.full(self._shape, grid.background, self._dtype)
        leaves, active = _leaves_of(grid, self._background)
        equal = leaves.values == leaves.values[:, :1]
        constant = active.all(axis=1) & (equal.all(axis=2) if self._shape else equal).all(axis=1)
        self._leaves, self._active = leaves[~constant], active[~constant]
        tiles = _Nodes(leaves.origins[constant], leaves.values[constant, 0])
        self._small_tiles, self._large_tiles = _merged(tiles)
        self.active_voxels = int(active.sum())

    def topology(self) -> Iterator[bytes]:
        """The nodes from the root down, without the values of the leaves."""
        yield _COUNT.pack(1)
        yield self._background.tobytes()
        below = [self._leaves.origins, self._large_tiles.origins, self._small_tiles.origins]
        uppers = _distinct(np.concatenate([origins // _UPPER_EDGE for origins in below])) * _UPPER_EDGE
        yield _COUNTS.pack(0, len(uppers))
        for upper in uppers:
            inside = [_inside(origins, upper, _UPPER_EDGE) for origins in below]
            leaves, active = self._leaves.origins[inside[0]], self._active[inside[0]]
            small = self._small_tiles[inside[2]]
            lowers = _distinct(np.concatenate([leaves, small.origins]) // _LOWER_EDGE) * _LOWER_EDGE
            yield _COORDINATE.pack(*upper.tolist())
            yield self._node(upper, _UPPER, _LOWER_EDGE, lowers, self._large_tiles[inside[1]])
            for lower in lowers:
                at, tiles = _inside(leaves, lower, _LOWER_EDGE), small[_inside(small.origins, lower, _LOWER_EDGE)]
                yield self._node(lower, _LOWER, LEAF_EDGE, leaves[at], tiles)
                yield np.packbits(active[at], axis=1, bitorder="little").tobytes()

    def buffers(self) -> Iterator[bytes]:
        """The values of the leaves, active voxels only."""
        masks = np.packbits(self._active, axis=1, bitorder="little")
        for mask, active, values in zip(masks, self._active, self._leaves.values, strict=True):
            yield mask.tobytes() + _BACKGROUND + self._run(values[active])

    def _node(self, origin: np.ndarray, count: int, edge: int, children: np.ndarray, tiles: _Nodes) -> bytes:
        """An internal node: which of its parts are nodes, which are active tiles, and the values of these."""
        branches, filled = np.zeros((count,) * 3, bool), np.zeros((count,) * 3, bool)
        branches[tuple(((children - origin) // edge).T)] = True
        filled[tuple(((tiles.origins - origin) // edge).T)] = True
        masks = b"".join(np.packbits(mask, bitorder="little").tobytes() for mask in (branches, filled))
        return masks + _BACKGROUND + self._run(tiles.values)

    def _run(self, values: np.ndarray) -> bytes:
        if self.half and not len(values):  # OpenVDB leaves out the size of such a run, unlike at full precision
            return b""
        data = values.astype("<f2" if self.half else self._dtype)
        return written_run(data.tobytes(), data.itemsize * math.prod(self._shape), self._compression)


def _leaves_of(grid: DenseGrid, background: np.ndarray) -> tuple[_Nodes, np.ndarray]:
    """Cut a dense grid into leaves, and keep those that are not background; and their active voxels (N, 512)."""
    first = np.array(grid.first)
    before = first % LEAF_EDGE
    counts = -(-(before + grid.values.shape[2::-1]) // LEAF_EDGE)
    shape = grid.values.shape[3:]
    occupied = _occupied(grid.values != background, before, counts)
    places = np.argwhere(occupied)
    values = np.empty((len(places), *(LEAF_EDGE,) * 3, *shape), background.dtype)
    values[...] = background
    extents = np.array(grid.values.shape[2::-1])
    for leaf, place in zip(values, places, strict=True):
        low = place * LEAF_EDGE - before
        start, stop = np.maximum(low, 0), np.minimum(low + LEAF_EDGE, extents)
        (x0, y0, z0), (x1, y1, z1) = start.tolist(), stop.tolist()
        (i0, j0, k0), (i1, j1, k1) = (start - low).tolist(), (stop - low).tolist()
        leaf[i0:i1, j0:j1, k0:k1] = grid.values[z0:z1, y0:y1, x0:x1].swapaxes(0, 2)
    values = values.reshape(len(places), LEAF_VOXELS, *shape)
    told = values != background
    active = told.any(axis=2) if shape else told
    origins = places * LEAF_EDGE + (first - before)
    order = _file_order(origins)
    return _Nodes(origins, values)[order], active[order]


def _occupied(told: np.ndarray, before: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Which leaves (X, Y, Z) hold a voxel (Z, Y, X[, 3]) of which something is told."""
    voxels = told.any(axis=3) if told.ndim == 4 else told
    after = counts * LEAF_EDGE - before - voxels.shape[::-1]
    padded = np.pad(voxels, [*zip(before[::-1], after[::-1], strict=True)])
    x, y, z = counts.tolist()
    return np.transpose(padded.reshape(z, LEAF_EDGE, y, LEAF_EDGE, x, LEAF_EDGE).any(axis=(1, 3, 5)), (2, 1, 0))


def _merged(tiles: _Nodes) -> tuple[_Nodes, _Nodes]:
    """Tiles of leaves, and larger ones in place of nodes that are full of equal ones."""
    places, node_of = np.unique(tiles.origins // _LOWER_EDGE, axis=0, return_inverse=True)
    node_of = node_of.reshape(-1)
    full = np.bincount(node_of, minlength=len(places)) == _LOWER**3
    for node in np.flatnonzero(full):
        values = tiles.values[node_of == node]
        full[node] = (values == values[0]).all()
    merged = full[node_of]
    firsts = [int(np.flatnonzero(node_of == node)[0]) for node in np.flatnonzero(full)]
    return tiles[~merged], _Nodes(places[full] * _LOWER_EDGE, tiles.values[firsts])


def _file_order(origins: np.ndarray) -> np.ndarray:
    """The permutation that sorts leaves by upper node, then lower node, then position within it, X slowest."""
    keys = [origins // _UPPER_EDGE, origins // _LOWER_EDGE, origins]
    return np.lexsort([key[:, axis] for key in reversed(keys) for axis in (2, 1, 0)])


def _distinct(places: np.ndarray) -> np.ndarray:
    """The distinct rows, in order, X slowest."""
    return np.unique(places, axis=0)


def _inside(origins: np.ndarray, node: np.ndarray, edge: int) -> np.ndarray:
    """The places of those origins that lie in a node."""
    return np.flatnonzero((origins // edge == node // edge).all(axis=1))
