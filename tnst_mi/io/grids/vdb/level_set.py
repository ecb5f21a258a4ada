"""Level sets: recognising them, and their interior as density."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.grids.vdb.file_format.reader import Grid
from tnst_mi.io.grids.vdb.file_format.tree import Tree
from tnst_mi.machine.terminal import quoted

_CLASS = "level set"
_WORDS = ("sdf", "levelset", "level_set")

# The share of half the width of the narrow band that is rounding, in half precision too.
_ROUNDING = 1e-3


def is_level_set(grid: Grid) -> bool:
    """Whether a grid holds signed distances from a surface: its class says so, or its name."""
    return grid.metadata.get("class") == _CLASS or any(word in grid.name.lower() for word in _WORDS)


def looks_like_level_set(grid: Grid) -> bool:
    """Whether a grid holds what signed distances are in the narrow band of a level set, whatever its class and name.

    They are negative inside and the background outside, and reach as far to either side.

    Raises:
        InputError: the tree is damaged.
    """
    if isinstance(grid.transform, str):
        return False  # of a transform of unknown length, not even the tree is found
    half_width = float(grid.topology.background)
    if not 0.0 < half_width < np.inf:
        return False
    tree = grid.tree
    values = np.concatenate([tree.leaf_values.ravel(), tree.tile_values])
    farthest = half_width * (1.0 + _ROUNDING)
    inside = values.size > 0 and -farthest <= float(values.min()) < -_ROUNDING * half_width
    return inside and float(values.max()) <= farthest


class FogVolume(Grid):
    """A level set that is read as a density: from 0 at its surface to 1 inside, where the narrow band ends.

    The rule is that of OpenVDB's `sdfToFogVolume`: −φ over the background, clipped to [0, 1].
    """

    @cached_property
    def tree(self) -> Tree:
        """The density.

        Raises:
            InputError: the level set cannot be read, or its background, which is half of the width of the narrow band,
                is not a distance above 0.
        """
        tree = super().tree
        half_width = float(tree.background)
        if not 0.0 < half_width < np.inf:
            raise InputError(
                f"{self.path}: level set {quoted(self.name)} has a background of {half_width:g}, expected half the "
                "width of its narrow band, above 0; rebuild the level set"
            )

        def fog(distances: np.ndarray) -> np.ndarray:
            return np.clip(-distances / distances.dtype.type(half_width), 0, 1)

        leaves, tiles = fog(tree.leaf_values), fog(tree.tile_values)
        return dataclasses.replace(
            tree,
            background=np.zeros_like(tree.background),
            leaf_values=leaves,
            leaf_active=leaves > 0,
            tile_values=tiles,
            tile_active=tiles > 0,
        )

    @cached_property
    def topology(self) -> Tree:
        """The same: the inside is known only from the values."""
        return self.tree


def fog_volume(grid: Grid) -> FogVolume:
    """A level set as a density."""
    return FogVolume(**{field.name: getattr(grid, field.name) for field in dataclasses.fields(grid)})
