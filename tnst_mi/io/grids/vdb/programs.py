"""Which axis is up in an OpenVDB file, and what its velocities are, by the metadata of the program that wrote it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from tnst_mi.io.grids.vdb.file_format.metadata import Value
from tnst_mi.io.grids.vdb.file_format.reader import Grid, VdbFile
from tnst_mi.io.interpretation.conventions import CELLS_PER_TIME, LENGTH_PER_TIME, VELOCITY_UNITS

#: Metadata that our files carry; other programs may write it too.
UP, UNITS = "tnst_mi_up", "tnst_mi_velocity_units"

#: The names of their grids, which are those of their sources, by what they are: "tnst_mi_density" and so on.
NAME = "tnst_mi_{}"

#: Blender's caches (Mantaflow) store with every grid the resolution of the domain, whose first voxel is (0, 0, 0).
BLENDER = "file_base_resolution"

# Programs by the word with which they name themselves, and the axis that is up in their files.
_PROGRAMS = {
    "embergen": ("EmberGen", "z"),
    "liquigen": ("LiquiGen", "z"),
    "jangafx": ("JangaFX", "z"),
    "blender": ("Blender", "z"),
    "houdini": ("Houdini", "y"),
}

# A program's name in a text: not within another word or in a path, in which it may name anything.
_NAMED = re.compile(rf"(?:^|[\s(])({'|'.join(_PROGRAMS)})(?![a-z])")

# Metadata that name the program that wrote a file, in small letters and without signs, in order of preference.
_NAMING = (
    *("creator", "createdby", "generator", "application", "app", "software", "program", "writer", "writtenby"),
    *("exporter", "exportedby", "authoringtool", "tool"),
)

# Metadata that only one program writes: its own version, such as `embergen_version`.
_VERSION = re.compile(rf"({'|'.join(_PROGRAMS)})(?:app)?(?:version|build|release)?$")

# Metadata that say which axis is up, likewise.
_UP_KEYS = ("upaxis", "axisup", "updirection", "upvector", "worldup", "up")
_UP_TEXT = re.compile(r"\+?([yz])(?:axis|up)?")
_LONGEST_KEY = 30
_UP_VECTORS: dict[tuple[float, ...], str] = {(0.0, 1.0, 0.0): "y", (0.0, 0.0, 1.0): "z"}


@dataclass(frozen=True)
class Program:
    """The conventions of a file.

    Attributes:
        up: the up axis, "y" or "z".
        up_because: the evidence for it in words; empty if the file is ours and says it.
        velocity_units: one of `tnst_mi.io.interpretation.conventions.VELOCITY_UNITS`.
    """

    up: str
    up_because: str
    velocity_units: str


def program_of(file: VdbFile, grid: Grid) -> Program:
    """The conventions of the program that wrote a file, of whose grids one is given."""
    up, units = file.metadata.get(UP), file.metadata.get(UNITS)
    blender = BLENDER in grid.metadata
    if not (isinstance(units, str) and units in VELOCITY_UNITS):
        units = CELLS_PER_TIME if blender else LENGTH_PER_TIME
    if isinstance(up, str) and up in ("y", "z"):
        return Program(up, "", units)
    return Program(*_up_by_evidence(file, blender), units)


def _up_by_evidence(file: VdbFile, blender: bool) -> tuple[str, str]:
    """The up axis, and why: what the metadata say of it, or else of the program."""
    said = ""
    for key, value in _metadata(file):
        if _plain(key) in _UP_KEYS:
            if (axis := _axis(value)) is not None:
                return axis, f"as its {key[:_LONGEST_KEY]} says"
            said = said or f"its {key[:_LONGEST_KEY]} is neither y nor z"
    if blender:
        return "z", "as Blender's metadata say"
    if (program := _program(file)) is not None:
        name, axis = _PROGRAMS[program]
        return axis, f"as {name}'s metadata say"
    return "y", said or "no metadata say otherwise"


def _metadata(file: VdbFile) -> Iterator[tuple[str, Value]]:
    """The metadata of a file, then those of its grids."""
    for metadata in (file.metadata, *(grid.metadata for grid in file.grids)):
        yield from metadata.items()


def _program(file: VdbFile) -> str | None:
    """The program that wrote a file, a key of _PROGRAMS; None if it is none of these, or not named.

    Texts about something else, such as paths and comments, may mention any program.
    """
    plain = [(_plain(key), value) for key, value in _metadata(file)]
    for naming in _NAMING:
        for key, value in plain:
            if key == naming and isinstance(value, str) and (found := _NAMED.search(value.lower())):
                return found[1]
    return next((found[1] for key, _ in plain if (found := _VERSION.match(key))), None)


def _plain(key: str) -> str:
    """A key in small letters, without signs: `up_axis`, `up axis` and `upAxis` are one."""
    return re.sub(r"[\W_]", "", key.lower())


def _axis(value: Value) -> str | None:
    """The axis that a value names, "y" or "z"; None if it is another, or none."""
    if isinstance(value, str):
        # A minus at the start is one: −Z is another axis than Z-up.
        found = _UP_TEXT.fullmatch(re.sub(r"(?<!^)[\s_-]", "", value.strip().lower()))
        return None if found is None else found[1]
    return _UP_VECTORS.get(tuple(map(float, value))) if isinstance(value, tuple) and len(value) == 3 else None
