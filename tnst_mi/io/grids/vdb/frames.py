"""Frames as OpenVDB files: which box of voxels a frame spans, and where it lies.

A file holds the active voxels, not the domain of the simulation. Our files and Blender's declare the domain; otherwise
it is the box around the active voxels, which must be the same for all frames of a sequence: `box_of_all`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Note, Placement
from tnst_mi.io.conventions import CELLS_PER_FRAME, WITHOUT_SMOKE, StoredFrame
from tnst_mi.io.grids.vdb.metadata import Value
from tnst_mi.io.grids.vdb.programs import BLENDER, UNITS, UP, program_of
from tnst_mi.io.grids.vdb.quantities import Quantities, on_faces, quantities_of, solid_voxels, type_in_words
from tnst_mi.io.grids.vdb.reader import Grid, VdbFile, read_vdb
from tnst_mi.io.grids.vdb.tree import Box, require_small
from tnst_mi.io.grids.vdb.writer import DenseGrid, write_vdb
from tnst_mi.io.orientation import to_z_up
from tnst_mi.io.roles import Wanted

# Metadata that our files carry; other programs may write it too.
_LOWEST, _HIGHEST = "tnst_mi_box_min", "tnst_mi_box_max"

# Voxel coordinates have 32 bits: beyond this one, the position is stored in the translation alone.
_FARTHEST = 1 << 30

# Grids match if the sizes and positions of their voxels differ by less than this fraction of the size.
_TOLERANCE = 1e-4


def read_vdb_frame(
    path: Path, box: Box | None = None, wanted: Wanted | None = None, smoke: bool = False
) -> StoredFrame:
    """Read the voxels of a frame in `box`, or in the file's own box.

    Args:
        path: the file.
        box: the voxels; None for those of the file.
        wanted: names that the user gives for grids.
        smoke: whether other frames of its sequence have a density, so that one without is a frame without smoke.

    Raises:
        InputError: the file cannot be used, its grids do not fit together, or it has no active voxel and no box.
    """
    file = read_vdb(path)
    found = _fitting(file, wanted)
    density, velocity, obstacle, main = found.density, found.velocity, found.obstacle, found.main
    notes: tuple[Note, ...] = ()
    if density is None and smoke and box is not None:
        notes = (Note(WITHOUT_SMOKE),)
        if main is None:
            return StoredFrame(density=_nothing(path, box), taken=found.taken, notes=notes)
    elif main is None:
        return StoredFrame(density=None, taken=found.taken, lacking=found.lacking)
    box = box or _box_of(path, file, found)
    if box is None:
        raise InputError(f"{path}: no active voxel in it, so the size of the grid is unknown")
    require_small(path, box, sum(part.components for part in (density, velocity, obstacle) if part is not None))
    x, y, z = (low * main.main.voxel_size + at for low, at in zip(map(int, box[0]), main.main.translation, strict=True))
    solid, words = (None, "") if obstacle is None or density is None else solid_voxels(obstacle, box)
    staggered = velocity is not None and on_faces(velocity, main.main)
    program = program_of(file, main.main)
    values = None if density is None else density.values_in(box)
    return StoredFrame(
        density=_nothing(path, box) if notes else values,
        velocity=None if velocity is None else velocity.values_in(box),
        obstacle=solid,
        staggered=staggered,
        # Blender stores velocities only where there is smoke; the zeros elsewhere are not data.
        known=velocity.active_in(box) if velocity is not None and staggered else None,
        up=program.up,
        up_because=program.up_because,
        velocity_units=program.velocity_units,
        voxel_size=main.main.voxel_size,
        corner=(x, y, z),
        taken=found.taken,
        layouts=(words,) if words else (),
        notes=notes,
        lacking=found.lacking,
    )


def read_vdb_obstacle(path: Path, density: Path, box: Box | None) -> StoredFrame:
    """Read the obstacle, in `box`, of a frame whose density is in another file; None if there is none.

    Raises:
        InputError: a file cannot be used, or the voxels of both differ in size or position.
    """
    found, whose = quantities_of(read_vdb(path), Wanted()), quantities_of(read_vdb(density), Wanted())
    obstacle = found.obstacle or found.density
    if obstacle is None or whose.main is None or box is None:
        return StoredFrame(density=None)
    _require_fit(path, whose.main.main, obstacle.main, f"in {density.name}")
    solid, words = solid_voxels(obstacle, box)
    return StoredFrame(density=None, obstacle=solid, layouts=(words,) if words else ())


def has_density(path: Path, wanted: Wanted) -> bool:
    """Whether a file has a grid that is its density.

    Raises:
        InputError: the file cannot be used.
    """
    return not quantities_of(read_vdb(path), wanted).lacking


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
        UP: ("string", placement.up),
        UNITS: ("string", CELLS_PER_FRAME),
        _LOWEST: ("vec3i", first),
        _HIGHEST: ("vec3i", last),
    }
    grids = [DenseGrid(name, array.astype(np.float32), first, size, (x, y, z)) for name, array in arrays.items()]
    write_vdb(path, grids, metadata)


def describe_vdb(path: Path) -> list[str]:
    """The contents of a file, one line per grid."""
    lines = []
    for grid in read_vdb(path).grids:
        words = [type_in_words(grid), str(grid.metadata.get("class", "unknown")), grid.codec]
        words.append(f"voxel size {grid.voxel_size:g}")
        if grid.kind is not None:
            box = grid.topology.active_box()
            words.append(f"{grid.topology.active_voxels} active voxels")
            if box is not None:
                words.append(f"from {tuple(box[0].tolist())} to {tuple(box[1].tolist())}")
            words += _range(grid)
        lines.append(f"  grid {grid.name!r}: {', '.join(words)}")
    return lines


def box_of_all(paths: Sequence[Path], wanted: Wanted | None = None) -> Box | None:
    """The smallest box that holds the boxes of several files, the frames of one sequence; None if none has one.

    Files that cannot be read are left out: reading their frames tells why.

    Raises:
        InputError: the files' voxels differ in size or position.
    """
    lowest, highest, first = [], [], None
    for path in paths:
        try:
            file = read_vdb(path)
            found = _fitting(file, wanted)
            box = _box_of(path, file, found)
        except InputError:
            continue
        if found.main is None:
            continue
        first = first or found.main.main
        _require_fit(path, first, found.main.main, f"in {first.path.name}")
        if box is not None:
            lowest.append(box[0])
            highest.append(box[1])
    return (np.min(lowest, axis=0), np.max(highest, axis=0)) if lowest else None


def _fitting(file: VdbFile, wanted: Wanted | None) -> Quantities:
    """The quantities of a frame, checked to have the same voxels."""
    found = quantities_of(file, wanted or Wanted())
    if found.main is None:
        return found
    main = found.main.main
    for quantity in (found.density, found.velocity, found.obstacle):
        if quantity is None or (quantity.split and on_faces(quantity, main)):
            continue
        for grid in quantity.grids:
            _require_fit(grid.path, main, grid, f"of grid {main.name!r}")
    return found


def _nothing(path: Path, box: Box) -> np.ndarray:
    """A density (Z, Y, X) without smoke."""
    require_small(path, box)
    return np.zeros((box[1] - box[0] + 1)[::-1], np.float32)


def _range(grid: Grid) -> list[str]:
    """The range of the active values of a grid, in words, if there are any; of vectors, of all components."""
    try:
        tree = grid.tree
    except InputError as error:
        # A grid that makes no part of the frame does not keep it from being read.
        return [f"cannot be read ({str(error).removeprefix(f'{grid.path}: ')})"]
    values = np.concatenate([tree.leaf_values[tree.leaf_active].ravel(), tree.tile_values[tree.tile_active].ravel()])
    return [f"{values.min():g} to {values.max():g}"] if values.size else []


def _require_fit(path: Path, one: Grid, other: Grid, whose: str) -> None:
    sizes = np.array([one.voxel_size, other.voxel_size])
    apart = np.abs(np.subtract(one.translation, other.translation)).max()
    if np.ptp(sizes) > _TOLERANCE * sizes[0] or apart > _TOLERANCE * sizes[0]:
        raise InputError(
            f"{path}: voxels of grid {other.name!r} have size {other.voxel_size:g} at {other.translation}, "
            f"expected {one.voxel_size:g} at {one.translation} like those {whose}; resample it"
        )


def _box_of(path: Path, file: VdbFile, found: Quantities) -> Box | None:
    """The box that a file declares, extended to the active voxels of its density; else the box of all active voxels."""
    told = _told_box(path, file, found)
    parts = (found.density, found.velocity) if told is None else (found.main,)
    boxes = [told, *(part.active_box() for part in parts if part is not None)]
    known = [box for box in boxes if box is not None]
    if not known:
        return None
    return np.min([low for low, _ in known], axis=0), np.max([high for _, high in known], axis=0)


def _told_box(path: Path, file: VdbFile, found: Quantities) -> Box | None:
    corners = [file.metadata.get(key) for key in (_LOWEST, _HIGHEST)]
    resolution = None if found.main is None else found.main.main.metadata.get(BLENDER)
    if not all(isinstance(corner, tuple) and len(corner) == 3 for corner in corners):
        if not isinstance(resolution, tuple) or len(resolution) != 3:
            return None
        corners = [(0, 0, 0), np.array(resolution, np.int64) - 1]
    low, high = (np.array(corner, np.int64) for corner in corners)
    if (high < low).any():
        raise InputError(f"{path}: damaged: says that it spans voxels {low.tolist()} to {high.tolist()}")
    return low, high
