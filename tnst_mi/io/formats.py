"""Read and write one frame in each format: npz, Mitsuba's .vol, Mantaflow's .uni, OpenVDB's .vdb.

Only npz and .vdb files hold whole frames; .vol and .uni have companion files beside the density
(`tnst_mi.io.files.companions`). All are written with velocities at the cell centres in cells per frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Placement
from tnst_mi.geometry.other_grids import ROLES, OtherGrids
from tnst_mi.io.array_frames import ARRAY_FORMATS, describe_arrays, read_array_frame, read_authors_frame
from tnst_mi.io.beside import with_arrays_beside, with_grids_beside
from tnst_mi.io.context import SequenceContext
from tnst_mi.io.files import companions
from tnst_mi.io.grids.contents import Contents
from tnst_mi.io.grids.npz import write_arrays
from tnst_mi.io.grids.uni import FLAGS, INTEGER, OBSTACLE_FLAG, REAL, VECTOR, read_uni, write_uni
from tnst_mi.io.grids.vdb.frames import describe_vdb, read_vdb_frame
from tnst_mi.io.grids.vdb.results import write_vdb_frame
from tnst_mi.io.grids.vol import read_vol, write_vol
from tnst_mi.io.interpretation.conventions import StoredFrame
from tnst_mi.io.interpretation.grid_names import is_colour
from tnst_mi.io.interpretation.roles import Wanted
from tnst_mi.io.interpretation.stored_grids import Axes
from tnst_mi.io.single_grids import OURS, Y_UP, read_uni_frame, read_vol_frame
from tnst_mi.machine.gate import gate

#: File extensions of the formats that can be read and written.
FORMATS = (".npz", ".vol", ".uni", ".vdb")

#: Those that can be read.
READABLE = (*FORMATS, ".npy")

#: Formats with one grid per file, companions beside it.
GRID_FORMATS = (".vol", ".uni")


def require_format(path: Path, known: Sequence[str] = FORMATS) -> str:
    """The extension of a path, in lower case.

    Raises:
        InputError: it is not one of those known.
    """
    suffix = path.suffix.lower()
    if suffix not in known:
        raise InputError(f"{path}: unknown format {path.suffix!r}, expected one of {', '.join(known)}")
    return suffix


def read_stored(
    file: Path,
    velocities: Path | None = None,
    context: SequenceContext | None = None,
    wanted: Wanted | None = None,
    fog: bool = False,
) -> StoredFrame:
    """Read a frame as it is stored.

    Args:
        file: the file of its density.
        velocities: in the layout of the paper's authors, the folder of the velocities, in npz files of the same names.
        context: what the other files of its sequence say; None for a single file.
        wanted: names that the user gives for grids.
        fog: whether the inside of a level set is its density.

    Raises:
        InputError: a file cannot be used.
    """
    wanted, suffix = wanted or Wanted(), require_format(file, READABLE)
    with gate(file, f"a {suffix} file"):
        return _read(file, suffix, velocities, context, wanted, fog)


def _read(
    file: Path,
    suffix: str,
    velocities: Path | None,
    context: SequenceContext | None,
    wanted: Wanted,
    fog: bool,
) -> StoredFrame:
    match suffix:
        case ".vol":
            return read_vol_frame(file, wanted)
        case ".uni":
            return read_uni_frame(file, wanted)
        case ".npz" if velocities is not None:
            return read_authors_frame(file, velocities, wanted)
        case ".npz" | ".npy":
            return with_arrays_beside(file, read_array_frame(file, wanted, context and context.shape), wanted)
        case _ if context is None:
            return read_vdb_frame(file, wanted=wanted, fog=fog)
        case _:
            frame = read_vdb_frame(file, context.run, wanted, context.has_density, fog)
            return with_grids_beside(file, frame, context, wanted)


def files_around(path: Path) -> list[Path]:
    """The files that reading or writing a frame at a path may touch, whether they exist or not."""
    return [path, *(companions.possible_companions(path) if path.suffix.lower() in GRID_FORMATS else ())]


def write_frame(
    path: Path,
    density: np.ndarray | None,
    velocity: np.ndarray | None = None,
    obstacle: np.ndarray | None = None,
    placement: Placement | None = None,
    others: OtherGrids | None = None,
) -> None:
    """Write the grids of a frame, or a velocity alone; the extension of the path selects the format.

    A frame in several files replaces all files of an earlier one; its density file exists only once it is complete.

    Args:
        path: the file.
        density: (D, H, W), or None.
        velocity: (D, H, W, 3), cells per frame, or None.
        obstacle: (D, H, W), or None.
        placement: where the grid came from; only .vdb files store it, and .uni files which axis was up.
        others: grids besides, one of which is in memory at a time; those that `held` leaves out are not written.

    Raises:
        InputError: the format is unknown, or one of the other grids cannot be read.
    """
    grids = {"density": density, "velocity": velocity, "obstacle": obstacle}
    grids = {name: array for name, array in grids.items() if array is not None}
    match require_format(path):
        case ".npz":
            write_arrays(path, grids, others)
        case ".vol":
            _write_grids(write_vol, path, grids, others or {})
        case ".uni":
            _write_grids(partial(_write_uni, placement=placement), path, grids, others or {})
        case _:
            write_vdb_frame(path, grids, placement, others)


def held(name: str, suffix: str, grids: Iterable[str]) -> list[str]:
    """Those of some grids beside the density that a format holds.

    In formats of one grid a file, a grid is found again by its name in that of the file: words of letters, and beside
    files that are not called `density`, a usual one.

    Args:
        name: of the frame, and so of its file without the ending.
        suffix: the ending.
        grids: their names.
    """
    if suffix not in GRID_FORMATS:
        return list(grids)
    return [grid for grid in grids if grid in ROLES or companions.names_a_file(name, grid)]


def describe(file: Path) -> list[Contents]:
    """The arrays or grids in a file and its companions.

    Raises:
        InputError: a file cannot be used.
    """
    suffix = require_format(file, READABLE)
    with gate(file, f"a {suffix} file"):
        return _described(file, suffix)


def _described(file: Path, suffix: str) -> list[Contents]:
    if suffix in ARRAY_FORMATS:
        return describe_arrays(file)
    if suffix == ".vdb":
        return describe_vdb(file)
    contents = []
    for path in (file, *companions.companions_of(file)):
        if suffix == ".vol":
            values = read_vol(path)
            kind, shape = "float32", f"shape {values.shape}"
        else:
            header, values = read_uni(path)
            kind = f"{header.dtype}{', on faces' if header.staggered else ''}"
            shape = f"shape {values.shape} in its own axes"
        name = companions.numberless(path)
        contents.append(Contents(f"file {name}: {kind}", numbers=f"{shape}, {values.min():g} to {values.max():g}"))
    return contents


def _write_uni(path: Path, array: np.ndarray, placement: Placement | None) -> None:
    y_up = placement is not None and placement.up == "y"
    stored = Axes("y" if y_up else "z").turned_back(array, not is_colour(path.stem))
    kind = VECTOR if stored.ndim == 4 else REAL
    if stored.dtype == bool:
        stored, kind = stored.astype(np.int32) * OBSTACLE_FLAG, INTEGER | FLAGS
    elif stored.dtype.kind in "iu" and stored.ndim == 3:
        kind = INTEGER
    write_uni(path, stored, kind, OURS + (Y_UP if y_up else ""))


def _write_grids(
    write: Callable[[Path, np.ndarray], None],
    path: Path,
    grids: dict[str, np.ndarray],
    others: Mapping[str, np.ndarray],
) -> None:
    """Write one file per grid of a frame; a velocity alone takes the density's file name."""
    main = "density" if "density" in grids else "velocity"
    beside = {companions.companion(path, name): array for name, array in grids.items() if name != main}
    stale = [file for file in companions.possible_companions(path) if file not in beside and file.is_file()]
    held_too = held(path.stem, path.suffix.lower(), others)
    other_files = {companions.companion(path, name): name for name in held_too}
    if beside or stale or other_files:
        # Removed first: an interruption at any point must not leave a density beside the companions of another frame.
        path.unlink(missing_ok=True)
    for file in stale:
        file.unlink(missing_ok=True)
    for file, array in beside.items():
        write(file, array)
    for file, name in other_files.items():
        write(file, others[name])
    write(path, grids[main])
