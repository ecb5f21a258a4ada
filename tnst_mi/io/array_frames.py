"""Frames in files of arrays (npz, npy): which arrays make up a frame, and in which layouts they are stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError, naming
from tnst_mi.frame import Note
from tnst_mi.geometry.other_grids import ROLES, OtherGrid
from tnst_mi.io.grids.contents import Contents
from tnst_mi.io.grids.npy import ArrayHeader, read_npy, read_npy_header
from tnst_mi.io.grids.npz import read_arrays, read_headers
from tnst_mi.io.interpretation.conventions import CELLS_PER_TIME, WITHOUT_SMOKE, StoredFrame, Taken
from tnst_mi.io.interpretation.grid_names import FLAGS, component, is_colour, listed, plain_name
from tnst_mi.io.interpretation.layouts import (
    fits,
    is_vector_shape,
    other_grid,
    picture_scale,
    scalar_grid,
    scalar_shape,
    solid_cells,
    velocity_grid,
    velocity_of_components,
)
from tnst_mi.io.interpretation.roles import Entry, Roles, Wanted, chosen_roles
from tnst_mi.io.interpretation.stored_grids import StoredGrid
from tnst_mi.machine.terminal import quoted

#: File extensions of these formats.
ARRAY_FORMATS = (".npz", ".npy")

#: Time units per frame in the authors' data.
AUTHORS_TIME_STEP = 0.5

#: The name of the array in an npy file, as numpy calls the first one without a name in an npz file.
_UNNAMED = "arr_0"


def read_array_frame(path: Path, wanted: Wanted, cells: tuple[int, ...] | None = None) -> StoredFrame:
    """Read a frame from an npz or npy file.

    Args:
        path: the file.
        wanted: names that the user gives.
        cells: (D, H, W) of the other frames of its sequence, which a file without a density takes as one without smoke;
            None for a file by itself.

    Raises:
        InputError: the file cannot be used, or its arrays are in a layout whose meaning is not clear.
    """
    headers = _headers(path)
    names = list(headers)
    roles = _roles(path, headers, wanted)
    arrays = _arrays(path, [names[index] for index in (*roles.density, *roles.velocity, *roles.obstacle)])
    with naming(path):
        if roles.density:
            frame = _frame(arrays[names[roles.density[0]]], arrays, names, roles)
            return _with_others(frame, path, headers, roles)
        if cells is not None:
            frame = _with_others(_frame(np.zeros(cells, np.float32), arrays, names, roles), path, headers, roles)
            return replace(frame, notes=(*frame.notes, Note(WITHOUT_SMOKE)))
    # By itself, a velocity such as runs write is described but makes no frame.
    name = names[roles.velocity[0]] if len(roles.velocity) == 1 else None
    return StoredFrame(
        density=None,
        velocity=None if name is None else arrays[name],
        scene_up="z",
        taken=Taken(None, name, None, left=tuple(other for other in names if other != name)),
        lacking=roles.lacking,
    )


def read_authors_frame(path: Path, velocities: Path, wanted: Wanted) -> StoredFrame:
    """Read a frame of the paper's authors, whose velocity, on faces, is in a file of the same name in another folder.

    Raises:
        InputError: a file cannot be used.
    """
    frame = read_array_frame(path, wanted)
    file = velocities / path.name
    if not file.exists():
        return frame
    faces = read_arrays(file, ("x",)).get("x")
    if faces is None or faces.ndim != 4 or faces.shape[-1] != 3:
        raise InputError(f"{file}: expected an array 'x' of shape (D, H, W, 3)")
    taken = replace(frame.taken, velocity=f"{velocities.name}/")
    return replace(
        frame, velocity=faces, staggered=True, velocity_units=CELLS_PER_TIME, dt=AUTHORS_TIME_STEP, taken=taken
    )


def velocity_beside(paths: Sequence[Path], cells: tuple[int, ...]) -> StoredFrame:
    """Read the velocity, if there is one, of a frame whose density, of shape (D, H, W), is in another file of arrays.

    Args:
        paths: the file, or three files with a component each.
        cells: (D, H, W).

    Raises:
        InputError: a file cannot be used, or its velocity does not fit the density.
    """
    if len(paths) == 1:
        arrays = _vector_arrays(paths[0])
    else:
        arrays = {path.name: _component(path, axis) for axis, path in enumerate(paths)}
    if not arrays:
        return StoredFrame(density=None)
    with naming(paths[0]):
        velocity, words = _velocity(arrays, list(arrays), cells)
    return StoredFrame(
        density=None,
        velocity=velocity,
        staggered=velocity.shape[:3] != cells,
        layouts=(words,) if words else (),
    )


def _vector_arrays(path: Path) -> dict[str, np.ndarray]:
    """The array of the velocity in a file of its own, or those of its components; none if there is none."""
    headers = _headers(path)
    names = list(headers)
    roles = _roles(path, headers, Wanted())
    chosen = roles.velocity or (tuple(range(len(names))) if len(names) == 1 else ())
    arrays = _arrays(path, [names[index] for index in chosen])
    return {names[index]: arrays[names[index]] for index in chosen}


def _component(path: Path, axis: int) -> np.ndarray:
    """The array of a velocity's component in a file of its own: the only one, or the one of that name."""
    names = list(_headers(path))
    named = [name for name in names if (found := component(name)) is not None and found[1] == axis]
    chosen = names if len(names) == 1 else named
    if len(chosen) != 1:
        shown = listed(names, in_quotes=False)
        raise InputError(f"{path}: expected one array, a component of the velocity, found {shown}; --velocity none")
    return _arrays(path, chosen)[chosen[0]]


def obstacle_beside(path: Path, cells: tuple[int, ...]) -> StoredFrame:
    """Read the obstacle, if there is one, of a frame whose density, of shape (D, H, W), is in another file of arrays.

    Raises:
        InputError: the file cannot be used, or its obstacle does not fit the density.
    """
    headers = _headers(path)
    names = list(headers)
    roles = _roles(path, headers, Wanted())
    chosen = roles.obstacle or roles.density
    if not chosen:
        return StoredFrame(density=None)
    name = names[chosen[0]]
    arrays = _arrays(path, [name])
    with naming(path):
        solid, words = _obstacle(arrays[name], name, cells)
    return StoredFrame(density=None, obstacle=solid, layouts=tuple(text for text in words if text))


def shape_of_density(path: Path, wanted: Wanted) -> tuple[int, ...] | None:
    """The shape (D, H, W) of the density in a file of arrays; None if it has none.

    Raises:
        InputError: the file cannot be used.
    """
    headers = _headers(path)
    roles = _roles(path, headers, wanted)
    if roles.lacking:
        return None
    shape = scalar_shape(list(headers.values())[roles.density[0]].shape)
    return shape if shape is None or len(shape) == 3 else (1, *shape)


def describe_arrays(path: Path) -> list[Contents]:
    """The arrays in a file: name, type, shape and range.

    Raises:
        InputError: the file cannot be used.
    """
    return [
        Contents(f"array {quoted(name)}: {header.dtype}", numbers=f"shape {header.shape}{_range(path, name, header)}")
        for name, header in _headers(path).items()
    ]


def _headers(path: Path) -> dict[str, ArrayHeader]:
    return {_UNNAMED: read_npy_header(path)} if path.suffix.lower() == ".npy" else read_headers(path)


def _arrays(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    if path.suffix.lower() == ".npy":
        return {_UNNAMED: read_npy(path)} if names else {}
    return read_arrays(path, names)


def _range(path: Path, name: str, header: ArrayHeader) -> str:
    if header.dtype.hasobject:
        return ", pickled objects, which are never read"
    if header.dtype.kind not in "fiub":
        return ""
    try:
        values = _arrays(path, [name])[name]
    except InputError as error:
        # An array that makes no part of the frame does not keep it from being read.
        return f", cannot be read ({str(error).removeprefix(f'{path}: ')})"
    numbers = values[np.isfinite(values)]
    span = f", {float(numbers.min()):g} to {float(numbers.max()):g}" if numbers.size else ""
    bad = values.size - numbers.size
    return span + (f", {bad} NaN or infinite" if bad else "")


def _roles(path: Path, headers: Mapping[str, ArrayHeader], wanted: Wanted) -> Roles:
    with naming(path):
        roles = chosen_roles(_entries(headers, plane=False), wanted, "array")
        # Vectors in a plane have the shapes of scalars in a volume: only beside a plane are they taken for vectors.
        if roles.density and _is_plane(list(headers.values())[roles.density[0]].shape):
            roles = chosen_roles(_entries(headers, plane=True), wanted, "array")
    return roles


def _entries(headers: Mapping[str, ArrayHeader], plane: bool) -> list[Entry]:
    entries = []
    for name, header in headers.items():
        numeric = header.dtype.kind in "fiub"
        kind = "pickled objects, which are never unpickled" if header.dtype.hasobject else str(header.dtype)
        vector = is_vector_shape(header.shape, plane)
        # What is called a density is one, whatever its shape: reading it tells what is wrong with that.
        scalar = scalar_shape(header.shape) is not None or plain_name(name) in ("density", "obstacle")
        scalar = scalar or (name == "x" and not vector)
        entries.append(Entry(name, numeric and scalar, numeric and vector, kind, plane))
    return entries


def _is_plane(shape: tuple[int, ...]) -> bool:
    """Whether a density of this shape is a plane."""
    cells = scalar_shape(shape)
    return cells is not None and (len(cells) == 2 or cells[0] == 1)


def _frame(density: np.ndarray, arrays: Mapping[str, np.ndarray], names: Sequence[str], roles: Roles) -> StoredFrame:
    """The frame of the chosen arrays; raises InputError if one is in no known layout."""
    grid, words = scalar_grid(density, "density")
    layouts = [words]
    velocity, obstacle, staggered = None, None, False
    parts = [names[index] for index in roles.velocity]
    if parts:
        velocity, words = _velocity(arrays, parts, grid.shape)
        staggered = velocity.shape[:3] != grid.shape
        layouts.append(words)
    solid = names[roles.obstacle[0]] if roles.obstacle else None
    if solid is not None:
        obstacle, several = _obstacle(arrays[solid], solid, grid.shape)
        layouts += several
    return StoredFrame(
        density=grid,
        velocity=velocity,
        obstacle=obstacle,
        staggered=staggered,
        scene_up="z",
        scale=picture_scale(density.dtype) or 1.0,
        taken=Taken(
            names[roles.density[0]] if roles.density else None,
            listed(parts, in_quotes=False) if parts else None,
            solid,
            left=tuple(names[index] for index in roles.left),
            like_velocity=tuple(names[index] for index in roles.like_velocity),
        ),
        layouts=tuple(words for words in layouts if words),
    )


def _with_others(frame: StoredFrame, path: Path, headers: Mapping[str, ArrayHeader], roles: Roles) -> StoredFrame:
    """A frame with the other arrays of its file, as far as they hold a number or a vector for each cell."""
    names = list(headers)
    shape = () if frame.density is None else frame.density.shape
    others = [
        name
        for name in (names[index] for index in roles.left)
        if name not in ROLES and headers[name].dtype.kind in "fiub" and fits(headers[name].shape, shape)
    ]
    grids = {name: StoredGrid(path, partial(_other, path, name, shape), not is_colour(name)) for name in others}
    left = tuple(name for name in frame.taken.left if name not in others)
    return replace(frame, grids=grids, taken=replace(frame.taken, others=tuple(others), left=left))


def _other(path: Path, name: str, cells: tuple[int, ...]) -> OtherGrid:
    """An array that is none of the parts of a frame."""
    array = _arrays(path, [name]).get(name)
    if array is None or not fits(array.shape, cells):
        raise InputError(f"{path}: array {name!r} has changed since it was found; read the frames again")
    return OtherGrid(other_grid(array, cells))


def _velocity(arrays: Mapping[str, np.ndarray], names: Sequence[str], cells: tuple[int, ...]) -> tuple[np.ndarray, str]:
    if len(names) == 1:
        return velocity_grid(arrays[names[0]], cells)
    return velocity_of_components([arrays[name] for name in names], names, cells)


def _obstacle(array: np.ndarray, name: str, cells: tuple[int, ...]) -> tuple[np.ndarray, list[str]]:
    values, layout = scalar_grid(array, "obstacle")
    if values.shape != cells:
        raise InputError(
            f"obstacle has shape {array.shape}, expected {cells} to fit the density; --obstacle none goes without it"
        )
    solid, words = solid_cells(values, plain_name(name) == FLAGS)
    return solid, [layout, words]
