"""What a stage says of each OpenVDB file of a sequence: its grids, where their voxels are, and which axis is up.

The values of the grids are not read. Words of USD are those of its schema for volumes, `UsdVol.OpenVDBAsset`.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.geometry.affine import Affine
from tnst_mi.io.files.frame_numbers import Number
from tnst_mi.io.grids.vdb.adaptive_domain import placed
from tnst_mi.io.grids.vdb.file_format.reader import HALF, Grid, read_vdb
from tnst_mi.io.grids.vdb.programs import program_of
from tnst_mi.io.interpretation.grid_names import VELOCITY, is_colour, plain_name
from tnst_mi.machine.gate import gate

# What USD calls the types of values of OpenVDB's trees. Half precision is that of the file, floats come out of it.
_DATA_TYPES = {
    **{"float": "float", "double": "double", "int32": "int", "int64": "int64", "bool": "bool", "mask": "mask"},
    **{"vec3s": "float3", "vec3d": "double3", "vec3i": "int3", "string": "string"},
}

_CLASSES = {"fog volume": "fogVolume", "level set": "levelSet", "staggered": "staggered", "unknown": "unknown"}

# How vectors turn with their volume, by the metadata in which OpenVDB has it.
_ROLES = {
    "covariant normalize": "Normal",
    "contravariant relative": "Vector",
    "contravariant absolute": "Point",
}


@dataclass(frozen=True)
class VolumeField:
    """A grid of a file as a field of a volume.

    Attributes:
        grid: its name in the file.
        index: which of the grids of that name it is.
        data_type: USD's word for the type of its values; empty if it has none.
        grid_class: USD's word for OpenVDB's class; empty if the file does not say it.
        role: USD's word for how its vectors turn; "None" if nothing tells, or it has no vectors.
    """

    grid: str
    index: int
    data_type: str
    grid_class: str
    role: str


@dataclass(frozen=True, eq=False)
class VolumeFrame:
    """A file of a sequence as a volume at one time.

    Attributes:
        path: the file.
        number: of the frame; None if it has none.
        fields: its grids.
        extent: (2, 3) float64, the lowest and the highest corner of the active voxels of all grids in the scene, as
            the file places them; None if there are none.
        correction: from there to where they truly are; None if the file is right.
        up: the axis of the scene that is up, "y" or "z"; None if the file has no grid.
        up_because: the evidence for it, in words; empty if the file is ours and says it.
    """

    path: Path
    number: Number | None
    fields: tuple[VolumeField, ...]
    extent: np.ndarray | None
    correction: Affine | None
    up: str | None
    up_because: str


def volume_frame(path: Path, number: Number | None) -> VolumeFrame:
    """Read what a stage says of a file.

    Raises:
        InputError: the file cannot be used.
    """
    with gate(path, "a .vdb file"):
        file = placed(read_vdb(path))
        main = next((grid for grid in file.grids if grid.readable), None)
        correction = None
        if main is not None and main.placed is not None:
            correction = main.placed.after(main.stored_affine.inverse())
        counts, fields = Counter[str](), list[VolumeField]()
        for grid in file.grids:
            fields.append(_field(grid, counts[grid.name]))
            counts[grid.name] += 1
        program = program_of(file, file.grids[0]) if file.grids else None
        return VolumeFrame(
            path,
            number,
            tuple(fields),
            _extent(file.grids),
            correction,
            None if program is None else program.up,
            "" if program is None else program.up_because,
        )


def up_axis(frames: Sequence[VolumeFrame]) -> tuple[str, str]:
    """The axis that is up in all files, and the evidence for it in words.

    Raises:
        InputError: they differ, or none has a grid.
    """
    known = [frame for frame in frames if frame.up is not None]
    if not known:
        raise InputError(f"{frames[0].path}: neither it nor any other frame has a grid, so there is nothing to show")
    first = known[0]
    other = next((frame for frame in known if frame.up != first.up), None)
    if other is not None:
        raise InputError(
            f"{first.path.parent}: {first.path.name} has {first.up} up and {other.path.name} {other.up}, expected one "
            "axis in all files of a sequence; give --up y or --up z"
        )
    return first.up or "y", first.up_because


def _field(grid: Grid, index: int) -> VolumeField:
    values = grid.tree_type.removesuffix(HALF).removeprefix("Tree_").split("_")[0]
    data_type = _DATA_TYPES.get(values, "")
    grid_class = _CLASSES.get(str(grid.metadata.get("class")), "")
    role = _ROLES.get(str(grid.metadata.get("vector_type")), "None")
    if not data_type.endswith("3"):
        role = "None"
    elif is_colour(grid.name):
        role = "Color"
    elif role == "None" and (grid.staggered or plain_name(grid.name) in VELOCITY):
        role = "Vector"
    return VolumeField(grid.name, index, data_type, grid_class, role)


def _extent(grids: Sequence[Grid]) -> np.ndarray | None:
    corners = []
    for grid in grids:
        if grid.readable and (box := grid.topology.active_box()) is not None:
            # Voxels are cubes around their coordinates.
            edges = zip(box[0] - 0.5, box[1] + 0.5, strict=True)
            corners.append(grid.stored_affine(np.array([*itertools.product(*edges)])))
    if not corners:
        return None
    points = np.concatenate(corners)
    return np.stack([points.min(axis=0), points.max(axis=0)])
