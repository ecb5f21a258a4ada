"""OpenVDB's sparse trees with branching 32³, 16³ and 8³: read from a file, and expanded into dense grids.

Source: `openvdb/tree/RootNode.h`, `InternalNode.h`, `LeafNode.h`, `io/Compression.h`. Coordinates in this module
are (X, Y, Z) in voxels, and the 8³ voxels of a leaf are stored with Z fastest.
"""

from __future__ import annotations

import itertools
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tnst_mi.errors import InputError
from tnst_mi.geometry.boxes import Box
from tnst_mi.io.grids.vdb.file_format.cursor import Cursor
from tnst_mi.io.grids.vdb.file_format.values import ACTIVE_MASK, ValueType, read_run

#: Voxels along an edge of a leaf, and in the whole leaf.
LEAF_EDGE, LEAF_VOXELS = 8, 512

# Children along an edge of a node, and voxels along an edge of a child, from the root down.
_LEVELS = ((32, 128), (16, 8))
_ROOT_EDGE = 4096

# How a node encodes its inactive values: all are the background, its negative, or one other value; a mask selects
# one of two: negative or background, another value or background, two others; or all values are stored.
_BACKGROUND, _NEGATIVE, _ONE, _MASK_NEGATIVE, _MASK_ONE, _MASK_TWO, _ALL = range(7)

_INTEGER = struct.Struct("<i")
_COUNTS = struct.Struct("<2I")
_COORDINATE = struct.Struct("<3i")


@dataclass(frozen=True)
class Tree:
    """A sparse grid: leaves of 8³ voxels, constant tiles, and one value everywhere else.

    Attributes:
        background: the value everywhere else, () or (3,).
        leaf_origins: (N, 3) lowest voxel of each leaf.
        leaf_active: (N, 512) bool, which voxels of the leaves are active.
        leaf_values: (N, 512) or (N, 512, 3).
        tile_origins: (T, 3) lowest voxel of each tile.
        tile_edges: (T) voxels along the edge of each tile: 8, 128 or 4096.
        tile_active: (T) bool.
        tile_values: (T) or (T, 3).
    """

    background: np.ndarray
    leaf_origins: np.ndarray
    leaf_active: np.ndarray
    leaf_values: np.ndarray
    tile_origins: np.ndarray
    tile_edges: np.ndarray
    tile_active: np.ndarray
    tile_values: np.ndarray

    @property
    def active_voxels(self) -> int:
        """Number of active voxels, including those in tiles."""
        return int(self.leaf_active.sum()) + sum(int(edge) ** 3 for edge in self.tile_edges[self.tile_active])

    def active_box(self) -> Box | None:
        """The smallest box around all active voxels; None if there are none."""
        lowest, highest = [self.tile_origins[self.tile_active]], []
        highest.append(lowest[0] + self.tile_edges[self.tile_active, None] - 1)
        occupied = self.leaf_active.any(axis=1)
        voxels = self.leaf_active[occupied].reshape(-1, *(LEAF_EDGE,) * 3)
        along = np.stack([voxels.any(axis=axes) for axes in ((2, 3), (1, 3), (1, 2))], axis=1)
        lowest.append(self.leaf_origins[occupied] + along.argmax(axis=-1))
        highest.append(self.leaf_origins[occupied] + LEAF_EDGE - 1 - along[..., ::-1].argmax(axis=-1))
        if not sum(map(len, lowest)):
            return None
        return np.concatenate(lowest).min(axis=0), np.concatenate(highest).max(axis=0)

    def values_in(self, box: Box) -> np.ndarray:
        """The values of all voxels of a box, active or not, as a dense grid (Z, Y, X) or (Z, Y, X, 3)."""
        return self._dense(box, self.background, self.tile_values, self.leaf_values)

    def active_in(self, box: Box) -> np.ndarray:
        """Which voxels of a box are active, (Z, Y, X) bool."""
        return self._dense(box, np.array(False), self.tile_active, self.leaf_active)

    def _dense(self, box: Box, background: np.ndarray, tiles: np.ndarray, leaves: np.ndarray) -> np.ndarray:
        first, last = (corner // LEAF_EDGE for corner in box)
        counts = last - first + 1
        shape = background.shape
        dense = np.empty((*(counts[::-1] * LEAF_EDGE), *shape), background.dtype)
        dense[...] = background
        # A view of (bZ, Z, bY, Y, bX, X) as (bX, bY, bZ, X, Y, Z).
        x, y, z = counts.tolist()
        blocks = dense.reshape(z, LEAF_EDGE, y, LEAF_EDGE, x, LEAF_EDGE, *shape)
        blocks = blocks.transpose(4, 2, 0, 5, 3, 1, *range(6, blocks.ndim))
        starts = self.tile_origins // LEAF_EDGE - first
        ends = np.minimum(starts + self.tile_edges[:, None] // LEAF_EDGE, counts)
        starts = np.maximum(starts, 0)
        # Larger tiles never lie inside smaller ones, so the order does not matter.
        for index in np.flatnonzero((starts < ends).all(axis=1)):
            blocks[tuple(map(slice, starts[index], ends[index]))] = tiles[index]
        places = self.leaf_origins // LEAF_EDGE - first
        inside = ((places >= 0) & (places < counts)).all(axis=1)
        blocks[tuple(places[inside].T)] = leaves[inside].reshape(-1, *(LEAF_EDGE,) * 3, *shape)
        margin = box[0] - first * LEAF_EDGE
        window = zip(margin[::-1], (margin + box[1] - box[0] + 1)[::-1], strict=True)
        return np.ascontiguousarray(dense[tuple(itertools.starmap(slice, window))])


class TreeReader:
    """Reads one tree; a file holds its whole topology first, then the values of the leaves."""

    def __init__(self, cursor: Cursor, kind: ValueType, compression: int) -> None:
        """Set where to read, the kind of values, and their compression flags."""
        self._cursor, self._kind, self._compression = cursor, kind, compression
        self._background = np.zeros(kind.shape, kind.dtype)
        self._tiles: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
        self._leaf_origins: list[np.ndarray] = []
        self._leaf_masks: list[np.ndarray] = []

    def read(self, values: bool = True) -> Tree:
        """Read the tree; without the values of its leaves if only the topology matters.

        Raises:
            InputError: the data are truncated or damaged.
        """
        active = self.read_topology()
        origins = np.concatenate([np.empty((0, 3), np.int64), *self._leaf_origins])
        leaves = self._read_leaves(active) if values else np.empty((0, LEAF_VOXELS, *self._kind.shape))
        none = (
            np.empty((0, 3), np.int64),
            np.empty(0, np.int64),
            np.empty(0, bool),
            np.empty((0, *self._kind.shape), self._kind.dtype),
        )
        tiles = [np.concatenate(columns) for columns in zip(none, *self._tiles, strict=True)]
        return Tree(self._background, origins, active, leaves, *tiles)

    def read_topology(self) -> np.ndarray:
        """Read everything but the values of the leaves; returns which of their voxels are active, (N, 512).

        Raises:
            InputError: the data are truncated or damaged.
        """
        self._read_root()
        return np.concatenate([np.empty((0, LEAF_VOXELS), bool), *self._leaf_masks])

    def skip_leaves(self) -> None:
        """Go past the values of the leaves, after `read_topology`.

        Raises:
            InputError: the data are truncated or damaged.
        """
        for masks in self._leaf_masks:
            for count in masks.sum(axis=1).tolist():
                self._cursor.take(LEAF_VOXELS // 8)
                self._read_run(count, LEAF_VOXELS)

    def _read_root(self) -> None:
        cursor, kind = self._cursor, self._kind
        (buffers,) = cursor.unpack(_INTEGER)
        if buffers != 1:
            raise InputError(f"{cursor.path}: damaged: a tree with {buffers} buffers, expected 1; export it again")
        self._background = kind.one(cursor.take(kind.itemsize))
        tiles, children = cursor.unpack(_COUNTS)
        layout = np.dtype([("origin", "<i4", 3), ("value", kind.dtype, kind.shape), ("active", "u1")])
        stored = np.frombuffer(cursor.take(tiles * layout.itemsize), layout)
        self._add_tiles(_aligned(stored["origin"]), _ROOT_EDGE, stored["active"] != 0, stored["value"])
        for _ in range(children):
            self._read_branches(_aligned(cursor.unpack(_COORDINATE)), 0)

    def _read_branches(self, origin: np.ndarray, level: int) -> None:
        """Read an internal node: its tiles, then its children."""
        count, edge = _LEVELS[level]
        branches, active = self._mask(count**3), self._mask(count**3)
        values = self._read_node(active)
        places = np.stack(np.unravel_index(np.arange(count**3), (count,) * 3), axis=1) * edge + origin
        told = active | (values != self._background).reshape(count**3, -1).any(axis=1)
        tiles = told & ~branches
        self._add_tiles(places[tiles], edge, active[tiles], values[tiles])
        below = places[branches]
        if level + 1 < len(_LEVELS):
            for place in below:
                self._read_branches(place, level + 1)
        elif len(below):
            self._leaf_origins.append(below)
            masks = np.frombuffer(self._cursor.take(len(below) * LEAF_VOXELS // 8), np.uint8)
            self._leaf_masks.append(_unpacked(masks).reshape(-1, LEAF_VOXELS))

    def _add_tiles(self, origins: np.ndarray, edge: int, active: np.ndarray, values: np.ndarray) -> None:
        if len(origins):
            self._tiles.append((origins, np.full(len(origins), edge, np.int64), active, values))

    def _read_leaves(self, active: np.ndarray) -> np.ndarray:
        """Read the values of all leaves, scattered into place in one assignment."""
        values = np.empty((*active.shape, *self._kind.shape), self._kind.dtype)
        values[...] = self._background
        stored = active.copy()
        runs = []
        for index, count in enumerate(active.sum(axis=1).tolist()):
            self._cursor.take(LEAF_VOXELS // 8)  # the mask of active voxels, repeated
            run, complete, inactive = self._read_run(count, LEAF_VOXELS)
            runs.append(run)
            if complete:
                stored[index] = True
            elif inactive is not None:
                values[index] = inactive
        values[stored] = self._kind.run(b"".join(runs))
        return values

    def _read_node(self, active: np.ndarray) -> np.ndarray:
        """Read the values of one node."""
        run, complete, inactive = self._read_run(int(active.sum()), len(active))
        if complete:
            return self._kind.run(bytes(run))
        values = np.empty((len(active), *self._kind.shape), self._kind.dtype)
        values[...] = self._background if inactive is None else inactive
        values[active] = self._kind.run(bytes(run))
        return values

    def _read_run(self, active: int, size: int) -> tuple[bytes | memoryview, bool, np.ndarray | None]:
        """Read the values of a node of `size`: all of them, or the active ones and what the inactive ones equal."""
        (state,) = self._cursor.take(1)
        if state > _ALL:
            raise InputError(f"{self._cursor.path}: damaged: a node of unknown kind {state}; export it again")
        inactive = self._read_inactive(state, size)
        complete = state == _ALL or not self._compression & ACTIVE_MASK
        count = size if complete else active
        if self._kind.half and count == 0:  # OpenVDB leaves out the size of such a run, unlike at full precision
            return b"", complete, inactive
        return read_run(self._cursor, count * self._kind.run_itemsize, self._compression), complete, inactive

    def _read_inactive(self, state: int, size: int) -> np.ndarray | None:
        """The inactive values of a node, one for all voxels or one for each; None if they are the background."""
        if state in (_BACKGROUND, _ALL):
            return None
        first, second = -self._background, self._background
        if state in (_ONE, _MASK_ONE, _MASK_TWO):
            first = self._kind.one(self._cursor.take(self._kind.itemsize))
        if state == _MASK_TWO:
            second = self._kind.one(self._cursor.take(self._kind.itemsize))
        if state in (_NEGATIVE, _ONE):
            return first
        chosen = self._mask(size).reshape(-1, *(1 for _ in self._kind.shape))
        return np.where(chosen, second, first)

    def _mask(self, size: int) -> np.ndarray:
        return _unpacked(np.frombuffer(self._cursor.take(size // 8), np.uint8))


def _unpacked(masks: np.ndarray) -> np.ndarray:
    return np.unpackbits(masks, bitorder="little").view(bool)


def _aligned(origin: ArrayLike) -> np.ndarray:
    """The origins of the root's children, rounded down to where such can be, as OpenVDB does with damaged ones."""
    return np.asarray(origin, np.int64) // _ROOT_EDGE * _ROOT_EDGE
