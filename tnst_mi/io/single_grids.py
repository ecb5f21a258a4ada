"""Frames in formats with one grid per file (.vol, .uni): velocity and obstacle are in companion files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError, naming
from tnst_mi.geometry.other_grids import OtherGrid
from tnst_mi.io.files import companions
from tnst_mi.io.grids.uni import UniHeader, read_uni
from tnst_mi.io.grids.vol import read_vol
from tnst_mi.io.interpretation.conventions import CELLS_PER_TIME, StoredFrame, Taken
from tnst_mi.io.interpretation.grid_names import is_colour
from tnst_mi.io.interpretation.layouts import solid_cells
from tnst_mi.io.interpretation.roles import NONE, Wanted
from tnst_mi.io.interpretation.stored_grids import StoredGrid

#: Our .uni files declare their conventions in the build information.
OURS, Y_UP = "tnst_mi: velocity at centres, cells per frame", ", y up"

_VECTORS = "holds vectors, expected a density"


def read_vol_frame(file: Path, wanted: Wanted) -> StoredFrame:
    """Read a frame of Mitsuba's .vol files.

    Raises:
        InputError: a file cannot be used, or one that the user names is not there.
    """
    grid = read_vol(file)
    if grid.ndim == 4:
        return StoredFrame(density=None, velocity=grid, scene_up="z", lacking=_VECTORS)
    velocity, obstacle, taken = _companions(file, wanted)
    solid, layouts = (None, ()) if obstacle is None else _solid(obstacle, read_vol(obstacle), flags=False)
    return StoredFrame(
        density=grid,
        velocity=_vectors(velocity, [read_vol(path) for path in velocity]) if velocity else None,
        obstacle=solid,
        scene_up="z",
        grids=_others(file, read_vol, taken),
        taken=taken,
        layouts=layouts,
    )


def read_uni_frame(file: Path, wanted: Wanted) -> StoredFrame:
    """Read a frame of Mantaflow's .uni files; a grid of one layer along Z is a plane in X and Y, seen face-on.

    Raises:
        InputError: a file cannot be used, or one that the user names is not there.
    """
    header, grid = read_uni(file)
    ours = header.build.startswith(OURS)
    plane = header.shape[0] == 1 and not ours
    up = "y" if plane or header.build.startswith(OURS + Y_UP) else "z"
    because = "a plane, seen face-on" if plane else ""
    if header.components == 3:
        return _with_velocity(StoredFrame(density=None, up=up, lacking=_VECTORS), header, grid)
    velocity, obstacle, taken = _companions(file, wanted)
    others = _others(file, lambda path: read_uni(path)[1], taken)
    frame = StoredFrame(density=grid, up=up, up_because=because, grids=others, taken=taken)
    if velocity:
        headers, grids = zip(*(read_uni(path) for path in velocity), strict=True)
        frame = _with_velocity(frame, headers[0], _vectors(velocity, grids))
    if obstacle is not None:
        solid, _ = _solid(obstacle, read_uni(obstacle)[1], flags=True)
        frame = replace(frame, obstacle=solid)
    return frame


def _companions(file: Path, wanted: Wanted) -> tuple[tuple[Path, ...], Path | None, Taken]:
    """The files of velocity and obstacle beside that of a density, and the words by which they are found."""
    if wanted.density is not None and wanted.alone:
        raise InputError(
            f"{file}: no grid {wanted.density!r}, since a {file.suffix} file holds one, without a name; give the file "
            "that has it"
        )
    if wanted.density is not None:
        raise InputError(
            f"{file}: --density {wanted.density!r}: a {file.suffix} file holds one grid; give the density's as INPUT"
        )
    velocity: tuple[Path, ...] = ()
    obstacle = None
    if wanted.velocity != NONE:
        words = companions.VELOCITY if wanted.velocity is None else (wanted.velocity,)
        velocity = companions.found_velocity(file, words)
    if wanted.obstacle != NONE:
        words = companions.OBSTACLE if wanted.obstacle is None else (wanted.obstacle,)
        obstacle = companions.found_companion(file, words)
    for role, name, found in (("velocity", wanted.velocity, velocity), ("obstacle", wanted.obstacle, obstacle)):
        if not found and name not in (None, NONE):
            raise InputError(f"{file}: --{role} {name!r}: no file {companions.companion(file, name).name} beside it")
    named = companions.all_numberless(velocity) or None
    solid = None if obstacle is None else companions.numberless(obstacle)
    taken = (*velocity, obstacle)
    others = tuple(name for name, path in companions.other_grids_of(file).items() if path not in taken)
    return velocity, obstacle, Taken(companions.numberless(file), named, solid, others)


def _vectors(files: Sequence[Path], grids: Sequence[np.ndarray]) -> np.ndarray:
    """A velocity (D, H, W, 3), of one grid or of the three grids (D, H, W) of its components.

    Raises:
        InputError: the components are vectors themselves, or differ in shape.
    """
    if len(grids) == 1:
        return grids[0]
    for file, grid in zip(files, grids, strict=True):
        if grid.ndim != 3 or grid.shape != grids[0].shape:
            raise InputError(
                f"{file}: has shape {grid.shape}, expected a component of the velocity, of the shape of the others "
                f"({grids[0].shape}); --velocity none goes without it"
            )
    return np.stack(grids, axis=-1)


def _others(file: Path, read: Callable[[Path], np.ndarray], taken: Taken) -> dict[str, StoredGrid]:
    """The grids in files beside that of a density, by name."""
    files = companions.other_grids_of(file)

    def grid(path: Path) -> OtherGrid:
        return OtherGrid(read(path))

    return {name: StoredGrid(files[name], partial(grid, files[name]), not is_colour(name)) for name in taken.others}


def _solid(file: Path, values: np.ndarray, flags: bool) -> tuple[np.ndarray, tuple[str, ...]]:
    with naming(file):
        solid, words = solid_cells(values, flags)
    return solid, (words,) if words else ()


def _with_velocity(frame: StoredFrame, header: UniHeader, velocity: np.ndarray) -> StoredFrame:
    """The frame with the velocity of a .uni file."""
    frame = replace(frame, velocity=velocity, staggered=header.staggered)
    return frame if header.build.startswith(OURS) else replace(frame, velocity_units=CELLS_PER_TIME)
