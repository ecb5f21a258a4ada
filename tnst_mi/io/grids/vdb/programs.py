"""Which axis is up in an OpenVDB file, and what its velocities are, by the metadata of the program that wrote it."""

from __future__ import annotations

from dataclasses import dataclass

from tnst_mi.io.grids.vdb.file_format.reader import Grid, VdbFile
from tnst_mi.io.interpretation.conventions import CELLS_PER_TIME, LENGTH_PER_TIME, VELOCITY_UNITS

#: Metadata that our files carry; other programs may write it too.
UP, UNITS = "tnst_mi_up", "tnst_mi_velocity_units"

#: The names of their grids, which are those of their sources, by what they are: "tnst_mi_density" and so on.
NAME = "tnst_mi_{}"

#: Blender's caches (Mantaflow) store with every grid the resolution of the domain, whose first voxel is (0, 0, 0).
BLENDER = "file_base_resolution"

#: Programs with z up, by a word in the names or values of the metadata that they write.
_Z_UP = {"embergen": "EmberGen", "jangafx": "JangaFX", "blender": "Blender"}


@dataclass(frozen=True)
class Program:
    """The conventions of a file.

    Attributes:
        up: the up axis, "y" or "z".
        up_because: the evidence for it in words; empty if the file says it.
        velocity_units: one of `tnst_mi.io.interpretation.conventions.VELOCITY_UNITS`.
    """

    up: str
    up_because: str
    velocity_units: str


def program_of(file: VdbFile, grid: Grid) -> Program:
    """The conventions of the program that wrote a file, of whose grids one is given."""
    up, units = file.metadata.get(UP), file.metadata.get(UNITS)
    if isinstance(up, str) and up in ("y", "z") and isinstance(units, str) and units in VELOCITY_UNITS:
        return Program(up, "", units)
    if BLENDER in grid.metadata:
        return Program("z", "as Blender's metadata say", CELLS_PER_TIME)
    words = " ".join(
        f"{name} {value}".lower() if isinstance(value, str) else name.lower()
        for metadata in (file.metadata, *(other.metadata for other in file.grids))
        for name, value in metadata.items()
    )
    for word, program in _Z_UP.items():
        if word in words:
            return Program("z", f"as {program}'s metadata say", LENGTH_PER_TIME)
    return Program("y", "no metadata say otherwise", LENGTH_PER_TIME)
