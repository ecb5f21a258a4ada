"""Velocities in three files, each with the grid of one component, as if one file had these grids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.io.grids.vdb.adaptive_domain import placed
from tnst_mi.io.grids.vdb.file_format.reader import Grid, VdbFile, read_vdb
from tnst_mi.io.interpretation.grid_names import component, listed


def read_parts(paths: Sequence[Path]) -> VdbFile:
    """Read a file, or the three files of the components x, y and z of a velocity, as one with their grids.

    Voxels are where they are known to be, as `placed` has them.

    Raises:
        InputError: a file cannot be used, or it is not clear which of its grids is the component.
    """
    first, *others = (placed(read_vdb(path)) for path in paths)
    if not others:
        return first
    grids = [
        replace(_component(file, axis), name=f"velocity.{'xyz'[axis]}") for axis, file in enumerate((first, *others))
    ]
    return replace(first, grids=grids)


def _component(file: VdbFile, axis: int) -> Grid:
    """The grid of a component: the only one of numbers, or the one of that name."""
    scalars = [grid for grid in file.grids if grid.kind is not None and grid.kind.components == 1]
    named = [grid for grid in scalars if (found := component(grid.name)) is not None and found[1] == axis]
    chosen = scalars if len(scalars) == 1 else named
    if len(chosen) != 1:
        shown = listed([grid.name for grid in file.grids])
        raise InputError(
            f"{file.path}: expected one grid of numbers, a component of the velocity, found {shown}; --velocity none "
            "goes without it"
        )
    return chosen[0]
