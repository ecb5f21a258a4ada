"""Where a grid lies in the scene that it came from, so that results can be put back into it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Placement:
    """Position, size and orientation of a grid in its scene.

    Attributes:
        voxel_size: edge of a cell, in the scene's unit of length.
        corner: (X, Y, Z) of the centre of the grid's lowest cell, in the axes of the scene.
        up: the axis of the scene that points up, "y" or "z".
    """

    voxel_size: float = 1.0
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0)
    up: str = "z"
