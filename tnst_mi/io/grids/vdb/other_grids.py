"""The grids of a file beside its density, at the cells of a frame and back on their own voxels.

Vectors are read by components, each of which is a scalar grid: those on faces have voxels half a voxel lower along the
component's axis than the grid's. Results are made as those of the density are: value by value where cells and voxels
coincide, else the file's own values plus the resampled change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.geometry.affine import Affine, between
from tnst_mi.geometry.boxes import Box, extents, image, union
from tnst_mi.geometry.other_grids import ROLES, OtherGrid
from tnst_mi.geometry.placement import FileSource, KeptGrid, OwnVoxels, Placement
from tnst_mi.geometry.resampling import resampled
from tnst_mi.io.grids.vdb.adaptive_domain import placed
from tnst_mi.io.grids.vdb.file_format.reader import Grid, VdbFile, read_vdb
from tnst_mi.io.grids.vdb.file_format.writer import DenseGrid
from tnst_mi.io.grids.vdb.level_set import is_level_set
from tnst_mi.io.grids.vdb.limits import require_small
from tnst_mi.io.grids.vdb.on_cells import voxels_for
from tnst_mi.io.grids.vdb.on_voxels import interpolated_change
from tnst_mi.io.grids.vdb.quantities import Quantity
from tnst_mi.io.interpretation.grid_names import is_colour
from tnst_mi.io.interpretation.stored_grids import Axes, StoredGrid

#: Metadata of grids that are untrue of other values.
OF_VALUES = ("file_bbox_min", "file_bbox_max", "file_mem_bytes", "file_voxel_count", "file_delayed_load")

# What a grid that is written says by itself.
_OF_KIND = ("class", "name", "file_compression", "is_saved_as_half_float")


@dataclass(frozen=True, eq=False)
class _Component:
    """A component of a grid: its values on its own voxels, and the map from the frame's cells to them."""

    number: int
    values: np.ndarray
    box: Box
    voxels_of: Affine
    outside: float


def can_move(grid: Grid) -> bool:
    """Whether a grid can be carried with the smoke: the distances from a surface stay where this is."""
    return grid.readable and not is_level_set(grid)


def numbered(names: Sequence[str]) -> list[str]:
    """Names of grids, with numbers to tell apart equal ones, and those that mean the parts of a frame.

    Example:
        >>> from tnst_mi.io.grids.vdb.other_grids import numbered
        >>> numbered(["heat", "heat", "density"])
        ['heat', 'heat[1]', 'density[0]']
    """
    counts: dict[str, int] = {}
    result = []
    for name in names:
        number = counts[name] = counts.get(name, -1) + 1
        result.append(f"{name}[{number}]" if number or name in ROLES else name)
    return result


def other_grids(file: VdbFile, source: FileSource) -> dict[str, StoredGrid]:
    """The grids of a file besides those of a frame, by name."""
    return {
        name: StoredGrid(file.path, partial(grid_on_cells, kept), not is_colour(name))
        for name, kept in source.others.items()
    }


def found_again(kept: KeptGrid) -> Grid:
    """The grid of a file.

    Raises:
        InputError: the file has changed, or cannot be read any more.
    """
    grids = placed(read_vdb(kept.path)).grids
    if kept.index >= len(grids):
        raise InputError(f"{kept.path}: has changed since it was read; read the frames again")
    return grids[kept.index]


def stored_velocity(placement: Placement | None) -> dict[str, Callable[[], OtherGrid]] | None:
    """What reads the grids of a frame's velocity as its file has them, in the file's unit but in our axes, by name.

    None if the frame is on no voxels of a file; nothing if its velocity is in no grid of this file.
    """
    if placement is None or placement.own is None or placement.source is None:
        return None
    axes = Axes(placement.up)
    return {
        name: StoredGrid(kept.path, partial(grid_on_cells, kept)).reader(axes)
        for name, kept in placement.source.velocity.items()
    }


def grid_on_cells(kept: KeptGrid) -> OtherGrid:
    """A grid at the cells of its frame, (Z, Y, X) or (Z, Y, X, 3) in the axes of the file.

    Raises:
        InputError: it cannot be read, or takes too much memory.
    """
    grid = found_again(kept)
    values = [resampled(part.values, part.box, kept.cells, part.voxels_of) for part in _components(grid, kept)]
    outside = np.asarray(grid.tree.background)
    return OtherGrid(values[0] if len(values) == 1 else np.stack(values, axis=-1), outside, is_level_set(grid))


def grid_on_voxels(kept: KeptGrid, array: np.ndarray) -> DenseGrid:
    """A grid on its own voxels, with the values that its frame has now.

    Args:
        kept: the grid.
        array: these values, as `grid_on_cells` gives them.

    Raises:
        InputError: the file has changed, or the grid takes too much memory.
    """
    grid = found_again(kept)
    by_component = array[..., None] if array.ndim == 3 else array
    parts = [_on_voxels(part, by_component[..., part.number], kept.cells, grid) for part in _components(grid, kept)]
    boxes = [box for box, _ in parts]
    whole = union([*boxes, grid.topology.active_box()]) or boxes[0]
    require_small(grid.path, whole, by_component.shape[-1], "leave the grid out with --carry NAMES")
    values = grid.tree.values_in(whole)
    for component, (box, new) in enumerate(parts):
        inside = tuple(
            slice(low, low + extent)
            for low, extent in zip((box[0] - whole[0])[::-1].tolist(), extents(box)[::-1].tolist(), strict=True)
        )
        region = (values if values.ndim == 3 else values[..., component])[inside]
        # What has not changed keeps the precision of the file.
        np.copyto(region, _typed(new, region.dtype), where=new != region.astype(new.dtype), casting="unsafe")
    x, y, z = whole[0].tolist()
    return DenseGrid(
        grid.name,
        values,
        (x, y, z),
        transform=grid.stored_affine,
        metadata={key: value for key, value in grid.stored.items() if key not in OF_VALUES + _OF_KIND},
        half=grid.half,
        background=np.asarray(grid.tree.background),
        grid_class=str(grid.metadata.get("class", "")),
    )


def _components(grid: Grid, kept: KeptGrid) -> Iterator[_Component]:
    """The components of a grid, those that decide the values at the cells of the frame."""
    count = 1 if grid.kind is None else grid.kind.components
    quantity = Quantity((grid,), count, "other")
    for number in range(count):
        voxels = grid.affine
        if grid.staggered and count == 3:
            voxels = Affine(voxels.matrix, voxels.offset - 0.5 * voxels.matrix[:, number])
        voxels_of = between(kept.run, voxels)
        box = voxels_for(quantity, kept.cells, voxels_of)
        values, outside = grid.tree.values_in(box), grid.tree.background
        if count == 3:
            values, outside = np.ascontiguousarray(values[..., number]), outside[number]
        yield _Component(number, values, box, voxels_of, float(outside))


def _on_voxels(part: _Component, array: np.ndarray, cells: Box, grid: Grid) -> tuple[Box, np.ndarray]:
    """A box of a component's voxels, and its values there, in which what the frame has now is at its cells."""
    counted = Affine(part.voxels_of.matrix, part.voxels_of(cells[0]))
    from_first = np.zeros(3, np.int64), extents(cells) - 1
    reached = image(from_first, counted)
    cells_of = counted.inverse()
    if cells_of.whole:
        return reached, resampled(array, from_first, reached, cells_of)
    box = union([reached, part.box]) or reached
    require_small(grid.path, box, 1, "leave the grid out with --carry NAMES")
    own = OwnVoxels(grid.stored_affine, counted, None, part.values, part.box, part.outside)
    floor = bool(part.values.min(initial=0) >= 0 and part.outside >= 0)
    return box, interpolated_change(array, own, from_first, box, floor)


def _typed(values: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Values for a grid of a type, rounded for whole numbers."""
    return values if dtype.kind == "f" or values.dtype.kind != "f" else np.rint(values)
