"""Write frames as OpenVDB files: on the voxels that they came from, with the names, metadata and precision of these."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.geometry.affine import Affine
from tnst_mi.geometry.boxes import Box, grown, image, union
from tnst_mi.geometry.placement import FileSource, GridSource, OwnVoxels, Placement
from tnst_mi.geometry.resampling import resampled
from tnst_mi.io.grids.vdb.adaptive_domain import TRANSLATION, VOXEL_SIZE
from tnst_mi.io.grids.vdb.file_format.reader import VdbFile
from tnst_mi.io.grids.vdb.file_format.writer import DenseGrid, write_vdb
from tnst_mi.io.grids.vdb.on_cells import SOLID
from tnst_mi.io.grids.vdb.programs import NAME, UNITS, UP
from tnst_mi.io.grids.vdb.quantities import Quantities
from tnst_mi.io.interpretation.conventions import CELLS_PER_FRAME
from tnst_mi.io.interpretation.orientation import to_z_up

#: Metadata that our files carry; other programs may write it too: the lowest and the highest voxel of the domain.
LOWEST, HIGHEST = "tnst_mi_box_min", "tnst_mi_box_max"

# Metadata of grids that are untrue of other values.
_OF_VALUES = ("file_bbox_min", "file_bbox_max", "file_mem_bytes", "file_voxel_count", "file_delayed_load")

# Metadata of files that are untrue of voxels elsewhere.
_OF_PLACE = (VOXEL_SIZE, TRANSLATION)

# What a result says by itself: velocities are written at centres, along the scene's axes, and level sets as density.
_OF_KIND = ("class", "is_local_space", "name", "file_compression", "is_saved_as_half_float")

# Voxel coordinates have 32 bits: beyond this one, the position is stored in the translation alone.
_FARTHEST = 1 << 30

# Less than this share of a voxel is rounding.
_ROUNDING = 1e-4


def source_of(file: VdbFile, found: Quantities) -> FileSource:
    """What results keep of a file and of its grids, those that are quantities by themselves."""
    grids = {}
    for role, quantity in (("density", found.density), ("velocity", found.velocity), ("obstacle", found.obstacle)):
        if quantity is not None and len(quantity.grids) == 1:
            grid = quantity.main
            kept = {key: value for key, value in grid.stored.items() if key not in _OF_VALUES + _OF_KIND}
            grids[role] = GridSource(grid.name, kept, grid.half)
    return FileSource({key: value for key, value in file.stored.items() if key not in _OF_PLACE}, grids)


def write_vdb_frame(path: Path, arrays: Mapping[str, np.ndarray], placement: Placement | None = None) -> None:
    """Write the grids of a frame where they came from; without a placement, the file is z up, as in Blender.

    Args:
        path: the file.
        arrays: y-up grids (D, H, W), or (D, H, W, 3) with velocities in cells per frame, by what they are: "density",
            "velocity", "obstacle".
        placement: where they lie, and what is kept of the file that they came from.
    """
    placement = placement or Placement()
    if placement.drift is not None and "density" in arrays and "velocity" in arrays:
        # The grid of a file rests. What is written without a density is no velocity of smoke.
        arrays = {**arrays, "velocity": arrays["velocity"] + np.array(placement.drift, np.float32)}
    if placement.up == "z":
        arrays = {role: to_z_up(array) for role, array in arrays.items()}
    own = placement.own or _plain(placement)
    cells = np.zeros(3, np.int64), np.array(next(iter(arrays.values())).shape[2::-1]) - 1
    box = image(cells, own.voxels_of)
    if own.box is not None:
        box = union([box, own.box]) or box
    # The file of a velocity alone is not a changed version of the source.
    source = placement.source if "density" in arrays else None
    first = tuple(box[0].tolist())
    metadata: dict[str, tuple[str, Any]] = {
        **({} if source is None else source.metadata),
        **({} if own.placed is None else _place(own.placed)),
        "creator": ("string", "tnst_mi"),
        UP: ("string", placement.up),
        UNITS: ("string", CELLS_PER_FRAME),
        LOWEST: ("vec3i", first),
        HIGHEST: ("vec3i", tuple(box[1].tolist())),
    }
    grids = []
    for role, array in arrays.items():
        kept = None if source is None else source.grids.get(role)
        if kept is not None:
            metadata[NAME.format(role)] = ("string", kept.name)
        grids.append(
            DenseGrid(
                role if kept is None else kept.name,
                _on_voxels(role, array, own, cells, box),
                first,
                transform=own.scene,
                metadata={} if kept is None else kept.metadata,
                half=kept is not None and kept.half,
                background=own.outside if role == "density" else 0.0,
            )
        )
    write_vdb(path, grids, metadata)


def _place(placed: Affine) -> dict[str, tuple[str, Any]]:
    """The metadata that tell where voxels are, other than their transform says."""
    return {VOXEL_SIZE: ("double", placed.edge), TRANSLATION: ("vec3d", tuple(placed.offset.tolist()))}


def _plain(placement: Placement) -> OwnVoxels:
    """Voxels that are the cells of a placement."""
    edge = placement.voxel_size
    first = np.rint(np.array(placement.corner) / edge)
    if np.abs(first).max() > _FARTHEST:
        first = np.zeros(3)
    rest = np.array(placement.corner) - first * edge
    rest[np.abs(rest) <= _ROUNDING * edge] = 0.0
    return OwnVoxels(Affine.scaling(edge, rest), Affine(np.eye(3), first))


def _on_voxels(role: str, array: np.ndarray, own: OwnVoxels, cells: Box, box: Box) -> np.ndarray:
    """The values of a grid of a frame at the voxels of a box, (Z, Y, X) or (Z, Y, X, 3) float32."""
    cells_of = own.voxels_of.inverse()
    if cells_of.whole:
        return resampled(array.astype(np.float32), cells, box, cells_of)
    if role == "density" and own.values is not None and own.box is not None:
        # Only what has changed is resampled: where nothing has, the file's own values stay as they were.
        change = array - resampled(own.values, own.box, cells, own.voxels_of)
        margins = [*zip((own.box[0] - box[0])[::-1], (box[1] - own.box[1])[::-1], strict=True)]
        before = np.pad(own.values.astype(np.float32), margins, constant_values=own.outside)
        changed = _interpolated(change, cells_of, cells, box)
        return np.where(changed == 0, before, np.maximum(before + changed, 0))
    moved = _interpolated(array.astype(np.float32), cells_of, cells, box)
    if role == "velocity":
        return moved * np.float32(abs(np.linalg.det(own.voxels_of.matrix)) ** (1 / 3))
    return (moved >= SOLID).astype(np.float32)


def _interpolated(array: np.ndarray, cells_of: Affine, cells: Box, box: Box) -> np.ndarray:
    """A frame's grid at voxels that do not coincide with its cells; 0 beyond it."""
    padded = np.pad(array, [*[(1, 1)] * 3, *[(0, 0)] * (array.ndim - 3)])
    return resampled(padded, grown(cells, 1), box, cells_of)
