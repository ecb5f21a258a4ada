"""Read and write one frame in each format: npz, Mitsuba's .vol, Mantaflow's .uni, OpenVDB's .vdb.

Only npz and .vdb files hold whole frames; .vol and .uni have companion files beside the density
(`tnst_mi.io.companions`). All are written with velocities at the cell centres in cells per frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Placement
from tnst_mi.io import companions
from tnst_mi.io.conventions import CELLS_PER_TIME, MANTAFLOW_TIME_STEP, StoredFrame
from tnst_mi.io.grids.npy import read_npy, read_npy_header
from tnst_mi.io.grids.npz import read_arrays, read_headers, write_arrays
from tnst_mi.io.grids.uni import (
    FLAGS,
    INTEGER,
    OBSTACLE_FLAG,
    REAL,
    VECTOR,
    UniHeader,
    read_uni,
    read_uni_header,
    write_uni,
)
from tnst_mi.io.grids.vdb.frames import box_of_all, describe_vdb, read_vdb_frame, write_vdb_frame
from tnst_mi.io.grids.vol import read_vol, read_vol_shape, write_vol
from tnst_mi.io.orientation import to_z_up

#: File extensions of the formats that can be read and written.
FORMATS = (".npz", ".vol", ".uni", ".vdb")

#: Those that can be read.
READABLE = (*FORMATS, ".npy")

#: Formats with one grid per file, companions beside it.
GRID_FORMATS = (".vol", ".uni")

#: Time units per frame in the authors' data.
AUTHORS_TIME_STEP = 0.5

# Our .uni files declare their conventions in the build information.
_OURS, _Y_UP = "tnst_mi: velocity at centres, cells per frame", ", y up"

_VECTORS = "holds vectors, expected a density"

_COMPANION_WORDS = (companions.VELOCITY, companions.OBSTACLE)

#: The arrays of one grid in an npz file: those of the paper's authors, of PhiFlow, and of numpy where none has a name.
_LONE_ARRAYS = ("x", "data", "arr_0")


def require_format(path: Path) -> str:
    """The extension of a path, in lower case.

    Raises:
        InputError: it is not one of FORMATS.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise InputError(f"{path}: unknown format {path.suffix!r}, expected one of {', '.join(FORMATS)}")
    return suffix


def require_readable(path: Path) -> str:
    """The extension of a path, in lower case.

    Raises:
        InputError: it is not one of READABLE.
    """
    suffix = path.suffix.lower()
    if suffix not in READABLE:
        raise InputError(f"{path}: unknown format {path.suffix!r}, expected one of {', '.join(READABLE)}")
    return suffix


def sequence_context(files: Sequence[Path]) -> Any:
    """What reading one frame of a sequence needs from all its files: the voxel box of .vdb files, else None.

    Raises:
        InputError: the files cannot be used.
    """
    return box_of_all([file for file in files if file.suffix.lower() == ".vdb"])


def read_stored(file: Path, velocities: Path | None = None, context: Any = None) -> StoredFrame:
    """Read a frame as it is stored.

    Args:
        file: the file of its density.
        velocities: in the layout of the paper's authors, the folder of the velocities, in npz files of the same names.
        context: the result of `sequence_context`; None for a single file.

    Raises:
        InputError: a file cannot be used.
    """
    match require_readable(file):
        case ".vol":
            return _read_vol(file)
        case ".uni":
            return _read_uni(file)
    frame = _read_alone(file, context, velocities)
    if frame.density is None:
        return frame
    velocity, obstacle = (companions.found_companion(file, words) for words in _COMPANION_WORDS)
    if frame.velocity is None and velocity is not None:
        frame = _with_velocity_of(frame, velocity, _read_alone(velocity, context))
    if frame.obstacle is None and obstacle is not None:
        frame = _with_obstacle_of(frame, obstacle, _read_alone(obstacle, context))
    return frame


def companions_of(file: Path) -> list[Path]:
    """The existing files beside that of a density from which its velocity and its obstacle may be read."""
    found = (companions.found_companion(file, words) for words in _COMPANION_WORDS)
    return [path for path in found if path is not None]


def files_around(path: Path) -> list[Path]:
    """The files that reading or writing a frame at a path may touch, whether they exist or not."""
    return [path, *(companions.possible_companions(path) if path.suffix.lower() in GRID_FORMATS else ())]


def write_frame(
    path: Path,
    density: np.ndarray | None,
    velocity: np.ndarray | None = None,
    obstacle: np.ndarray | None = None,
    placement: Placement | None = None,
) -> None:
    """Write the grids of a frame, or a velocity alone; the extension of the path selects the format.

    A frame in several files replaces all files of an earlier one; its density file exists only once it is complete.

    Args:
        path: the file.
        density: (D, H, W), or None.
        velocity: (D, H, W, 3), cells per frame, or None.
        obstacle: (D, H, W), or None.
        placement: where the grid came from; only .vdb files store it, and .uni files which axis was up.

    Raises:
        InputError: the format is unknown.
    """
    grids = {"density": density, "velocity": velocity, "obstacle": obstacle}
    grids = {name: array for name, array in grids.items() if array is not None}
    match require_format(path):
        case ".npz":
            write_arrays(path, grids)
        case ".vol":
            _write_grids(write_vol, path, grids)
        case ".uni":
            _write_grids(partial(_write_uni, placement=placement), path, grids)
        case _:
            write_vdb_frame(path, grids, placement)


def describe(file: Path) -> list[str]:
    """The arrays or grids in a file and its companions, one line each.

    Raises:
        InputError: a file cannot be used.
    """
    suffix = require_readable(file)
    if suffix in (".npz", ".npy"):
        headers = (read_headers(file) if suffix == ".npz" else {"arr_0": read_npy_header(file)}).items()
        return [f"  array {name!r}: {header.dtype}, shape {header.shape}" for name, header in headers]
    if suffix == ".vdb":
        return describe_vdb(file)
    found = (companions.found_companion(file, words) for words in (companions.VELOCITY, companions.OBSTACLE))
    lines = []
    for path in (file, *(path for path in found if path is not None)):
        if suffix == ".vol":
            lines.append(f"  {path.name}: shape {read_vol_shape(path)}")
        else:
            header = read_uni_header(path)
            shape = header.shape if header.components == 1 else (*header.shape, header.components)
            faces = ", on faces" if header.staggered else ""
            lines.append(f"  {path.name}: {header.dtype}, shape {shape} in its own axes{faces}")
    return lines


def _read_alone(file: Path, context: Any, velocities: Path | None = None) -> StoredFrame:
    """What a file that may hold whole frames holds itself."""
    match file.suffix.lower():
        case ".npz":
            return _read_npz(file, velocities)
        case ".npy":
            return _frame_of_arrays({"arr_0": read_npy(file)}, "holds vectors, expected a density")
        case _:
            return read_vdb_frame(file, context)


def _with_velocity_of(frame: StoredFrame, file: Path, other: StoredFrame) -> StoredFrame:
    """The frame with the velocity that a companion holds."""
    if other.velocity is None:
        raise InputError(f"{file}: holds no velocity, as which its name has it read; rename or remove it")
    return replace(
        frame,
        velocity=other.velocity,
        staggered=other.staggered,
        known=other.known,
        velocity_units=other.velocity_units,
        dt=other.dt,
    )


def _with_obstacle_of(frame: StoredFrame, file: Path, other: StoredFrame) -> StoredFrame:
    """The frame with the obstacle that a companion holds."""
    solid = other.density if other.obstacle is None else other.obstacle
    if solid is None:
        raise InputError(f"{file}: holds no obstacle, as which its name has it read; rename or remove it")
    return replace(frame, obstacle=solid)


def _read_npz(file: Path, velocities: Path | None) -> StoredFrame:
    arrays = read_arrays(file, ("density", "velocity", "obstacle", *_LONE_ARRAYS))
    found = ", ".join(read_headers(file)) or "none"
    frame = _frame_of_arrays(arrays, f"no array 'density' (or 'x'), the arrays found are: {found}")
    if velocities is None or not (velocities / file.name).exists():
        return frame
    faces = read_arrays(velocities / file.name, ("x",)).get("x")
    if faces is None or faces.ndim != 4 or faces.shape[-1] != 3:
        raise InputError(f"{velocities / file.name}: expected an array 'x' of shape (D, H, W, 3)")
    return replace(frame, velocity=faces, staggered=True, velocity_units=CELLS_PER_TIME, dt=AUTHORS_TIME_STEP)


def _frame_of_arrays(arrays: dict[str, np.ndarray], lacking: str) -> StoredFrame:
    """The frame of named arrays; one without a name that tells is a velocity if it holds vectors."""
    density, velocity = arrays.get("density"), arrays.get("velocity")
    lone = next((arrays[name] for name in _LONE_ARRAYS if name in arrays), None)
    if density is None and lone is not None:
        if lone.ndim == 4 and lone.shape[-1] == 3:
            velocity, lacking = lone if velocity is None else velocity, _VECTORS
        else:
            density = lone
    return StoredFrame(
        density=density, velocity=velocity, obstacle=arrays.get("obstacle"), scene_up="z", lacking=lacking
    )


def _read_vol(file: Path) -> StoredFrame:
    grid = read_vol(file)
    if grid.ndim == 4:
        return StoredFrame(density=None, velocity=grid, scene_up="z", lacking=_VECTORS)
    velocity, obstacle = (companions.found_companion(file, w) for w in (companions.VELOCITY, companions.OBSTACLE))
    return StoredFrame(
        density=grid,
        velocity=None if velocity is None else read_vol(velocity),
        obstacle=None if obstacle is None else read_vol(obstacle),
        scene_up="z",
    )


def _read_uni(file: Path) -> StoredFrame:
    header, grid = read_uni(file)
    up = "y" if header.build.startswith(_OURS + _Y_UP) else "z"
    if header.components == 3:
        return _with_velocity(StoredFrame(density=None, up=up, lacking=_VECTORS), header, grid)
    frame = StoredFrame(density=grid, up=up)
    velocity, obstacle = (companions.found_companion(file, w) for w in (companions.VELOCITY, companions.OBSTACLE))
    if velocity is not None:
        frame = _with_velocity(frame, *read_uni(velocity))
    if obstacle is not None:
        _, flags = read_uni(obstacle)
        frame = replace(frame, obstacle=(flags & OBSTACLE_FLAG) != 0 if flags.dtype.kind == "i" else flags > 0)
    return frame


def _with_velocity(frame: StoredFrame, header: UniHeader, velocity: np.ndarray) -> StoredFrame:
    """The frame with the velocity of a .uni file."""
    frame = replace(frame, velocity=velocity, staggered=header.staggered)
    if header.build.startswith(_OURS):
        return frame
    return replace(frame, velocity_units=CELLS_PER_TIME, dt=MANTAFLOW_TIME_STEP)


def _write_uni(path: Path, array: np.ndarray, placement: Placement | None) -> None:
    y_up = placement is not None and placement.up == "y"
    stored = array if y_up else to_z_up(array)
    kind = VECTOR if stored.ndim == 4 else REAL
    if stored.dtype == bool:
        stored, kind = stored.astype(np.int32) * OBSTACLE_FLAG, INTEGER | FLAGS
    write_uni(path, stored, kind, _OURS + (_Y_UP if y_up else ""))


def _write_grids(write: Callable[[Path, np.ndarray], None], path: Path, grids: dict[str, np.ndarray]) -> None:
    """Write one file per grid of a frame; a velocity alone takes the density's file name."""
    main = "density" if "density" in grids else "velocity"
    beside = {companions.companion(path, name): array for name, array in grids.items() if name != main}
    stale = [file for file in companions.possible_companions(path) if file not in beside and file.is_file()]
    if beside or stale:
        # Removed first: an interruption at any point must not leave a density beside the companions of another frame.
        path.unlink(missing_ok=True)
    for file in stale:
        file.unlink(missing_ok=True)
    for file, array in beside.items():
        write(file, array)
    write(path, grids[main])
