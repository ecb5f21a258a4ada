"""One frame of a smoke simulation: the input arrays, validated once, on construction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tnst_mi.errors import InputError


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


@dataclass(frozen=True, eq=False)
class Frame:
    """A density grid with its velocity, obstacles, name and placement.

    Grids are indexed (z, y, x) with y up and values at cell centres; a 2-D grid has D = 1.

    Attributes:
        density: (D, H, W) float32, finite, not negative.
        velocity: (D, H, W, 3) float32, components (x, y, z) in cells per frame, or None.
        obstacle: (D, H, W) bool, True inside solid objects, or None.
        name: names the output files.
        number: the frame's number in its sequence, a float for a sub-frame such as 1.5, or None.
        placement: where the grid lies in the scene it came from, or None if unknown.

    Raises:
        InputError: an array has another shape, is empty, or holds values that no simulation produces.

    Example:
        >>> import numpy as np
        >>> import tnst_mi
        >>> frame = tnst_mi.Frame(np.full((2, 3, 4), 0.5), name="smoke_0008", number=8)
        >>> frame.density.dtype, frame.mass
        (dtype('float32'), 12.0)
        >>> tnst_mi.Frame(np.full((2, 3, 4), -0.5))
        Traceback (most recent call last):
        tnst_mi.errors.InputError: frame: density has 24 negative values (smallest -0.5), expected values of 0 or more
    """

    density: np.ndarray
    velocity: np.ndarray | None = None
    obstacle: np.ndarray | None = None
    name: str = "frame"
    number: int | float | None = None
    placement: Placement | None = None

    def __post_init__(self) -> None:
        """Check the arrays and convert them to the types of the attributes."""
        density = self._numbers("density", self.density)
        if density.ndim != 3:
            raise InputError(
                f"{self.name}: density has shape {density.shape}, expected (D, H, W); a 2-D grid has D = 1"
            )
        if density.size == 0:
            raise InputError(f"{self.name}: density has shape {density.shape}, expected at least one cell")
        self._require_finite("density", density)
        if density.min() < 0.0:
            raise InputError(
                f"{self.name}: density has {int((density < 0.0).sum())} negative values "
                f"(smallest {density.min():g}), expected values of 0 or more"
            )
        object.__setattr__(self, "density", density)
        if self.velocity is not None:
            velocity = self._numbers("velocity", self.velocity)
            if velocity.shape != (*density.shape, 3):
                raise InputError(
                    f"{self.name}: velocity has shape {velocity.shape}, expected {(*density.shape, 3)} "
                    f"to fit the density"
                )
            self._require_finite("velocity", velocity)
            object.__setattr__(self, "velocity", velocity)
        if self.obstacle is not None:
            object.__setattr__(self, "obstacle", self._checked_obstacle(density.shape))

    @property
    def mass(self) -> float:
        """Sum of the density over all cells."""
        return float(self.density.sum(dtype=np.float64))

    def _numbers(self, key: str, values: object) -> np.ndarray:
        array = np.asarray(values)
        if array.dtype.kind not in "fiub":
            raise InputError(f"{self.name}: {key} has type {array.dtype}, expected numbers")
        # Values that overflow float32 become infinite here and are reported as such.
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(array, dtype=np.float32)

    def _require_finite(self, key: str, array: np.ndarray) -> None:
        bad = array.size - int(np.isfinite(array).sum())
        if bad:
            raise InputError(f"{self.name}: {key} has {bad} NaN or infinite values, expected finite numbers")

    def _checked_obstacle(self, shape: tuple[int, ...]) -> np.ndarray:
        obstacle = np.asarray(self.obstacle)
        if obstacle.shape != shape:
            raise InputError(f"{self.name}: obstacle has shape {obstacle.shape}, expected {shape} to fit the density")
        if obstacle.dtype.kind not in "fiub" or not np.isin(obstacle, (0, 1)).all():
            raise InputError(f"{self.name}: obstacle has values besides 0 and 1, expected a mask of 0 and 1")
        return np.ascontiguousarray(obstacle, dtype=bool)
