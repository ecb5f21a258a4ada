"""The quantities of a file at the cells of a run: density, velocity at the centres, and solid cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.geometry.affine import Affine, between
from tnst_mi.geometry.boxes import Box, grown, intersection, words
from tnst_mi.geometry.placement import OwnVoxels
from tnst_mi.geometry.resampling import needed_box, resampled
from tnst_mi.io.grids.vdb.file_format.reader import Grid
from tnst_mi.io.grids.vdb.limits import is_out_of_proportion, require_small
from tnst_mi.io.grids.vdb.quantities import Quantity, on_faces, solid_voxels
from tnst_mi.io.interpretation.staggered import centred_velocity

#: A cell, or a voxel, is solid if at least this share of it is.
SOLID = 0.5

#: OpenVDB's metadata for vectors in coordinates of the voxels; without it they are in those of the scene.
_LOCAL = "is_local_space"


def density_on(density: Quantity, cells: Box, run: Affine, own: OwnVoxels) -> tuple[np.ndarray, OwnVoxels]:
    """The density at some cells; and with the file's own voxels, what results need of them.

    Raises:
        InputError: it takes too much memory, or its grids have different voxels.
    """
    voxels_of = between(run, density.main.affine)
    box = voxels_for(density, cells, voxels_of)
    values = density.values_in(box)
    own = replace(own, outside=float(density.main.tree.background))
    if not voxels_of.whole:
        own = replace(own, values=values, box=box)
    return resampled(values, box, cells, voxels_of), own


def solid_on(obstacle: Quantity, cells: Box, run: Affine) -> tuple[np.ndarray, str]:
    """Which cells are solid, (Z, Y, X) bool, and in words how that was stored.

    Raises:
        InputError: it takes too much memory, or its values do not say what is solid.
    """
    voxels_of = between(run, obstacle.main.affine)
    box = voxels_for(obstacle, cells, voxels_of)
    solid, words = solid_voxels(obstacle, box)
    return resampled(solid, box, cells, voxels_of) >= SOLID, words


def is_as_stored(velocity: Quantity, main: Grid, run: Affine) -> bool:
    """Whether a velocity on faces is on those of the run's cells, so that `StoredFrame` can average it itself."""
    faces = main if velocity.split else velocity.main
    voxels_of = between(run, faces.affine)
    along = voxels_of.whole and bool((voxels_of.matrix == np.eye(3)).all())
    return along and on_faces(velocity, main)


def stored_velocity(velocity: Quantity, main: Grid, cells: Box, run: Affine) -> tuple[np.ndarray, np.ndarray]:
    """The values on the lower faces of some cells, (Z, Y, X, 3), and which are known."""
    faces = main if velocity.split else velocity.main
    offset = between(run, faces.affine).offset.astype(np.int64)
    box = cells[0] + offset, cells[1] + offset
    return velocity.values_in(box), velocity.active_in(box)


def velocity_on(velocity: Quantity, cells: Box, run: Affine) -> np.ndarray:
    """A velocity at the centres of some cells, with components along the scene's axes, (Z, Y, X, 3).

    Where voxels are inactive the velocity is unknown: the others are averaged, and where there are none it is 0.
    Components on faces, and those that are stored in the voxels' coordinates, are turned with the voxels.

    Raises:
        InputError: it takes too much memory.
    """
    if velocity.split:
        parts = [Quantity((grid,), 1, velocity.role) for grid in velocity.grids]
        components = [_averaged(part, cells, between(run, part.main.affine), lambda v, _: v) for part in parts]
        components += [np.zeros_like(components[0])] * (3 - len(components))
        return np.stack(components, axis=-1)
    grid = velocity.main

    def centred(values: np.ndarray, known: np.ndarray) -> np.ndarray:
        if velocity.staggered:
            values = centred_velocity(values, known)
            _spread_to_centres(known)
        if velocity.staggered or grid.metadata.get(_LOCAL) is True:
            axes = grid.affine.axes()
            # Only their directions: the components are in units of the scene, whatever the edges.
            directions = grid.affine.matrix / grid.affine.edges if axes is None else axes
            values = values @ directions.T.astype(np.float32)
        return values

    return _averaged(velocity, cells, between(run, grid.affine), centred)


def known_on(velocity: Quantity, cells: Box, run: Affine) -> np.ndarray:
    """At which cells a velocity is known in all components, (Z, Y, X) bool: where voxels are active.

    Raises:
        InputError: it takes too much memory.
    """
    parts = [Quantity((grid,), 1, velocity.role) for grid in velocity.grids] if velocity.split else [velocity]
    known = []
    for part in parts:
        voxels_of = between(run, part.main.affine)
        box = voxels_for(part, cells, voxels_of)
        known.append(resampled(part.active_in(box), box, cells, voxels_of) > 0)
    return np.logical_and.reduce(known)


def _averaged(
    quantity: Quantity, cells: Box, voxels_of: Affine, centred: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> np.ndarray:
    """Values at some cells, interpolated between those of voxels that are known; 0 where there are none.

    `centred` makes values at centres of those that are stored, and updates which are known.
    """
    box = voxels_for(quantity, cells, voxels_of)
    if quantity.staggered:
        box = box[0], box[1] + 1  # for the upper faces
    known = quantity.active_in(box)
    values = centred(quantity.values_in(box).astype(np.float32, copy=False), known)
    if voxels_of.whole:
        return resampled(values, box, cells, voxels_of)
    known = known.reshape(*known.shape, *(1,) * (values.ndim - 3))
    weights = resampled(known, box, cells, voxels_of)
    return resampled(np.where(known, values, 0), box, cells, voxels_of) / np.where(weights > 0, weights, 1)


def _spread_to_centres(known: np.ndarray) -> None:
    """Mark the voxels too that have a known upper face."""
    lower = known.copy()
    for axis in range(3):
        np.moveaxis(known, axis, 0)[:-1] |= np.moveaxis(lower, axis, 0)[1:]


def voxels_for(quantity: Quantity, cells: Box, voxels_of: Affine) -> Box:
    """The voxels that decide the values at some cells, as far as there are active ones.

    Raises:
        InputError: they are too many, or out of proportion to the file.
    """
    box = needed_box(cells, voxels_of)
    if not voxels_of.whole:
        # Beyond the active voxels are inactive ones, which are alike: one layer of them stands for all.
        active = quantity.active_box() or (box[0], box[0])
        box = intersection(box, grown(active, 1)) or (box[0], box[0])
        if is_out_of_proportion(box, quantity.components, (stored := quantity.main.path.stat().st_size)):
            raise InputError(
                f"{quantity.main.path}: grid {quantity.name} spans {words(box)} voxels in a file of {stored} bytes, "
                "expected a number in proportion to the file; resample it to the voxels of the density"
            )
    require_small(quantity.main.path, box, quantity.components)
    return box
