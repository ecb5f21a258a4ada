"""Frames as OpenVDB files: which grids make up a frame, which box of voxels it spans, and in what axes and units.

A file holds the active voxels, not the domain of the simulation. Our files and Blender's declare the domain; otherwise
it is the box around the active voxels, which must be the same for all frames of a sequence: `box_of_all`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Placement
from tnst_mi.io.conventions import (
    CELLS_PER_FRAME,
    CELLS_PER_TIME,
    LENGTH_PER_TIME,
    MANTAFLOW_TIME_STEP,
    SECONDS_PER_FRAME,
    VELOCITY_UNITS,
    StoredFrame,
)
from tnst_mi.io.grids.uni import OBSTACLE_FLAG
from tnst_mi.io.grids.vdb.metadata import Value
from tnst_mi.io.grids.vdb.reader import Grid, VdbFile, read_vdb
from tnst_mi.io.grids.vdb.tree import Box, require_small
from tnst_mi.io.grids.vdb.writer import DenseGrid, write_vdb
from tnst_mi.io.orientation import to_z_up

_DENSITY, _VELOCITY, _OBSTACLE, _FLAGS = ("density",), ("velocity", "vel", "v"), ("obstacle",), ("flags",)

# Metadata that our files carry; other programs may write it too.
_UP, _UNITS, _LOWEST, _HIGHEST = "tnst_mi_up", "tnst_mi_velocity_units", "tnst_mi_box_min", "tnst_mi_box_max"

#: Blender's caches (Mantaflow) store with every grid the resolution of the domain, whose first voxel is (0, 0, 0).
_BLENDER = "file_base_resolution"

# Voxel coordinates have 32 bits: beyond this one, the position is stored in the translation alone.
_FARTHEST = 1 << 30

# Grids match if the sizes and positions of their voxels differ by less than this fraction of the size.
_TOLERANCE = 1e-4


def read_vdb_frame(path: Path, box: Box | None = None) -> StoredFrame:
    """Read the voxels of a frame in `box`, or in the file's own box.

    Raises:
        InputError: the file cannot be used, its grids do not fit together, or it has no active voxel and no box.
    """
    file = read_vdb(path)
    density, velocity, obstacle = _grids_of(file)
    found = ", ".join(repr(grid.name) for grid in file.grids) or "none"
    lacking = f"no grid 'density', the grids found are: {found}"
    main = density or velocity
    if main is None:
        return StoredFrame(density=None, lacking=lacking)
    box = box or _box_of(path, file, [grid for grid in (density, velocity) if grid is not None])
    if box is None:
        raise InputError(f"{path}: no active voxel in it, so the size of the grid is unknown")
    kinds = [grid.kind for grid in (density, velocity, obstacle) if grid is not None]
    require_small(path, box, sum(kind.components for kind in kinds if kind is not None))
    x, y, z = (main.voxel_size * int(low) + origin for low, origin in zip(box[0], main.translation, strict=True))
    solid = None
    if obstacle is not None:
        solid = obstacle.tree.values_in(box)
        solid = (solid.astype(np.int32) & OBSTACLE_FLAG) != 0 if obstacle.name.lower() in _FLAGS else solid > 0
    up, units, dt = _conventions(file, main)
    return StoredFrame(
        density=None if density is None else density.tree.values_in(box),
        velocity=None if velocity is None else velocity.tree.values_in(box),
        obstacle=solid,
        staggered=velocity is not None and velocity.staggered,
        # Blender stores velocities only where there is smoke; the zeros elsewhere are not data.
        known=velocity.tree.active_in(box) if velocity is not None and velocity.staggered else None,
        up=up,
        velocity_units=units,
        dt=dt,
        voxel_size=main.voxel_size,
        corner=(x, y, z),
        lacking=lacking,
    )


def write_vdb_frame(path: Path, arrays: dict[str, np.ndarray], placement: Placement | None = None) -> None:
    """Write named y-up grids (D, H, W) at their original placement; without one, the file is z up, as in Blender."""
    placement = placement or Placement()
    if placement.up == "z":
        arrays = {name: to_z_up(array) for name, array in arrays.items()}
    size = placement.voxel_size
    i, j, k = (round(coordinate / size) for coordinate in placement.corner)
    first = (i, j, k) if max(map(abs, (i, j, k))) <= _FARTHEST else (0, 0, 0)
    rest = [coordinate - index * size for coordinate, index in zip(placement.corner, first, strict=True)]
    x, y, z = (value if abs(value) > _TOLERANCE * size else 0.0 for value in rest)
    extents = next(iter(arrays.values())).shape[2::-1]
    last = tuple(low + extent - 1 for low, extent in zip(first, extents, strict=True))
    metadata: dict[str, tuple[str, Value]] = {
        "creator": ("string", "tnst_mi"),
        _UP: ("string", placement.up),
        _UNITS: ("string", CELLS_PER_FRAME),
        _LOWEST: ("vec3i", first),
        _HIGHEST: ("vec3i", last),
    }
    grids = [DenseGrid(name, array.astype(np.float32), first, size, (x, y, z)) for name, array in arrays.items()]
    write_vdb(path, grids, metadata)


def describe_vdb(path: Path) -> list[str]:
    """The contents of a file, one line per grid."""
    lines = []
    for grid in read_vdb(path).grids:
        kind = grid.tree_type.removeprefix("Tree_").removesuffix("_HalfFloat").removesuffix("_5_4_3")
        words = [f"{'half ' if grid.half else ''}{kind}", str(grid.metadata.get("class", "unknown")), grid.codec]
        words.append(f"voxel size {grid.voxel_size:g}")
        if grid.kind is not None:
            box = grid.topology.active_box()
            words.append(f"{grid.topology.active_voxels} active voxels")
            if box is not None:
                words.append(f"from {tuple(box[0].tolist())} to {tuple(box[1].tolist())}")
        lines.append(f"  grid {grid.name!r}: {', '.join(words)}")
    return lines


def box_of_all(paths: Sequence[Path]) -> Box | None:
    """The smallest box that holds the boxes of several files, the frames of one sequence; None if none has one.

    Raises:
        InputError: a file cannot be used, or the files' voxels differ in size or position.
    """
    lowest, highest, first = [], [], None
    for path in paths:
        file = read_vdb(path)
        grids = [grid for grid in _grids_of(file)[:2] if grid is not None]
        if not grids:
            continue
        first = first or grids[0]
        _require_fit(path, first, grids[0], f"in {first.path.name}")
        box = _box_of(path, file, grids)
        if box is not None:
            lowest.append(box[0])
            highest.append(box[1])
    return (np.min(lowest, axis=0), np.max(highest, axis=0)) if lowest else None


def _grids_of(file: VdbFile) -> tuple[Grid | None, Grid | None, Grid | None]:
    """The density, velocity and obstacle grids of a frame, each None if missing."""
    scalars = [grid for grid in file.grids if grid.kind is not None and grid.kind.components == 1]
    vectors = [grid for grid in file.grids if grid.kind is not None and grid.kind.components == 3]
    density = _named(scalars, _DENSITY)
    others = [grid for grid in scalars if grid.name.lower() not in _OBSTACLE + _FLAGS]
    if density is None and len(others) == 1:
        density = others[0]
    velocity = _named(vectors, _VELOCITY)
    obstacle = _named(scalars, _OBSTACLE) or _named(scalars, _FLAGS)
    main = density or velocity
    for grid in (velocity, obstacle):
        if grid is not None:
            _require_fit(grid.path, main or grid, grid, f"of grid {(main or grid).name!r}")
    return density, velocity, obstacle


def _named(grids: Sequence[Grid], names: tuple[str, ...]) -> Grid | None:
    return next((grid for name in names for grid in grids if grid.name.lower() == name), None)


def _require_fit(path: Path, one: Grid, other: Grid, whose: str) -> None:
    sizes = np.array([one.voxel_size, other.voxel_size])
    apart = np.abs(np.subtract(one.translation, other.translation)).max()
    if np.ptp(sizes) > _TOLERANCE * sizes[0] or apart > _TOLERANCE * sizes[0]:
        raise InputError(
            f"{path}: voxels of grid {other.name!r} have size {other.voxel_size:g} at {other.translation}, "
            f"expected {one.voxel_size:g} at {one.translation} like those {whose}; resample it"
        )


def _box_of(path: Path, file: VdbFile, grids: Sequence[Grid]) -> Box | None:
    """The box that a file declares, extended to the active voxels of its first grid; else the box of all active voxels.

    `grids` are the density and the velocity, if present.
    """
    told = _told_box(path, file, grids)
    boxes = [grid.topology.active_box() for grid in (grids if told is None else grids[:1])]
    boxes = [box for box in (told, *boxes) if box is not None]
    if not boxes:
        return None
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)


def _told_box(path: Path, file: VdbFile, grids: Sequence[Grid]) -> Box | None:
    corners = [file.metadata.get(key) for key in (_LOWEST, _HIGHEST)]
    resolution = grids[0].metadata.get(_BLENDER) if grids else None
    if not all(isinstance(corner, tuple) and len(corner) == 3 for corner in corners):
        if not isinstance(resolution, tuple) or len(resolution) != 3:
            return None
        corners = [(0, 0, 0), np.array(resolution, np.int64) - 1]
    low, high = (np.array(corner, np.int64) for corner in corners)
    if (high < low).any():
        raise InputError(f"{path}: damaged: says that it spans voxels {low.tolist()} to {high.tolist()}")
    return low, high


def _conventions(file: VdbFile, grid: Grid) -> tuple[str, str, float | None]:
    """The up axis, the unit of the velocity, and the duration of a frame in its unit of time."""
    up, units = file.metadata.get(_UP), file.metadata.get(_UNITS)
    if up in ("y", "z") and units in VELOCITY_UNITS:
        return up, units, None if units == CELLS_PER_FRAME else SECONDS_PER_FRAME
    if _BLENDER in grid.metadata:
        return "z", CELLS_PER_TIME, MANTAFLOW_TIME_STEP
    return "y", LENGTH_PER_TIME, SECONDS_PER_FRAME
