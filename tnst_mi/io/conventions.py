"""What files leave open: the up axis, the unit of the velocities, the duration of a frame, the size of a cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame, Placement
from tnst_mi.io.orientation import from_z_up, mirrored
from tnst_mi.io.staggered import centred_velocity

#: Units of velocities in files: cells per frame; cells, or scene units of length, per unit of time.
CELLS_PER_FRAME, CELLS_PER_TIME, LENGTH_PER_TIME = "cells-per-frame", "cells-per-time", "length-per-time"
VELOCITY_UNITS = (CELLS_PER_FRAME, CELLS_PER_TIME, LENGTH_PER_TIME)

#: Default time units per frame: Mantaflow's in Blender at 25 frames per second; seconds.
MANTAFLOW_TIME_STEP, SECONDS_PER_FRAME = 0.1, 1.0 / 24.0


@dataclass(frozen=True)
class Conventions:
    """The user's overrides for what files declare or their format implies; None overrides nothing.

    Attributes:
        up: the axis that points up, "y" or "z".
        flip: our axes to mirror, any of "x", "y" and "z".
        velocity_units: one of VELOCITY_UNITS.
        dt: duration of a frame, in the unit of time of the velocities.
        voxel_size: edge of a cell, in the unit of length of the scene.
    """

    up: str | None = None
    flip: str = ""
    velocity_units: str | None = None
    dt: float | None = None
    voxel_size: float | None = None


@dataclass(frozen=True, kw_only=True)
class StoredFrame:
    """The arrays of a frame as stored in its file, and the conventions that the file declares.

    Attributes:
        density: (D, H, W) in the axes of the file, or None.
        velocity: (D, H, W, 3), or None.
        obstacle: (D, H, W), or None.
        staggered: whether component c of the velocity lies on the lower face of each cell along axis c.
        known: (D, H, W) bool, the cells whose velocities are stored; None for all.
        up: the up axis of the file.
        scene_up: the up axis of the scene that the grid is placed in, for formats without a scene; else None.
        velocity_units: one of VELOCITY_UNITS.
        dt: duration of a frame in the velocity's unit of time; None for cells per frame.
        voxel_size: edge of a cell in the scene, or None if the file does not give it.
        corner: lowest corner of the grid in the scene.
        lacking: the error message if there is no density.
    """

    density: np.ndarray | None
    velocity: np.ndarray | None = None
    obstacle: np.ndarray | None = None
    staggered: bool = False
    known: np.ndarray | None = None
    up: str = "y"
    scene_up: str | None = None
    velocity_units: str = CELLS_PER_FRAME
    dt: float | None = None
    voxel_size: float | None = None
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lacking: str = "no density"

    def frame(self, given: Conventions, name: str, number: int | float | None) -> Frame:
        """The frame in our axes and units.

        Raises:
            InputError: there is no density, an array cannot be used, or the size of a cell is needed but unknown.
        """
        if self.density is None:
            raise InputError(self.lacking)
        density = self._turned(self.density, given)
        obstacle = None if self.obstacle is None else self._turned(self.obstacle, given)
        return Frame(density, self.centred_velocity(given), obstacle, name, number, self._placement(given))

    def centred_velocity(self, given: Conventions) -> np.ndarray | None:
        """The velocity (D, H, W, 3) at the cell centres, in our axes and cells per frame; None if there is none.

        Raises:
            InputError: it has another shape, or the size of a cell is needed but unknown, or a frame duration is given
                that its unit does not need.
        """
        if self.velocity is None:
            return None
        if self.velocity.ndim != 4 or self.velocity.shape[-1] != 3:
            expected = "(D, H, W, 3)" if self.density is None else (*self.density.shape, 3)
            raise InputError(f"velocity has shape {self.velocity.shape}, expected {expected}")
        factor = self._cells_per_frame(given)
        # Frame rejects values that are or become infinite or NaN here.
        with np.errstate(over="ignore", invalid="ignore"):
            centres = centred_velocity(self.velocity, self.known) if self.staggered else self.velocity
            return self._turned(centres if factor == 1.0 else centres * np.float32(factor), given)

    def reading(self, given: Conventions) -> str:
        """How the file is read, in words."""
        words = [f"{given.up or self.up} up"]
        if self.velocity is not None:
            units, dt = self._units(given)
            words.append(f"velocity {'on faces' if self.staggered else 'at centres'} in {units}")
            words += [] if dt is None else [f"{dt:g} time units per frame"]
        size = given.voxel_size or self.voxel_size
        return ", ".join([*words, *([] if size is None else [f"voxel size {size:g}"])])

    def _turned(self, array: np.ndarray, given: Conventions) -> np.ndarray:
        if array.ndim < 3:  # wrong shape: Frame reports it
            return array
        if (given.up or self.up) == "z":
            array = from_z_up(array)
        return mirrored(array, given.flip) if given.flip else array

    def _units(self, given: Conventions) -> tuple[str, float | None]:
        """The unit of the velocity, and the duration of a frame in its unit of time if it has one, else None."""
        units = given.velocity_units or self.velocity_units
        if units == CELLS_PER_FRAME:
            if given.dt is not None:
                raise InputError(f"velocity is in {units}, which --dt does not change; give --velocity-units too")
            return units, None
        if given.dt is not None:
            return units, given.dt
        if units == self.velocity_units:
            return units, self.dt
        return units, MANTAFLOW_TIME_STEP if units == CELLS_PER_TIME else SECONDS_PER_FRAME

    def _cells_per_frame(self, given: Conventions) -> float:
        """The factor from the stored velocity to cells per frame."""
        units, dt = self._units(given)
        if dt is None:
            return 1.0
        if units == CELLS_PER_TIME:
            return dt
        size = given.voxel_size or self.voxel_size
        if size is None:
            raise InputError(f"velocity in {units} needs the size of a cell, which the file lacks; give --voxel-size")
        return dt / size

    def _placement(self, given: Conventions) -> Placement | None:
        size = given.voxel_size or self.voxel_size
        if size is None:
            return None
        return Placement(size, self.corner, self.scene_up or given.up or self.up)
