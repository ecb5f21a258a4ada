"""Where a grid lies in its scene, and what is kept of the file that it came from, for results to be like it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.geometry.affine import Affine
from tnst_mi.geometry.boxes import Box


@dataclass(frozen=True, eq=False)
class OwnVoxels:
    """The voxels of the file that a frame was read from, to which results return.

    Attributes:
        scene: from these voxels to the scene, as the file has it.
        voxels_of: from the frame's cells to them, in the axes of the file.
        placed: from these voxels to the scene, where it is known that `scene` is untrue; else None.
        values: where cells and voxels do not coincide, the density (Z, Y, X) in `box`; else None.
        box: where these values lie.
        outside: the density of all other voxels.
        moved: by what `scene` and `placed` differ from those of the file, (X, Y, Z).
    """

    scene: Affine
    voxels_of: Affine
    placed: Affine | None = None
    values: np.ndarray | None = None
    box: Box | None = None
    outside: float = 0.0
    moved: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class GridSource:
    """What a result keeps of a grid: its name, its metadata (type and value by name), and its precision."""

    name: str
    metadata: Mapping[str, tuple[str, Any]]
    half: bool = False


@dataclass(frozen=True, eq=False)
class KeptGrid:
    """A grid of a file that results have again, besides the density: where it is found when it is needed.

    Attributes:
        path: the file.
        index: which of its grids.
        cells: the cells of the frame.
        run: from cells to the scene.
    """

    path: Path
    index: int
    cells: Box
    run: Affine


@dataclass(frozen=True)
class FileSource:
    """What a result keeps of a file.

    Attributes:
        metadata: of the file, type and value by name.
        grids: its grids by what they are ("density", …).
        velocity: the grids of the velocity of the simulation, by name.
        velocity_units: the unit of these.
        obstacle: those of the obstacle.
        others: all other grids.
    """

    metadata: Mapping[str, tuple[str, Any]]
    grids: Mapping[str, GridSource]
    velocity: Mapping[str, KeptGrid] = field(default_factory=dict)
    velocity_units: str = ""
    obstacle: Mapping[str, KeptGrid] = field(default_factory=dict)
    others: Mapping[str, KeptGrid] = field(default_factory=dict)


@dataclass(frozen=True)
class Placement:
    """Position, size and orientation of a grid in its scene.

    Attributes:
        voxel_size: edge of a cell, in the scene's unit of length.
        corner: (X, Y, Z) of the centre of the grid's lowest cell, in the axes of the scene.
        up: the axis of the scene that points up, "y" or "z".
        own: the voxels of the file that the grid came from; None if they are the grid's cells as above.
        source: what else results keep of this file, or None.
        drift: by how many of its cells per frame the grid moves in the scene, along our axes (x, y, z); None if it
            rests. A frame's velocities are those relative to its grid.
    """

    voxel_size: float = 1.0
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0)
    up: str = "z"
    own: OwnVoxels | None = field(default=None, compare=False, repr=False)
    source: FileSource | None = field(default=None, compare=False, repr=False)
    drift: tuple[float, float, float] | None = None

    def to_scene(self, shape: tuple[int, int, int]) -> Affine:
        """From the cells (x, y, z) of a grid of shape (D, H, W), the first of which is centred at 0, to the scene.

        Example:
            >>> Placement(0.5, (1.0, 2.0, 3.0), "z").to_scene((9, 5, 7))(np.array([0.0, 4.0, 8.0])).tolist()
            [1.0, 2.0, 5.0]
        """
        if self.up == "y":
            return Affine.scaling(self.voxel_size, self.corner)
        # Our z runs along −Y of a scene whose Z is up.
        turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        farthest = np.array([0.0, self.voxel_size * (shape[0] - 1), 0.0])
        return Affine(self.voxel_size * turn, self.corner + farthest)

    def moved(self, vector: tuple[float, float, float]) -> Placement:
        """The placement after a translation (X, Y, Z) in the scene, such as that of a simulation's domain.

        Example:
            >>> Placement(0.5, (1.0, 2.0, 3.0)).moved((10.0, 0.0, -3.0)).corner
            (11.0, 2.0, 0.0)
        """
        x, y, z = (coordinate + by for coordinate, by in zip(self.corner, vector, strict=True))
        own = self.own
        if own is not None:
            placed = None if own.placed is None else own.placed.moved(vector)
            x_moved, y_moved, z_moved = (before + by for before, by in zip(own.moved, vector, strict=True))
            own = replace(own, scene=own.scene.moved(vector), placed=placed, moved=(x_moved, y_moved, z_moved))
        return replace(self, corner=(x, y, z), own=own)
