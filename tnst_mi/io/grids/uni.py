"""Mantaflow's .uni files: one grid each, a gzipped header and values, x running fastest.

Sources: `fileio/iogrids.cpp` and `grid.h` of Mantaflow. A velocity grid with the MAC bit holds component c on the lower
face of each cell along axis c; one without it holds values at the cell centres.
"""

from __future__ import annotations

import gzip
import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.untrusted import LARGEST_EXTENT, LARGEST_RATIO, read_numbers, require_plausible
from tnst_mi.machine.gate import opening

# Bits of a grid's type (Mantaflow's GridBase::GridType).
REAL, INTEGER, VECTOR, MAC, FLAGS = 1, 2, 4, 8, 32

#: Bit that marks a cell of a flag grid as solid (Mantaflow's FlagGrid::TypeObstacle).
OBSTACLE_FLAG = 2

_MAGIC = b"MNT3"
_SIZES = struct.Struct("<6i")
_BUILD_BYTES = 252
_TAIL = struct.Struct("<iQ")  # fourth dimension, time stamp

# Bytes after the magic: six sizes; then MNT2 has 256 bytes of build information and a time stamp, MNT3 252 and _TAIL.
_HEADER_BYTES = {b"MNT1": 24, b"MNT2": 288, b"MNT3": 288}

# By element type and bytes per element.
_ELEMENTS = {
    (0, 4): ("<i4", 1),
    (1, 4): ("<f4", 1),
    (1, 8): ("<f8", 1),
    (2, 12): ("<f4", 3),
    (2, 24): ("<f8", 3),
}


@dataclass(frozen=True)
class UniHeader:
    """The header of a .uni file.

    Attributes:
        shape: extents of the grid in the file's own axes, slowest first: (Z, Y, X).
        grid_type: Mantaflow's bits, such as REAL, or VECTOR | MAC for velocities on faces.
        dtype: type of the stored numbers.
        components: 1, or 3 for vectors.
        build: what wrote the file.
    """

    shape: tuple[int, int, int]
    grid_type: int
    dtype: np.dtype
    components: int
    build: str

    @property
    def staggered(self) -> bool:
        """Whether the components of the vectors lie on the faces of the cells."""
        return self.components == 3 and bool(self.grid_type & MAC)


def read_uni_header(path: Path) -> UniHeader:
    """Read the header of a .uni file.

    Raises:
        InputError: the file is missing, damaged, or of an unknown kind.
    """
    return _read(path, values=False)[0]


def read_uni(path: Path) -> tuple[UniHeader, np.ndarray]:
    """Read a .uni file: its header, and its values (Z, Y, X) or (Z, Y, X, 3) in the axes and units of the file.

    Raises:
        InputError: as `read_uni_header`; or the values are truncated, or more than the header declares.
    """
    return _read(path, values=True)


def write_uni(path: Path, values: np.ndarray, grid_type: int, build: str = "tnst_mi") -> None:
    """Write a grid in Mantaflow's newest .uni version (MNT3).

    Args:
        path: the file.
        values: (Z, Y, X) or (Z, Y, X, 3) in the axes and units of the file; float32, or int32 for flags.
        grid_type: REAL, VECTOR, VECTOR | MAC, or INTEGER | FLAGS.
        build: a note of at most 251 bytes that readers show.
    """
    components = 3 if values.ndim == 4 else 1
    element = 0 if grid_type & INTEGER else 2 if components == 3 else 1
    dtype = np.dtype("<i4" if element == 0 else "<f4")
    depth, height, width = values.shape[:3]
    note = build.encode("utf-8")[: _BUILD_BYTES - 1].ljust(_BUILD_BYTES, b"\0")
    sizes = _SIZES.pack(width, height, depth, grid_type, element, components * dtype.itemsize)
    with written_whole(path) as temporary, temporary.open("wb") as raw:
        # Without a time stamp, equal grids give equal files.
        with gzip.GzipFile(filename="", mode="wb", fileobj=raw, compresslevel=1, mtime=0) as file:
            file.write(_MAGIC + sizes + note + _TAIL.pack(0, 0))
            file.write(np.ascontiguousarray(values, dtype=dtype).data)


def _read(path: Path, values: bool) -> tuple[UniHeader, np.ndarray]:
    with opening(path, "a .uni file"), gzip.open(path, "rb") as file:
        header = _read_header(path, file)
        return header, _read_values(path, file, header) if values else np.empty(0)


def _read_header(path: Path, file: gzip.GzipFile) -> UniHeader:
    magic = file.read(4)
    if magic not in _HEADER_BYTES:
        known = ", ".join(key.decode() for key in _HEADER_BYTES)
        raise InputError(f"{path}: starts with {magic!r}, expected a Mantaflow grid ({known})")
    data = file.read(_HEADER_BYTES[magic])
    if len(data) < _HEADER_BYTES[magic]:
        raise InputError(f"{path}: truncated in its header")
    width, height, depth, grid_type, element, size = _SIZES.unpack_from(data)
    if not all(1 <= extent <= LARGEST_EXTENT for extent in (width, height, depth)):
        raise InputError(f"{path}: claims {width} x {height} x {depth} cells, expected 1 to {LARGEST_EXTENT} each")
    if (element, size) not in _ELEMENTS:
        raise InputError(f"{path}: elements of type {element} with {size} bytes, expected ints, reals or vectors")
    dtype, components = _ELEMENTS[element, size]
    build = data[_SIZES.size :][:_BUILD_BYTES].split(b"\0")[0].decode("utf-8", "replace")
    return UniHeader((depth, height, width), grid_type, np.dtype(dtype), components, build)


def _read_values(path: Path, file: gzip.GzipFile, header: UniHeader) -> np.ndarray:
    """Read the values, rejecting a claimed size that the file cannot hold."""
    shape = header.shape if header.components == 1 else (*header.shape, header.components)
    size = math.prod(shape) * header.dtype.itemsize
    require_plausible(f"{path}: its grid of shape {header.shape}", size, LARGEST_RATIO * path.stat().st_size)
    values, filled = read_numbers(file, math.prod(shape), header.dtype)
    if filled < size:
        raise InputError(f"{path}: truncated: {filled} of the {size} bytes of its {header.shape} grid")
    if file.read(1):
        raise InputError(f"{path}: has more data than its {header.shape} grid needs")
    return values.reshape(shape)
