"""What files leave open: names, the up axis, the units of density and velocity, the duration of a frame, places."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame, Note, Placement
from tnst_mi.geometry.other_grids import OtherGrids
from tnst_mi.geometry.placement import FileSource, OwnVoxels
from tnst_mi.io.interpretation.grid_names import listed
from tnst_mi.io.interpretation.roles import Wanted
from tnst_mi.io.interpretation.staggered import centred_velocity, velocity_of_all_faces
from tnst_mi.io.interpretation.stored_grids import Axes, StoredGrid

#: Units of velocities in files: cells per frame; cells, or scene units of length, per unit of time.
CELLS_PER_FRAME, CELLS_PER_TIME, LENGTH_PER_TIME = "cells-per-frame", "cells-per-time", "length-per-time"
VELOCITY_UNITS = (CELLS_PER_FRAME, CELLS_PER_TIME, LENGTH_PER_TIME)

#: Usual time units per frame: Mantaflow's in Blender, which are proportional to the frame's duration; seconds.
MANTAFLOW_TIME_STEP, MANTAFLOW_RATE, SECONDS_PER_FRAME = 0.1, 25.0, 1.0 / 24.0


#: The note on a frame of a sequence whose file has no density.
WITHOUT_SMOKE = "has no density, so it is taken as a frame without smoke"


@dataclass(frozen=True)
class Boxing:
    """Which part of sparse grids is read.

    Attributes:
        crop: whether it is cropped to the smoke, and may move with it, where that halves the number of cells.
        ignore_stray: whether voxels far from the smoke, with next to none of its mass, are left out.
    """

    crop: bool = False
    ignore_stray: bool = False


@dataclass(frozen=True)
class Conventions:
    """The user's overrides for what files declare or their format implies; None overrides nothing.

    Attributes:
        up: the axis that points up, "y" or "z".
        flip: our axes to mirror, any of "x", "y" and "z".
        velocity_units: one of VELOCITY_UNITS.
        dt: duration of a frame, in the unit of time of the velocities.
        fps: frames per second, from which the duration of a frame follows if `dt` is None.
        voxel_size: edge of a cell, in the unit of length of the scene.
        scale: factor of the densities.
        origin: (X, Y, Z) in the scene of the origin of the files' coordinates, which is added to where grids lie.
        names: of the grids.
        box: which part of sparse grids is read.
        fog: whether the inside of a level set is its density.
    """

    up: str | None = None
    flip: str = ""
    velocity_units: str | None = None
    dt: float | None = None
    fps: float | None = None
    voxel_size: float | None = None
    scale: float | None = None
    origin: tuple[float, float, float] | None = None
    names: Wanted = field(default_factory=Wanted)
    box: Boxing = field(default_factory=Boxing)
    fog: bool = False


@dataclass(frozen=True)
class Taken:
    """What a file's grids were taken for, by name; None for what is not there.

    Attributes:
        density: the name of the density's grid.
        velocity: that of the velocity's, or of its components.
        obstacle: that of the obstacle's.
        others: the names of the other grids, those that results can have again.
        left: the names of what is left, which are not read.
        like_velocity: where there is no velocity, those of both that may be one by another name.
    """

    density: str | None = None
    velocity: str | None = None
    obstacle: str | None = None
    others: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    like_velocity: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class StoredFrame:
    """The arrays of a frame as stored in its file, and the conventions that the file declares.

    Attributes:
        density: (D, H, W) in the axes of the file, or None.
        velocity: (D, H, W, 3), or None.
        obstacle: (D, H, W), or None.
        staggered: whether component c of the velocity lies on the lower face of each cell along axis c. Then it may
            have one entry more along each axis, for the upper faces of the last cells.
        from_faces: whether the velocity was on the faces of voxels that are not the cells, and has been brought to the
            centres of the cells.
        known: (D, H, W) bool, the cells whose velocities are stored; None for all, or where it makes no difference.
        up: the up axis of the file.
        up_because: the evidence for it, in words; empty if the format says it.
        scene_up: the up axis of the scene that the grid is placed in, for formats without a scene; else None.
        velocity_units: one of VELOCITY_UNITS.
        dt: duration of a frame in the velocity's unit of time; None for the usual one of its unit.
        voxel_size: edge of a cell in the scene, or None if the file does not give it.
        velocity_cell: edge of the cells that velocities are counted in, in cells of the grid.
        drift: by how many cells per frame (X, Y, Z) the grid moves in its scene until the next frame; None if it rests.
        corner: centre of the grid's lowest cell in the scene.
        own: the voxels of the file, to which results return; None if it has none.
        source: what else results keep of the file, or None.
        scale: factor of the density, unless the user gives another.
        grids: the other grids, by name.
        taken: names of the grids.
        layouts: in which other ways than the usual ones its arrays are stored, in words.
        notes: what else was assumed.
        lacking: the error message if there is no density.
    """

    density: np.ndarray | None
    velocity: np.ndarray | None = None
    obstacle: np.ndarray | None = None
    staggered: bool = False
    from_faces: bool = False
    known: np.ndarray | None = None
    up: str = "y"
    up_because: str = ""
    scene_up: str | None = None
    velocity_units: str = CELLS_PER_FRAME
    dt: float | None = None
    voxel_size: float | None = None
    velocity_cell: float = 1.0
    drift: np.ndarray | None = None
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0)
    own: OwnVoxels | None = None
    source: FileSource | None = None
    scale: float = 1.0
    grids: Mapping[str, StoredGrid] = field(default_factory=dict)
    taken: Taken = field(default_factory=Taken)
    layouts: tuple[str, ...] = ()
    notes: tuple[Note, ...] = ()
    lacking: str = "no density"

    def frame(self, given: Conventions, name: str, number: int | float | None) -> Frame:
        """The frame in our axes and units.

        Raises:
            InputError: there is no density, an array cannot be used, or the size of a cell is needed but unknown.
        """
        density = self.scaled_density(given)
        notes = self.notes if self.notes or density.any() else (Note("no smoke in it"),)
        if self.velocity is None and self.taken.like_velocity:
            names = listed(list(self.taken.like_velocity))
            notes = (*notes, Note(f"looks like a velocity, which --velocity NAME takes it for: {names}"))
        obstacle = None if self.obstacle is None else self._turned(self.obstacle, given)
        velocity, placement = self.centred_velocity(given), self._placement(given)
        axes = Axes(given.up or self.up, given.flip)
        grids = OtherGrids({key: grid.reader(axes) for key, grid in self.grids.items()}, density.shape, name)
        return Frame(density, velocity, obstacle, name, number, placement, self.reading(given), notes, grids)

    def scaled_density(self, given: Conventions) -> np.ndarray:
        """The density (D, H, W) in our axes, times its factor; not checked.

        Raises:
            InputError: there is none.
        """
        if self.density is None:
            raise InputError(self.lacking)
        scale = self.scale if given.scale is None else given.scale
        density = self._turned(self.density, given)
        if scale == 1.0:
            return density
        with np.errstate(over="ignore"):  # Frame rejects what becomes infinite
            return density.astype(np.float32) * np.float32(scale)

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
            centres = self._centres(self.velocity)
            centres = centres if factor == 1.0 else centres * np.float32(factor)
            return self._turned(centres if self.drift is None else self._relative(centres, self.drift), given)

    def frame_duration(self, given: Conventions) -> float | None:
        """The duration of a frame in the velocity's unit of time; None if this is not one of time."""
        return None if self.velocity_units == CELLS_PER_FRAME else self._units(replace(given, velocity_units=None))[1]

    def reading(self, given: Conventions) -> str:
        """How the file is read, in words: axes and units, which grid is what, and what follows from the layout."""
        axes = f"{given.up or self.up} up"
        if self.up_because and given.up is None:
            axes += f" ({self.up_because}; --up)"
        words = [axes]
        if self.velocity is not None:
            units, dt = self._units(given)
            place = "on faces" if self.staggered else "at centres"
            place = "on the faces of its own voxels, brought to the cells," if self.from_faces else place
            words.append(f"velocity {place} in {units}")
            words += [] if dt is None else [f"{dt:.4g} time units per frame"]
        size = given.voxel_size or self.voxel_size
        words += [] if size is None else [f"voxel size {size:g}"]
        if self.density is not None and self.density.dtype.kind in "iu" and given.scale is None:
            kind = self.density.dtype.name
            if self.scale != 1.0:
                words.append(f"density times 1/{1.0 / self.scale:.0f} ({kind}, as in pictures; --scale)")
            else:
                words.append(f"density as stored ({kind}; --scale)")
        taken = [
            f"no {role}" if name is None else f"{role} from {name}"
            for role, name in (
                ("density", self.taken.density),
                ("velocity", self.taken.velocity),
                ("obstacle", self.taken.obstacle),
            )
        ]
        others, left = (
            [f"{words}: {listed(list(names), in_quotes=False)}"] if names else []
            for words, names in (("other grids", self.taken.others), ("not read", self.taken.left))
        )
        return "; ".join([", ".join(words), ", ".join(taken), *self.layouts, *others, *left])

    def _centres(self, velocity: np.ndarray) -> np.ndarray:
        if not self.staggered:
            return velocity
        if self.density is not None and velocity.shape[:3] == tuple(extent + 1 for extent in self.density.shape):
            return velocity_of_all_faces(velocity)
        return centred_velocity(velocity, self.known)

    def _relative(self, centres: np.ndarray, drift: np.ndarray) -> np.ndarray:
        """Velocities relative to the grid, which follows the smoke: where none is known, that of all smoke."""
        relative = centres - drift.astype(np.float32)
        if self.known is None or self.density is None:
            return relative
        smoke = self.known & (self.density > 0) & np.isfinite(relative).all(axis=-1)
        average = np.zeros(3)
        if smoke.any():
            average = np.average(relative[smoke], axis=0, weights=self.density[smoke].astype(np.float64))
        return np.where(self.known[..., None], relative, average.astype(np.float32))

    def _turned(self, array: np.ndarray, given: Conventions) -> np.ndarray:
        if array.ndim < 3:  # wrong shape: Frame reports it
            return array
        return Axes(given.up or self.up, given.flip).turned(array)

    def _units(self, given: Conventions) -> tuple[str, float | None]:
        """The unit of the velocity, and the duration of a frame in its unit of time if it has one, else None."""
        units = given.velocity_units or self.velocity_units
        if units == CELLS_PER_FRAME:
            if given.dt is not None:
                raise InputError(f"velocity is in {units}, which --dt does not change; give --units too")
            return units, None
        if given.dt is not None:
            return units, given.dt
        if units == self.velocity_units and self.dt is not None:
            return units, self.dt
        if units == CELLS_PER_TIME:
            return units, MANTAFLOW_TIME_STEP * (1.0 if given.fps is None else MANTAFLOW_RATE / given.fps)
        return units, SECONDS_PER_FRAME if given.fps is None else 1.0 / given.fps

    def _cells_per_frame(self, given: Conventions) -> float:
        """The factor from the stored velocity to cells per frame."""
        units, dt = self._units(given)
        if dt is None:
            return self.velocity_cell
        if units == CELLS_PER_TIME:
            return dt * self.velocity_cell
        size = given.voxel_size or self.voxel_size
        if size is None:
            raise InputError(f"velocity in {units} needs the size of a cell, which the file lacks; give --voxel-size")
        return dt / size

    def _placement(self, given: Conventions) -> Placement | None:
        size = given.voxel_size or self.voxel_size
        if size is None:
            return None
        drift = None
        if self.drift is not None:
            x, y, z = self._turned(self.drift.reshape(1, 1, 1, 3), given).ravel().tolist()
            drift = x, y, z
        up = self.scene_up or given.up or self.up
        # A velocity in the file's own values keeps the unit that it is read in.
        units = given.velocity_units or self.velocity_units
        source = None if self.source is None else replace(self.source, velocity_units=units)
        placement = Placement(size, self.corner, up, self.own, source, drift)
        untrue = self.own is not None and self.own.placed is not None
        if given.flip or size != self.voxel_size or (untrue and given.voxel_size is not None):
            # Such a grid is another one than that of the file.
            placement = replace(placement, own=None)
        return placement if given.origin is None else placement.moved(given.origin)
