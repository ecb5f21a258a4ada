"""Where the smoke of a tree is: its clumps, parts that are far from each other, and which of them are stray."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tnst_mi.geometry.boxes import Box, union
from tnst_mi.io.grids.vdb.file_format.tree import LEAF_EDGE, LEAF_VOXELS, Tree

# Smoke is of one clump if it lies in neighbouring bins, cubes with this edge. It divides the edges of nodes.
_BIN = 32

# Tiles larger than this are not cut into bins: what is around such a tile is of one clump.
_LARGEST_TILE = 128

# Clumps with less than this share of all mass, together, are stray.
_STRAY = 1e-3

_NEIGHBOURS = [shift for shift in itertools.product((-1, 0, 1), repeat=3) if any(shift)]


@dataclass(frozen=True, eq=False)
class Clump:
    """A part of the smoke of a frame that is far from the rest.

    Attributes:
        box: the smallest box around it.
        mass: the sum of its values.
        voxels: how many are not 0.
        stored: for how many the file has values; those of a tile share one, and count as one leaf.
    """

    box: Box
    mass: float
    voxels: int
    stored: int


@dataclass(frozen=True)
class _Blocks:
    """Leaves and tiles with smoke: the box around it (N, 3) each, mass (N), voxels (N), those stored (N)."""

    low: np.ndarray
    high: np.ndarray
    mass: np.ndarray
    voxels: np.ndarray
    stored: np.ndarray

    def clump(self, chosen: np.ndarray | slice) -> Clump:
        """The clump of some of them."""
        box = self.low[chosen].min(axis=0), self.high[chosen].max(axis=0)
        voxels, stored = (int(counts[chosen].sum()) for counts in (self.voxels, self.stored))
        return Clump(box, float(self.mass[chosen].sum()), voxels, stored)


def clumps_of(trees: Sequence[Tree]) -> list[Clump]:
    """The clumps of a density, of one tree or several; the one with the most mass comes first.

    Voxels that are not 0 are smoke. Where the background is not 0, smoke is everywhere, and the active voxels count as
    one clump.
    """
    if any(tree.background.any() for tree in trees):
        box = union(tree.active_box() for tree in trees)
        voxels = sum(tree.active_voxels for tree in trees)
        stored = sum(int(tree.leaf_active.sum()) + LEAF_VOXELS * int(tree.tile_active.sum()) for tree in trees)
        return [] if box is None else [Clump(box, float(voxels), voxels, stored)]
    columns = [np.concatenate(column) for column in zip(*map(_blocks_of, trees), strict=True)]
    if not columns or not len(columns[0]):
        return []
    blocks = _Blocks(*columns)
    if (blocks.high - blocks.low >= _LARGEST_TILE).any():
        return [blocks.clump(slice(None))]
    labels = _labels(blocks)
    ordered = np.argsort(labels, kind="stable")
    found = [blocks.clump(chosen) for chosen in np.split(ordered, np.flatnonzero(np.diff(labels[ordered])) + 1)]
    return sorted(found, key=lambda clump: -clump.mass)


def stray(clumps: Sequence[Clump]) -> list[Clump]:
    """Of clumps in the order of their mass, those that together have next to none."""
    whole = sum(clump.mass for clump in clumps)
    lightest_first = clumps[:0:-1]
    share = np.cumsum([clump.mass for clump in lightest_first])
    return list(lightest_first[: int(np.count_nonzero(share < _STRAY * whole))])


def smoke_box(clumps: Sequence[Clump], ignore_stray: bool) -> Box | None:
    """The box around the smoke of a frame."""
    left_out = len(stray(clumps)) if ignore_stray else 0
    return union(clump.box for clump in clumps[: len(clumps) - left_out])


def _blocks_of(tree: Tree) -> tuple[np.ndarray, ...]:
    """The columns of `_Blocks`."""
    inside = tree.leaf_values != 0.0
    occupied = inside.any(axis=1)
    voxels = inside[occupied].reshape(-1, *(LEAF_EDGE,) * 3)
    along = np.stack([voxels.any(axis=axes) for axes in ((2, 3), (1, 3), (1, 2))], axis=1)
    low = tree.leaf_origins[occupied] + along.argmax(axis=-1)
    high = tree.leaf_origins[occupied] + LEAF_EDGE - 1 - along[..., ::-1].argmax(axis=-1)
    mass = np.abs(tree.leaf_values[occupied]).sum(axis=1, dtype=np.float64)
    filled = tree.tile_values != 0.0
    origins, edges = tree.tile_origins[filled], tree.tile_edges[filled]
    return (
        np.concatenate([low, origins]),
        np.concatenate([high, origins + edges[:, None] - 1]),
        np.concatenate([mass, np.abs(tree.tile_values[filled]) * edges.astype(np.float64) ** 3]),
        np.concatenate([inside[occupied].sum(axis=1), edges**3]),
        np.concatenate([inside[occupied].sum(axis=1), np.full(len(edges), LEAF_VOXELS)]),
    )


def _labels(blocks: _Blocks) -> np.ndarray:
    """The number of the clump of each block."""
    first, last = blocks.low // _BIN, blocks.high // _BIN
    bins: dict[tuple[int, ...], list[int]] = {}
    for block, (low, high) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        for place in itertools.product(*(range(a, b + 1) for a, b in zip(low, high, strict=True))):
            bins.setdefault(place, []).append(block)
    labels = np.full(len(blocks.mass), -1)
    waiting: dict[tuple[int, ...], None] = dict.fromkeys(bins)
    for label in itertools.count():
        if not waiting:
            return labels
        reached = [waiting.popitem()[0]]
        while reached:
            x, y, z = reached.pop()
            labels[bins[x, y, z]] = label
            for dx, dy, dz in _NEIGHBOURS:
                place = (x + dx, y + dy, z + dz)
                if place in waiting:
                    del waiting[place]
                    reached.append(place)
    return labels
