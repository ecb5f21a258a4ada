"""OpenVDB files as Houdini writes its pyro simulations, by our own writer.

y up, metres and metres per second; the centre of the first voxel is half a voxel from the corner of the domain;
velocities are three scalar grids on faces, or a vector grid of class "staggered" or at centres. All of this is
known from documentation and from files that are published, not from a Houdini of ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.geometry.affine import Affine
from tnst_mi.io.grids.vdb.file_format.writer import DenseGrid, write_vdb

#: Who wrote a file, as Houdini says it.
CREATOR = "Houdini/GU_PrimVDB"

#: Of a grid: what Houdini keeps with it, and means nothing to others.
METADATA: Mapping[str, tuple[str, Any]] = {
    "is_local_space": ("bool", False),
    "value_type": ("string", "float"),
    "vector_type": ("string", "invariant"),
    "intrinsic:volumevisualmode": ("string", "smoke"),
}

#: Where the first voxel's corner is, in metres.
CORNER = (-1.5, 0.25, 4.0)


def houdini_grid(
    name: str,
    values: np.ndarray,
    edge: float,
    *,
    lowered: tuple[float, float, float] = (0.0, 0.0, 0.0),
    half: bool = False,
    grid_class: str = "",
    background: float = 0.0,
) -> DenseGrid:
    """A grid on voxels of an edge; `lowered` by a share of a voxel along x, y and z."""
    offset = np.array(CORNER) + edge * (0.5 - np.array(lowered))
    return DenseGrid(
        name,
        values,
        transform=Affine(np.eye(3) * edge, offset),
        metadata=METADATA,
        half=half,
        grid_class=grid_class,
        background=background,
    )


def velocity_in_parts(velocity: np.ndarray, edge: float, half: bool = False) -> list[DenseGrid]:
    """`vel.x`, `vel.y` and `vel.z` on the lower faces of voxels, from (D, H, W, 3)."""
    return [
        houdini_grid(
            f"vel.{axis}",
            np.ascontiguousarray(velocity[..., c]),
            edge,
            lowered=tuple(0.5 * (np.arange(3) == c)),
            half=half,
        )
        for c, axis in enumerate("xyz")
    ]


def write_houdini(path: Path, grids: list[DenseGrid], compression: str = "blosc") -> None:
    """Write a file of grids."""
    write_vdb(path, grids, {"creator": ("string", CREATOR)}, compression)
