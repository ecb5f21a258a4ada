"""OpenVDB files (.vdb): what grids there are, their named values and places, and their trees.

Source: `openvdb/io/File.cc`, `Archive.cc`, `GridDescriptor.cc`; file versions 222 to 224 (OpenVDB 3 to 12).
"""

from __future__ import annotations

import dataclasses
import struct
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import BinaryIO

from tnst_mi.errors import InputError
from tnst_mi.io.grids.vdb.cursor import Cursor
from tnst_mi.io.grids.vdb.metadata import Value, read_metadata, read_transform
from tnst_mi.io.grids.vdb.tree import Tree, TreeReader
from tnst_mi.io.grids.vdb.values import BLOSC, VALUE_TYPES, ZIP, ValueType
from tnst_mi.io.untrusted import opening

#: The first eight bytes of every file.
MAGIC = struct.pack("<q", 0x56444220)

#: Versions of the format that are read.
VERSIONS = (222, 223, 224)

#: Ends the type of a tree whose values are in half precision.
HALF = "_HalfFloat"

#: Length of the identifier of a file.
UUID_BYTES = 36

# Equal names of grids are made unique by a number after this character.
_SEPARATOR = "\x1e"

_VERSION = struct.Struct("<3I?")
_COUNT = struct.Struct("<i")
_OFFSETS = struct.Struct("<3q")
_COMPRESSION = struct.Struct("<I")

# Of the part of a file, or of a grid, that comes before the values.
_LARGEST_DESCRIPTION = 1 << 20
_LARGEST_COUNT = 1000


@dataclass(frozen=True)
class Grid:
    """A grid of a file; its tree is read when it is asked for.

    Attributes:
        path: the file.
        name: of the grid; several may have the same.
        tree_type: the type of the tree in the words of the file, such as "Tree_float_5_4_3_HalfFloat".
        metadata: named values.
        voxel_size: edge of a voxel, in units of the scene.
        translation: where voxel (0, 0, 0) is in the scene.
        compression: bits, see `tnst_mi.io.grids.vdb.values`.
        span: where in the file its tree starts, where the values of the leaves do, and where it ends.
    """

    path: Path
    name: str
    tree_type: str
    metadata: dict[str, Value]
    voxel_size: float
    translation: tuple[float, float, float]
    compression: int
    span: tuple[int, int, int]

    @property
    def half(self) -> bool:
        """Whether its values are stored in half precision."""
        return self.tree_type.endswith(HALF)

    @property
    def kind(self) -> ValueType | None:
        """The kind of its values; None for a kind that is not read."""
        known = VALUE_TYPES.get(self.tree_type.removesuffix(HALF))
        if known is None or known.dtype.kind != "f":  # integers are not halved, whatever their type is called
            return known
        return dataclasses.replace(known, half=self.half)

    @property
    def staggered(self) -> bool:
        """Whether the components of its vectors lie on the faces of the cells."""
        return self.metadata.get("class") == "staggered"

    @property
    def codec(self) -> str:
        """What its values are compressed with."""
        return "blosc" if self.compression & BLOSC else "zip" if self.compression & ZIP else "uncompressed"

    @cached_property
    def tree(self) -> Tree:
        """The voxels and their values.

        Raises:
            InputError: they are truncated or damaged, or of a kind that is not read.
        """
        return self._read(values=True)

    @cached_property
    def topology(self) -> Tree:
        """The tree without the values of its leaves, which is quicker to read.

        Raises:
            InputError: as `tree`.
        """
        return self._read(values=False)

    def _read(self, values: bool) -> Tree:
        if self.kind is None:
            known = ", ".join(VALUE_TYPES)
            raise InputError(f"{self.path}: grid {self.name!r} is a {self.tree_type}, expected one of {known}")
        start, leaves, end = self.span
        with self.path.open("rb") as file:
            cursor = _cursor(self.path, file, start, end if values else leaves)
        return TreeReader(cursor, self.kind, self.compression).read(values)


@dataclass(frozen=True)
class VdbFile:
    """What an OpenVDB file holds: named values, and grids in the order of the file."""

    metadata: dict[str, Value]
    grids: list[Grid]


def read_vdb(path: Path) -> VdbFile:
    """Read what is in an OpenVDB file, but for the values of the grids.

    Raises:
        InputError: it is missing, damaged, no such file, or of a version that is not read; or a grid's voxels are no
            cubes along the axes of the scene.
    """
    with opening(path, "a .vdb file"), path.open("rb") as file:
        return _read(path, file)


def _read(path: Path, file: BinaryIO) -> VdbFile:
    cursor = _cursor(path, file, 0)
    if path.stat().st_size < len(MAGIC) or bytes(cursor.take(len(MAGIC))) != MAGIC:
        raise InputError(f"{path}: no OpenVDB file (it does not start like one)")
    version, _, _, has_offsets = cursor.unpack(_VERSION)
    if version not in VERSIONS:
        raise InputError(f"{path}: OpenVDB file version {version}, expected {VERSIONS[0]} to {VERSIONS[-1]}")
    if not has_offsets:
        raise InputError(f"{path}: written as a stream, without the places of its grids; save it as a file")
    cursor.take(UUID_BYTES)
    metadata = read_metadata(cursor)
    (count,) = cursor.unpack(_COUNT)
    if not 0 <= count <= _LARGEST_COUNT:
        raise InputError(f"{path}: damaged: {count} grids")
    grids: dict[str, Grid] = {}
    parents: dict[str, str] = {}
    for _ in range(count):
        unique_name, tree_type, parent = cursor.string(), cursor.string(), cursor.string()
        places = start, leaves, end = cursor.unpack(_OFFSETS)
        # A grid that shares the tree of another one has no leaves.
        if not 0 <= start <= (end if parent else leaves) <= end <= path.stat().st_size:
            raise InputError(f"{path}: truncated or damaged: grid {unique_name!r} lies outside of the file")
        grids[unique_name] = _read_grid(path, file, unique_name.split(_SEPARATOR)[0], tree_type, places)
        if parent:
            parents[unique_name] = parent
        cursor = _cursor(path, file, end)
    for name, parent in parents.items():
        if parent not in grids:
            raise InputError(f"{path}: damaged: grid {name!r} shares the tree of {parent!r}, which is not there")
        tree = grids[parent]
        grids[name] = dataclasses.replace(
            grids[name], tree_type=tree.tree_type, compression=tree.compression, span=tree.span
        )
    return VdbFile(metadata, list(grids.values()))


def _read_grid(path: Path, file: BinaryIO, name: str, tree_type: str, places: tuple[int, int, int]) -> Grid:
    start, leaves, end = places
    cursor = _cursor(path, file, start, min(end, start + _LARGEST_DESCRIPTION))
    (compression,) = cursor.unpack(_COMPRESSION)
    metadata = read_metadata(cursor)
    placement = read_transform(cursor)
    return Grid(path, name, tree_type, metadata, *placement, compression, (start + cursor.position, leaves, end))


def _cursor(path: Path, file: BinaryIO, start: int, end: int | None = None) -> Cursor:
    """The bytes of a file from `start` to `end`, or a part that is longer than any description of a grid."""
    if end is not None and end < start:
        raise InputError(f"{path}: damaged: a grid's values start before its description ends")
    file.seek(start)
    return Cursor(path, file.read(_LARGEST_DESCRIPTION if end is None else end - start))
