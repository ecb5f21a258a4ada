"""Write frames as OpenVDB files: on the voxels that they came from, with the names, metadata and precision of these."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.geometry.affine import Affine
from tnst_mi.geometry.boxes import Box, image, union
from tnst_mi.geometry.other_grids import OtherGrid, OtherGrids
from tnst_mi.geometry.placement import FileSource, GridSource, KeptGrid, OwnVoxels, Placement
from tnst_mi.geometry.resampling import resampled
from tnst_mi.io.grids.vdb.adaptive_domain import TRANSLATION, VOXEL_SIZE
from tnst_mi.io.grids.vdb.file_format.reader import Grid, VdbFile
from tnst_mi.io.grids.vdb.file_format.writer import DenseGrid, write_vdb
from tnst_mi.io.grids.vdb.on_cells import SOLID
from tnst_mi.io.grids.vdb.on_voxels import interpolated, interpolated_change
from tnst_mi.io.grids.vdb.other_grids import OF_VALUES, can_move, found_again, grid_on_voxels, numbered
from tnst_mi.io.grids.vdb.programs import NAME, UNITS, UP
from tnst_mi.io.grids.vdb.quantities import Quantities, Quantity
from tnst_mi.io.interpretation.conventions import CELLS_PER_FRAME
from tnst_mi.io.interpretation.grid_names import is_colour
from tnst_mi.io.interpretation.stored_grids import Axes

#: Metadata that our files carry; other programs may write it too: the lowest and the highest voxel of the domain.
LOWEST, HIGHEST = "tnst_mi_box_min", "tnst_mi_box_max"

# What a result says by itself: velocities are written at centres, along the scene's axes, and level sets as density.
_OF_KIND = ("class", "is_local_space", "name", "file_compression", "is_saved_as_half_float")

# Metadata of files that are untrue of voxels elsewhere.
_OF_PLACE = (VOXEL_SIZE, TRANSLATION)

# Voxel coordinates have 32 bits: beyond this one, the position is stored in the translation alone.
_FARTHEST = 1 << 30

# Less than this share of a voxel is rounding.
_ROUNDING = 1e-4


def source_of(file: VdbFile, found: Quantities, cells: Box, run: Affine) -> FileSource:
    """What results keep of a file and of its grids.

    Args:
        file: the file.
        found: what its grids are.
        cells: the cells of the frame.
        run: from cells to the scene.
    """
    roles = {"density": found.density, "velocity": found.velocity, "obstacle": found.obstacle}
    grids = {}
    for role, quantity in roles.items():
        # Those that are quantities by themselves.
        if quantity is not None and len(quantity.grids) == 1:
            grid = quantity.main
            kept = {key: value for key, value in grid.stored.items() if key not in OF_VALUES + _OF_KIND}
            grids[role] = GridSource(grid.name, kept, grid.half)

    def again(indices: Iterable[int]) -> dict[str, KeptGrid]:
        kept = [index for index in indices if file.grids[index].readable]
        names = numbered([file.grids[index].name for index in kept])
        return {name: KeptGrid(file.path, index, cells, run) for name, index in zip(names, kept, strict=True)}

    def places(quantity: Quantity | None) -> list[int]:
        own = () if quantity is None else quantity.grids
        return [index for index, grid in enumerate(file.grids) if any(grid is one for one in own)]

    return FileSource(
        {key: value for key, value in file.stored.items() if key not in _OF_PLACE},
        grids,
        velocity=again(places(found.velocity)),
        obstacle=again(places(found.obstacle)),
        others=again(found.others),
    )


def write_vdb_frame(
    path: Path,
    arrays: Mapping[str, np.ndarray],
    placement: Placement | None = None,
    others: OtherGrids | None = None,
) -> None:
    """Write the grids of a frame where they came from; without a placement, the file is z up, as in Blender.

    Args:
        path: the file.
        arrays: y-up grids (D, H, W), or (D, H, W, 3) with velocities in cells per frame, by what they are: "density",
            "velocity", "obstacle".
        placement: where they lie, and what is kept of the file that they came from.
        others: y-up grids (D, H, W) or (D, H, W, 3) besides, by name. Those of the source's velocity are in its unit.
    """
    placement = placement or Placement()
    if placement.drift is not None and "density" in arrays and "velocity" in arrays:
        # The grid of a file rests. What is written without a density is no velocity of smoke; what `others` has of the
        # velocity is that of the file, at rest too.
        arrays = {**arrays, "velocity": arrays["velocity"] + np.array(placement.drift, np.float32)}
    axes = Axes(placement.up)
    arrays = {role: axes.turned_back(array) for role, array in arrays.items()}
    own = placement.own or _plain(placement)
    cells = np.zeros(3, np.int64), np.array(next(iter(arrays.values())).shape[2::-1]) - 1
    box = image(cells, own.voxels_of)
    if own.box is not None:
        box = union([box, own.box]) or box
    # The file of a velocity alone is not a changed version of the source.
    source = placement.source if "density" in arrays else None
    # What lies on other cells than those of the file is written as if there were none.
    again = source if placement.own is not None else None
    units = _units(again, others)
    first = tuple(box[0].tolist())
    metadata: dict[str, tuple[str, Any]] = {
        **({} if source is None else source.metadata),
        **({} if own.placed is None else _place(own.placed)),
        "creator": ("string", "tnst_mi"),
        UP: ("string", placement.up),
        UNITS: ("string", units),
        LOWEST: ("vec3i", first),
        HIGHEST: ("vec3i", tuple(box[1].tolist())),
    }
    for role, kept in ({} if source is None else source.grids).items():
        if role in arrays or kept.name in (others or ()):
            metadata[NAME.format(role)] = ("string", kept.name)

    def grids() -> Iterator[DenseGrid | Grid]:
        for role, array in arrays.items():
            if role == "obstacle" and again is not None and again.obstacle:
                # It stays where it is in the scene.
                for solid in again.obstacle.values():
                    yield _moved(found_again(solid), own)
                continue
            kept = None if source is None else source.grids.get(role)
            yield DenseGrid(
                role if kept is None else kept.name,
                _on_voxels(role, array, own, cells, box),
                first,
                transform=own.scene,
                metadata={} if kept is None else kept.metadata,
                half=kept is not None and kept.half,
                background=own.outside if role == "density" else 0.0,
            )
        if others is not None:
            for name in others:
                yield _other(name, others, again, axes, own)

    write_vdb(path, grids(), metadata)


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
    if role == "density" and own.values is not None:
        return interpolated_change(array, own, cells, box)
    moved = interpolated(array.astype(np.float32), cells_of, cells, box)
    if role == "velocity":
        return moved * np.float32(abs(np.linalg.det(own.voxels_of.matrix)) ** (1 / 3))
    return (moved >= SOLID).astype(np.float32)


def _other(name: str, others: OtherGrids, source: FileSource | None, axes: Axes, own: OwnVoxels) -> DenseGrid | Grid:
    """A grid beside the density: where its file has it, or else at the cells."""
    kept = None if source is None else {**source.others, **source.velocity}.get(name)
    if kept is not None:
        grid = found_again(kept)
        if can_move(grid):
            grid = grid_on_voxels(kept, axes.turned_back(others[name], not is_colour(name)))
        return _moved(grid, own)
    return _plain_grid(name, others.read(name), axes, own)


def _moved(grid: DenseGrid | Grid, own: OwnVoxels) -> DenseGrid | Grid:
    """A grid of the file where the frame's voxels are now."""
    return replace(grid, transform=grid.transform.moved(own.moved)) if isinstance(grid.transform, Affine) else grid


def _plain_grid(name: str, grid: OtherGrid, axes: Axes, own: OwnVoxels) -> DenseGrid:
    """A grid that no file has, on the voxels of a frame."""
    directed = not is_colour(name)
    values, outside = axes.turned_back(grid.values, directed), grid.outside
    if outside.shape:
        outside = axes.turned_back(outside.reshape(1, 1, 1, -1), directed).reshape(-1)
    half, values = values.dtype == np.float16, _writable(values)
    cells, cells_of = (np.zeros(3, np.int64), np.array(values.shape[2::-1]) - 1), own.voxels_of.inverse()
    box = image(cells, own.voxels_of)
    if cells_of.whole:
        values = resampled(values, cells, box, cells_of)
    else:
        values = interpolated(values.astype(np.float32) - outside, cells_of, cells, box) + outside
    x, y, z = box[0].tolist()
    return DenseGrid(name, _writable(values), (x, y, z), transform=own.scene, half=half, background=outside)


def _writable(values: np.ndarray) -> np.ndarray:
    """Values in a type of number that files have."""
    if values.dtype.kind != "f" and values.ndim == 3 and values.dtype != np.uint64:
        least, most = int(values.min(initial=0)), int(values.max(initial=0))
        if -(2**31) <= least and most < 2**31:
            return values.astype(np.int32)
    return values if values.dtype == np.float64 else values.astype(np.float32)


def _units(source: FileSource | None, others: OtherGrids | None) -> str:
    """The unit of the velocities in a result: that of the source, of which it has the velocity, or ours."""
    has_own = source is not None and bool(set(source.velocity) & set(others or ()))
    return source.velocity_units if source is not None and has_own else CELLS_PER_FRAME
