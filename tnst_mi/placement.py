"""Where a grid lies in the scene that it came from, so that results can be put back into it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Placement:
    """Position, size and orientation of a grid in its scene.

    Attributes:
        voxel_size: edge of a cell, in the scene's unit of length.
        corner: (X, Y, Z) of the grid's lowest corner, in the axes of the scene.
        up: the axis of the scene that points up, "y" or "z".
    """

    voxel_size: float = 1.0
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0)
    up: str = "z"

    def with_up(self, up: str, shape: tuple[int, ...]) -> Placement:
        """The same place in a scene with another axis up; `shape` is that of the grid, (D, H, W) with y up."""
        if up == self.up:
            return self
        first, second, third = self.corner
        # z = −Y: the lowest corner along one of the two is the highest along the other.
        edge = shape[0] * self.voxel_size
        corner = (first, third, -(second + edge)) if up == "y" else (first, -(third + edge), second)
        return Placement(self.voxel_size, corner, up)
