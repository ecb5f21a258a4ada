"""One frame of a smoke simulation: the input arrays, validated once, on construction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.geometry.other_grids import OtherGrids
from tnst_mi.geometry.placement import Placement
from tnst_mi.machine.notebook_display import NotebookDisplay

__all__ = ["Frame", "Note", "Placement"]

#: Share of the largest density up to which a cell counts as one without smoke, and a negative density as noise.
_NOISE = 1e-6


@dataclass(frozen=True)
class Note:
    """What was assumed or mended when a frame was read, to be said to the user.

    Attributes:
        text: the same words for all frames that it is true of.
        detail: what differs between them, such as numbers; may be empty.
    """

    text: str
    detail: str = ""


@dataclass(frozen=True, eq=False)
class Frame(NotebookDisplay):
    """A density grid with its velocity, obstacles, other grids, name and placement.

    Two faults that simulations leave in their files are mended, with a note: negative densities down to 1e-6 of the
    largest density, which are rounding errors, become 0; so do velocities that are no numbers in cells without smoke
    (at most 1e-6 of the largest density), where they do not matter.

    Grids are indexed (z, y, x) with y up and values at cell centres; a 2-D grid has D = 1. A notebook shows the main
    view and what is in the frame.

    Attributes:
        density: (D, H, W) float32, finite, not negative.
        velocity: (D, H, W, 3) float32, components (x, y, z) in cells per frame, or None.
        obstacle: (D, H, W) bool, True inside solid objects, or None.
        name: names the output files.
        number: the frame's number in its sequence, a float for a sub-frame such as 1.5, or None.
        placement: where the grid lies in the scene it came from, or None if unknown.
        reading: how it was read from its file, in words; empty for frames made from arrays.
        notes: what was assumed or mended.
        grids: every other grid by its name, such as temperature: (D, H, W) or (D, H, W, 3) of any type of number. Of a
            frame from a file, each access reads the grid from there, so that a sequence does not hold them all.

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
        tnst_mi.errors.InputError: frame: density has 24 negative values (smallest -0.5 at (z, y, x) = (0, 0, 0)), \
expected values of 0 or more; set them to 0, or choose another grid (--density NAME)
    """

    density: np.ndarray
    velocity: np.ndarray | None = None
    obstacle: np.ndarray | None = None
    name: str = "frame"
    number: int | float | None = None
    placement: Placement | None = None
    reading: str = ""
    notes: tuple[Note, ...] = ()
    grids: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the arrays and convert them to the types of the attributes."""
        density = self._numbers("density", self.density)
        if density.ndim != 3:
            raise InputError(
                f"{self.name}: density has shape {density.shape}, expected (D, H, W); a 2-D grid has D = 1"
            )
        if density.size == 0:
            raise InputError(f"{self.name}: density has shape {density.shape}, expected at least one cell")
        self._require_finite("density", density, "set them to 0, or choose another grid (--density NAME)")
        object.__setattr__(self, "density", self._without_noise(density))
        if self.velocity is not None:
            velocity = self._numbers("velocity", self.velocity)
            if velocity.shape != (*density.shape, 3):
                raise InputError(
                    f"{self.name}: velocity has shape {velocity.shape}, expected {(*density.shape, 3)} "
                    f"to fit the density"
                )
            if not np.isfinite(velocity).all():
                velocity = self._numbers_in_smoke(velocity)
            object.__setattr__(self, "velocity", velocity)
        if self.obstacle is not None:
            object.__setattr__(self, "obstacle", self._checked_obstacle(density.shape))
        object.__setattr__(self, "grids", self._checked_grids(density.shape))

    @property
    def other_grids(self) -> OtherGrids:
        """`grids`, with what is known of them besides their values."""
        return self._checked_grids(self.density.shape)

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

    def _require_finite(self, key: str, array: np.ndarray, remedy: str) -> None:
        finite = np.isfinite(array)
        bad = array.size - int(finite.sum())
        if bad:
            raise InputError(
                f"{self.name}: {key} has {bad} NaN or infinite values (the first {_place(~finite)}), "
                f"expected finite numbers; {remedy}"
            )

    def _without_noise(self, density: np.ndarray) -> np.ndarray:
        """The density with rounding errors below 0 set to 0.

        Raises:
            InputError: some of it is really negative.
        """
        smallest = float(density.min())
        if smallest >= 0.0:
            return density
        negative = density < 0.0
        count = int(negative.sum())
        if smallest < -_NOISE * float(density.max()):
            raise InputError(
                f"{self.name}: density has {count} negative values "
                f"(smallest {smallest:g} {_place(density == density.min())}), expected values of 0 or more; "
                "set them to 0, or choose another grid (--density NAME)"
            )
        self._note(Note("negative noise in the density is taken as 0", f"{_cells(count)} down to {smallest:g}"))
        return np.where(negative, np.float32(0.0), density)

    def _numbers_in_smoke(self, velocity: np.ndarray) -> np.ndarray:
        """A velocity with 0 for what is no number in cells without smoke.

        Raises:
            InputError: some of it is no number in smoke.
        """
        bad = ~np.isfinite(velocity).all(axis=-1) & (self.density <= _NOISE * float(self.density.max()))
        mended = np.where(bad[..., None], np.float32(0.0), velocity)
        self._require_finite("velocity", mended, "set them to 0, or go without (--velocity none)")
        self._note(Note("velocities without smoke that are no numbers are taken as 0", _cells(int(bad.sum()))))
        return mended

    def _checked_grids(self, shape: tuple[int, ...]) -> OtherGrids:
        if not isinstance(self.grids, OtherGrids):
            return OtherGrids.of_arrays(self.grids, shape, self.name)
        if self.grids and self.grids.cells != shape:
            raise InputError(f"{self.name}: grids have {self.grids.cells} cells, expected {shape} to fit the density")
        return self.grids

    def _note(self, note: Note) -> None:
        object.__setattr__(self, "notes", (*self.notes, note))

    def _checked_obstacle(self, shape: tuple[int, ...]) -> np.ndarray:
        obstacle = np.asarray(self.obstacle)
        if obstacle.shape != shape:
            raise InputError(f"{self.name}: obstacle has shape {obstacle.shape}, expected {shape} to fit the density")
        if obstacle.dtype.kind not in "fiub" or not np.isin(obstacle, (0, 1)).all():
            raise InputError(f"{self.name}: obstacle has values besides 0 and 1, expected a mask of 0 and 1")
        return np.ascontiguousarray(obstacle, dtype=bool)


def _place(cells: np.ndarray) -> str:
    """The first of some marked cells of a grid (D, H, W) or (D, H, W, 3), in words."""
    z, y, x = np.argwhere(cells)[0][:3].tolist()
    return f"at (z, y, x) = ({z}, {y}, {x})"


def _cells(count: int) -> str:
    return "1 cell" if count == 1 else f"{count} cells"
