"""Read OpenVDB files (.vdb): the grids, their metadata and transforms, and their trees.

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
from tnst_mi.geometry.affine import Affine
from tnst_mi.io.grids.vdb.file_format.cursor import Cursor
from tnst_mi.io.grids.vdb.file_format.metadata import Stored, Value, read_metadata, read_transform, values_of
from tnst_mi.io.grids.vdb.file_format.tree import Tree, TreeReader
from tnst_mi.io.grids.vdb.file_format.values import BLOSC, VALUE_TYPES, ZIP, ValueType
from tnst_mi.machine.gate import opening
from tnst_mi.machine.terminal import quoted

#: The first eight bytes of every file.
MAGIC = struct.pack("<q", 0x56444220)

#: Supported versions of the format.
VERSIONS = (222, 223, 224)

#: Suffix of the type of a tree with values in half precision.
HALF = "_HalfFloat"

#: Length of a file's UUID, which is stored as text.
UUID_BYTES = 36

#: A number after this character makes equal grid names unique.
SEPARATOR = "\x1e"

_VERSION = struct.Struct("<3I?")
_COUNT = struct.Struct("<i")
_OFFSETS = struct.Struct("<3q")
_COMPRESSION = struct.Struct("<I")

# Limits on what precedes the values of a file or grid: bytes, and number of grids.
_LARGEST_DESCRIPTION = 1 << 20
_LARGEST_COUNT = 1000


@dataclass(frozen=True)
class Grid:
    """A grid of a file; its tree is read on first access.

    Attributes:
        path: the file.
        name: name of the grid; several may share one.
        tree_type: type of the tree as written in the file, such as "Tree_float_5_4_3_HalfFloat".
        stored: metadata as the file has it.
        transform: from voxels to the scene; the name of its kind if that is not affine.
        compression: bits, see `tnst_mi.io.grids.vdb.file_format.values`.
        span: offsets in the file of the tree, of the values of its leaves, and of its end.
        placed: from voxels to the scene where `transform` is known to be untrue; else None.
        owner: the grid whose tree it shares; None if it has its own.
    """

    path: Path
    name: str
    tree_type: str
    stored: Stored
    transform: Affine | str
    compression: int
    span: tuple[int, int, int]
    placed: Affine | None = None
    owner: Grid | None = None

    @cached_property
    def metadata(self) -> dict[str, Value]:
        """The metadata that have a known type, by name."""
        return values_of(self.stored)

    @property
    def affine(self) -> Affine:
        """The map from voxels to the scene.

        Raises:
            InputError: as `stored_affine`.
        """
        return self.stored_affine if self.placed is None else self.placed

    @property
    def stored_affine(self) -> Affine:
        """The map from voxels to the scene as the file has it.

        Raises:
            InputError: it is not affine.
        """
        if isinstance(self.transform, str):
            raise InputError(
                f"{self.path}: grid {quoted(self.name)} is placed by a {self.transform}, expected an affine map "
                "(scale, rotation, translation); resample it"
            )
        return self.transform

    @property
    def voxel_size(self) -> float:
        """Edge of a voxel (of a cube of its volume), in units of the scene."""
        return self.affine.edge

    @property
    def translation(self) -> tuple[float, float, float]:
        """Position of voxel (0, 0, 0) in the scene."""
        x, y, z = self.affine.offset.tolist()
        return x, y, z

    @property
    def half(self) -> bool:
        """Whether its values are stored in half precision."""
        return self.tree_type.endswith(HALF)

    @property
    def kind(self) -> ValueType | None:
        """The kind of its values; None if unsupported."""
        known = VALUE_TYPES.get(self.tree_type.removesuffix(HALF))
        if known is None or known.dtype.kind != "f":  # integers are never in half precision, whatever the type name
            return known
        return dataclasses.replace(known, half=self.half)

    @property
    def readable(self) -> bool:
        """Whether its values and its place are of kinds that can be read."""
        return self.kind is not None and not isinstance(self.transform, str)

    @property
    def staggered(self) -> bool:
        """Whether the components of its vectors lie on the faces of the cells."""
        return self.metadata.get("class") == "staggered"

    @property
    def codec(self) -> str:
        """The compression of its values."""
        return "blosc" if self.compression & BLOSC else "zip" if self.compression & ZIP else "uncompressed"

    @cached_property
    def tree(self) -> Tree:
        """The voxels and their values.

        Raises:
            InputError: they are truncated or damaged, or of an unsupported kind.
        """
        return self._read(values=True) if self.owner is None else self.owner.tree

    @cached_property
    def topology(self) -> Tree:
        """The tree without the values of its leaves, which is faster to read.

        Raises:
            InputError: as `tree`.
        """
        return self._read(values=False) if self.owner is None else self.owner.topology

    def _read(self, values: bool) -> Tree:
        if self.kind is None:
            known = ", ".join(VALUE_TYPES)
            raise InputError(f"{self.path}: grid {quoted(self.name)} is a {self.tree_type}, expected one of {known}")
        start, leaves, end = self.span
        with self.path.open("rb") as file:
            cursor = _cursor(self.path, file, start, end if values else leaves)
        return TreeReader(cursor, self.kind, self.compression).read(values)


@dataclass(frozen=True)
class VdbFile:
    """The contents of an OpenVDB file: its path, metadata as stored, and grids in file order."""

    path: Path
    stored: Stored
    grids: list[Grid]

    @cached_property
    def metadata(self) -> dict[str, Value]:
        """The metadata that have a known type, by name."""
        return values_of(self.stored)


def read_vdb(path: Path) -> VdbFile:
    """Read the contents of an OpenVDB file except for the values of the grids.

    Raises:
        InputError: it is missing, damaged, not an OpenVDB file, or of an unsupported version.
    """
    with opening(path, "a .vdb file"), path.open("rb") as file:
        return _read(path, file)


def _read(path: Path, file: BinaryIO) -> VdbFile:
    cursor = _cursor(path, file, 0)
    if path.stat().st_size < len(MAGIC) or bytes(cursor.take(len(MAGIC))) != MAGIC:
        raise InputError(f"{path}: no OpenVDB file (it does not start like one)")
    version, _, _, has_offsets = cursor.unpack(_VERSION)
    if version not in VERSIONS:
        raise InputError(
            f"{path}: OpenVDB file version {version}, expected {VERSIONS[0]} to {VERSIONS[-1]}; save it with OpenVDB 3 "
            "to 12"
        )
    cursor.take(UUID_BYTES)
    stored = read_metadata(cursor)
    (count,) = cursor.unpack(_COUNT)
    if not 0 <= count <= _LARGEST_COUNT:
        raise InputError(f"{path}: damaged: {count} grids; export it again")
    read = _read_grid if has_offsets else _read_following_grid
    grids: dict[str, Grid] = {}
    parents: dict[str, str] = {}
    place = cursor.position
    for _ in range(count):
        grid, unique_name, parent = read(path, file, place)
        while unique_name in grids:  # though it should be unique
            unique_name += SEPARATOR
        grids[unique_name] = grid
        if parent:
            parents[unique_name] = parent
        place = grid.span[-1]
    for name, parent in parents.items():
        if parent not in grids:
            raise InputError(
                f"{path}: damaged: grid {quoted(name)} shares the tree of {quoted(parent)}, which is not there"
            )
        tree = grids[parent]
        grids[name] = dataclasses.replace(
            grids[name], tree_type=tree.tree_type, compression=tree.compression, span=tree.span, owner=tree
        )
    return VdbFile(path, stored, list(grids.values()))


def _read_grid(path: Path, file: BinaryIO, place: int) -> tuple[Grid, str, str]:
    """Read all of a grid but its tree: the grid, its unique name, and that of the grid whose tree it shares, if any."""
    cursor = _cursor(path, file, place)
    unique_name, tree_type, parent = cursor.string(), cursor.string(), cursor.string()
    start, leaves, end = cursor.unpack(_OFFSETS)
    # A grid that shares the tree of another has no leaves of its own.
    if not 0 <= start <= (end if parent else leaves) <= end <= path.stat().st_size:
        raise InputError(
            f"{path}: truncated or damaged: grid {quoted(unique_name)} lies outside of the file; export it again"
        )
    # Grids that overlap would hold more together than the file does.
    if start < place + cursor.position:
        raise InputError(
            f"{path}: damaged: grid {quoted(unique_name)} begins before its description ends; export it again"
        )
    cursor = _cursor(path, file, start, min(end, start + _LARGEST_DESCRIPTION))
    grid = _described_grid(cursor, unique_name, tree_type)
    if not parent and start + cursor.position > leaves:
        raise InputError(f"{path}: damaged: a grid's values start before its description ends; export it again")
    return dataclasses.replace(grid, span=(start + cursor.position, leaves, end)), unique_name, parent


def _read_following_grid(path: Path, file: BinaryIO, place: int) -> tuple[Grid, str, str]:
    """The same, of a file without the places of its grids: a grid begins where the one before it ends."""
    cursor = _cursor(path, file, place, path.stat().st_size)
    unique_name, tree_type, parent = cursor.string(), cursor.string(), cursor.string()
    cursor.unpack(_OFFSETS)  # without meaning here
    grid = _described_grid(cursor, unique_name, tree_type)
    start = leaves = place + cursor.position
    if not parent:
        if grid.kind is None or isinstance(grid.transform, str):
            raise InputError(
                f"{path}: its header does not say where grids begin, so those after {quoted(grid.name)} (a "
                f"{tree_type}) cannot be found; save it again with OpenVDB's File::write"
            )
        reader = TreeReader(cursor, grid.kind, grid.compression)
        reader.read_topology()
        leaves = place + cursor.position
        reader.skip_leaves()
    return dataclasses.replace(grid, span=(start, leaves, place + cursor.position)), unique_name, parent


def _described_grid(cursor: Cursor, unique_name: str, tree_type: str) -> Grid:
    (compression,) = cursor.unpack(_COMPRESSION)
    stored = read_metadata(cursor)
    transform = read_transform(cursor)
    name = unique_name.split(SEPARATOR)[0]
    return Grid(cursor.path, name, tree_type, stored, transform, compression, (0, 0, 0))


def _cursor(path: Path, file: BinaryIO, start: int, end: int | None = None) -> Cursor:
    """The bytes of a file from `start` to `end`, or else a part longer than any description of a grid."""
    file.seek(start)
    return Cursor(path, file.read(_LARGEST_DESCRIPTION if end is None else end - start))
