"""Where the smoke of a tree is: its clumps, parts that are far from each other, and which of them are stray."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tnst_mi.geometry.boxes import Box, union
from tnst_mi.io.grids.vdb.file_format.tree import LEAF_EDGE, Tree

# Smoke is of one clump if it lies in neighbouring bins, cubes with this edge. It divides the edges of nodes.
_BIN = 32

# The edge of tiles above bins. Where there are larger ones, all smoke is of one clump.
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
    """

    box: Box
    mass: float
    voxels: int


@dataclass(frozen=True)
class _Blocks:
    """Leaves and tiles with smoke: the box around it (N, 3) each, mass (N), voxels (N)."""

    low: np.ndarray
    high: np.ndarray
    mass: np.ndarray
    voxels: np.ndarray

    def clumps(self, labels: np.ndarray) -> list[Clump]:
        """The clumps of blocks with equal labels (N)."""
        order = np.argsort(labels, kind="stable")
        starts = np.concatenate([[0], np.flatnonzero(np.diff(labels[order])) + 1])
        low, high = np.minimum.reduceat(self.low[order], starts), np.maximum.reduceat(self.high[order], starts)
        sums = (np.add.reduceat(column[order], starts).tolist() for column in (self.mass, self.voxels))
        return [Clump(box, *rest) for box, *rest in zip(zip(low, high, strict=True), *sums, strict=True)]


def clumps_of(trees: Sequence[Tree]) -> list[Clump]:
    """The clumps of a density, of one tree or several; the one with the most mass comes first.

    Voxels that are not 0 are smoke. Where the background is not 0, smoke is everywhere, and the active voxels count as
    one clump.
    """
    if any(tree.background.any() for tree in trees):
        box = union(tree.active_box() for tree in trees)
        voxels = sum(tree.active_voxels for tree in trees)
        return [] if box is None else [Clump(box, float(voxels), voxels)]
    columns = [np.concatenate(column) for column in zip(*map(_blocks_of, trees), strict=True)]
    if not columns or not len(columns[0]):
        return []
    blocks = _Blocks(*columns)
    if (blocks.high - blocks.low >= _LARGEST_TILE).any():
        return blocks.clumps(np.zeros(len(blocks.mass), int))
    return sorted(blocks.clumps(_labels(blocks)), key=lambda clump: -clump.mass)


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
    filled = tree.tile_values != 0.0
    origins, edges = tree.tile_origins[filled], tree.tile_edges[filled]
    with np.errstate(over="ignore"):
        of_leaves = _mass(tree.leaf_values[occupied]).sum(axis=1)
        of_tiles = _mass(tree.tile_values[filled]) * edges.astype(np.float64) ** 3
    return (
        np.concatenate([low, origins]),
        np.concatenate([high, origins + edges[:, None] - 1]),
        np.concatenate([of_leaves, of_tiles]),
        np.concatenate([inside[occupied].sum(axis=1), edges**3]),
    )


def _mass(values: np.ndarray) -> np.ndarray:
    """That of voxels; 0 where values are not finite, for which the file is refused when they are read."""
    return np.where(np.isfinite(values), np.abs(values), 0.0).astype(np.float64)


def _labels(blocks: _Blocks) -> np.ndarray:
    """The number of the clump of each block.

    A large tile counts as one cube, not as its many bins: a few bytes of a file tell of thousands of such tiles.
    """
    large = (blocks.high - blocks.low >= _BIN).any(axis=1)
    bins, tiles = _Cubes(blocks.low[~large] // _BIN), _Cubes(blocks.low[large] // _LARGEST_TILE)
    count = bins.count + tiles.count
    pairs = []
    for shift in _NEIGHBOURS[: len(_NEIGHBOURS) // 2]:  # the others are their opposites
        pairs.append(bins.found(bins.places + shift))
        pairs.append(tiles.found(tiles.places + shift) + bins.count)
    for shift in _NEIGHBOURS:
        of_bins, of_tiles = tiles.found((bins.places + shift) * _BIN // _LARGEST_TILE)
        pairs.append(np.stack([of_bins, of_tiles + bins.count]))
    of_cubes = _connected(count, np.concatenate(pairs, axis=1))
    labels = np.empty(len(blocks.mass), int)
    labels[~large], labels[large] = of_cubes[bins.numbers], of_cubes[bins.count + tiles.numbers]
    return labels


class _Cubes:
    """The places of cubes of one size, in units of their edge, each once.

    Attributes:
        places: (N, 3).
        numbers: for each place given, that of its cube.
        count: N.
    """

    def __init__(self, places: np.ndarray) -> None:
        self._axes = [np.unique(places[:, axis]) for axis in range(3)]
        ranks = [np.searchsorted(known, places[:, axis]) for axis, known in enumerate(self._axes)]
        self._keys, first, self.numbers = np.unique(self._key(ranks), return_index=True, return_inverse=True)
        self.places, self.count = places[first], len(first)

    def found(self, places: np.ndarray) -> np.ndarray:
        """Of other places, the numbers of those where there are cubes, and the numbers of these, (2, M)."""
        if not self.count:
            return np.empty((2, 0), int)
        ranks = [_rank(known, places[:, axis]) for axis, known in enumerate(self._axes)]
        there = np.flatnonzero(np.logical_and.reduce([rank >= 0 for rank in ranks]))
        cubes = _rank(self._keys, self._key([rank[there] for rank in ranks]))
        return np.stack([there[cubes >= 0], cubes[cubes >= 0]])

    def _key(self, ranks: Sequence[np.ndarray]) -> np.ndarray:
        # Ranks, since places themselves would exceed 64 bits.
        return np.ravel_multi_index(tuple(ranks), [max(1, len(known)) for known in self._axes])


def _rank(known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Where values are in a sorted array; -1 for those that are not there."""
    rank = np.minimum(np.searchsorted(known, values), len(known) - 1)
    return np.where(known[rank] == values, rank, -1)


def _connected(count: int, pairs: np.ndarray) -> np.ndarray:
    """For each of some nodes, the lowest one that is connected to it by pairs (2, M)."""
    lowest = np.arange(count)
    while True:
        ends = lowest[pairs]
        joined, least = lowest.copy(), ends.min(axis=0)
        for end in ends:
            np.minimum.at(joined, end, least)
        while ((following := joined[joined]) != joined).any():
            joined = following
        if (joined == lowest).all():
            return lowest
        lowest = joined
