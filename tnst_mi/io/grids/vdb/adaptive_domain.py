"""Where the voxels of Blender's adaptive domains are, of which the transforms of their files are untrue.

With Adaptive Domain, Blender simulates a part of the domain that follows the smoke. Its cells have one size and lie on
one lattice in all frames, but a file of the cache is written as if its part were the whole domain: the longest extent
of the part, whatever that is, fills the longest side of the domain, from the origin on. What is true is in the cache's
`config/config_0012.uni`, beside `data/` and `noise/`. Our own results have it in their metadata.

Source: `MANTA::writeConfiguration` in Blender's `intern/mantaflow/intern/MANTA_main.cpp`; `adaptive_domain_adjust` in
`source/blender/blenkernel/intern/fluid.c`.
"""

from __future__ import annotations

import gzip
import math
import re
import struct
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.geometry.affine import EDGE_TOLERANCE, Affine
from tnst_mi.io.grids.vdb.file_format.reader import Grid, VdbFile
from tnst_mi.io.grids.vdb.programs import BLENDER
from tnst_mi.io.untrusted import LARGEST_EXTENT
from tnst_mi.machine.gate import opening

#: Metadata that our files carry where their transform is untrue: the size of the voxels, and where the first one is.
VOXEL_SIZE, TRANSLATION = "tnst_mi_voxel_size", "tnst_mi_translation"

# What of a configuration is needed: the resolution of the part, the size of a cell in parts of the domain's longest
# side, the lowest corner of the domain, the cells by which the domain object has moved, the resolution of the domain,
# and the first cell of the part in it, and the one after its last.
_CONFIGURATION = struct.Struct("<4x 3i f 4x 3f 24x 3i 76x 3i 3i 3i")

# Configurations of other versions of Blender may be longer than those known, but not so long.
_LONGEST_CONFIGURATION = 1 << 16


@dataclass(frozen=True)
class _Part:
    """The part of a domain that is simulated in a frame, in cells of the simulation (X, Y, Z).

    It may reach beyond the domain, where Blender is allowed to add resolution.
    """

    resolution: np.ndarray
    whole: np.ndarray
    first: np.ndarray
    corner: tuple[float, float, float]  # the lowest of the domain, in the scene's units along the object's own axes


def placed(file: VdbFile) -> VdbFile:
    """A file with the true places of its voxels, where they are known to differ from its transforms.

    Raises:
        InputError: the configuration beside it is damaged.
    """
    size, translation = file.metadata.get(VOXEL_SIZE), file.metadata.get(TRANSLATION)
    if isinstance(size, float) and isinstance(translation, tuple):
        true = Affine.scaling(size, np.array(translation, np.float64))
        if not (size > 0.0 and true.places_voxels):
            raise InputError(f"{file.path}: damaged: says that its voxels are {size} large, at {translation}")
        return replace(file, grids=[replace(grid, placed=true) for grid in file.grids])
    if not any(BLENDER in grid.metadata for grid in file.grids):
        return file
    part = _part(file.path)
    return file if part is None else replace(file, grids=[_in_domain(grid, part) for grid in file.grids])


def domain_corner(path: Path) -> tuple[float, float, float] | None:
    """The lowest corner of the domain of Blender that a file of a cache is of, along the axes of the domain object and
    from its origin; None if nothing tells.

    Raises:
        InputError: the configuration beside the file is damaged.
    """
    part = _part(path)
    return None if part is None else part.corner


def _in_domain(grid: Grid, part: _Part) -> Grid:
    """A grid of the part where it lies in the domain; as it is if it is not of this part, or this is all."""
    stored, resolution = grid.transform, grid.metadata.get(BLENDER)
    if isinstance(stored, str) or not isinstance(resolution, tuple):
        return grid
    resolution = np.array(resolution)
    finer = resolution // part.resolution  # noise
    fits = finer.min() >= 1 and (finer == finer.flat[0]).all() and (resolution == finer * part.resolution).all()
    is_all = (part.resolution == part.whole).all() and not part.first.any()
    if is_all or not fits:
        return grid
    matrix = stored.matrix * (part.resolution.max() / part.whole.max())
    return replace(grid, placed=Affine(matrix, stored.offset + matrix @ (finer * part.first)))


def _part(path: Path) -> _Part | None:
    """The part of the domain that a file of a cache is of; None if nothing tells."""
    number = re.search(r"_(-?\d+)$", path.stem)
    if number is None:
        return None
    configuration = path.parent.parent / "config" / f"config_{number[1]}.uni"
    if not configuration.is_file():
        return None
    with opening(configuration, "a configuration of Blender's fluids"):
        with gzip.open(configuration, "rb") as file:
            # To the end, or the checksum would not be looked at.
            data = file.read(_LONGEST_CONFIGURATION)
            if file.read(1):
                raise InputError(f"{configuration}: has more than {_LONGEST_CONFIGURATION} bytes")
        if len(data) < _CONFIGURATION.size:
            raise InputError(f"{configuration}: truncated: {len(data)} bytes, expected {_CONFIGURATION.size} or more")
    numbers = _CONFIGURATION.unpack_from(data)
    resolution, cell, (x, y, z) = np.array(numbers[:3]), numbers[3], numbers[4:7]
    moved, whole, first, end = np.array(numbers[7:], np.int64).reshape(4, 3)
    plausible = all((1 <= extents).all() and (extents <= LARGEST_EXTENT).all() for extents in (resolution, whole))
    agree = (end - first == resolution).all() and math.isclose(cell * whole.max(), 1.0, rel_tol=EDGE_TOLERANCE)
    if not (plausible and agree):
        raise InputError(
            f"{configuration}: damaged: {resolution.tolist()} cells from {first.tolist()} to {end.tolist()}, of "
            f"{cell:.4g}, in a domain of {whole.tolist()}; these contradict each other"
        )
    return _Part(resolution, whole, first + moved, (x, y, z))
