"""The masks of all targets of a run, evaluated frame by frame on the grid of the densities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.frame import Frame
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.region_keys import form_of
from tnst_mi.recipe.targets import Part, Target, part_at, table_of, targets_of
from tnst_mi.regions.following import FollowingMask
from tnst_mi.regions.projection import Painting, painted, projected
from tnst_mi.regions.shapes import shape_mask
from tnst_mi.regions.stored import MaskFiles, checked_grid, input_grid, suggested_range
from tnst_mi.rendering.driving import image_size


class Regions:
    """The masks of the targets of a recipe.

    Args:
        targets: of the recipe.
        frames: the frames, with velocities in cells per frame.
        files: the same frames as they are stored, whose grids masks may name.
        numbers: of the frames.
    """

    def __init__(
        self,
        targets: Sequence[Target],
        frames: Sequence[Frame],
        files: Sequence[Frame],
        numbers: Sequence[int | float | None],
    ) -> None:
        self._targets, self._frames, self._files, self._numbers = targets, frames, files, numbers
        self._pictures: dict[str, Painting] = {}
        self._mask_files: dict[tuple[str, str | None], MaskFiles] = {}
        #: By the name of a stored grid without a range, its least and its largest value.
        self._spans: dict[str, tuple[float, float]] = {}
        #: By target and part.
        self._following: dict[tuple[int, int], FollowingMask] = {}

    @property
    def present(self) -> list[bool]:
        """For each target, whether it has a mask."""
        return [bool(target.mask) for target in self._targets]

    @property
    def notes(self) -> list[str]:
        """What is to be said of the masks that have been evaluated."""
        of_grids = [
            f"mask: {name} has values up to {largest:.4g}; above 1 they count as 1; {suggested_range(least, largest)}"
            for name, (least, largest) in self._spans.items()
            if largest > 1
        ]
        return of_grids + [f"mask: {painting.remark}" for painting in self._pictures.values() if painting.remark]

    @property
    def bounded(self) -> bool:
        """Whether all targets have masks, so that there is smoke that none of them changes."""
        return all(self.present)

    def is_black(self, picture: str) -> bool:
        """Whether nothing counts in a painted picture, by its path, that has been evaluated."""
        return not self._pictures[picture].values.any()

    def masks(self, index: int, frame: Frame) -> tuple[np.ndarray | None, ...]:
        """The mask of each target in a frame: (D, H, W) float32 in [0, 1], or None where it is 1 everywhere.

        Args:
            index: the place of the frame in the sequence.
            frame: the frame.

        Raises:
            InputError: a mask cannot be read or does not fit the frame.
        """
        return tuple(self._mask(number, target, index, frame) for number, target in enumerate(self._targets))

    def outside(self, index: int, frame: Frame) -> bool:
        """Whether a frame has no smoke in any of its masks, so that nothing of it changes; see `masks`."""
        return not any(mask is None or (mask * frame.density).any() for mask in self.masks(index, frame))

    def _mask(self, number: int, target: Target, index: int, frame: Frame) -> np.ndarray | None:
        product = None
        for place, part in enumerate(target.mask):
            try:
                values = self._part((number, place), part, index, frame)
            except InputError as error:
                raise InputError(f"{target.name}: {error}") from None
            product = values if product is None else product * values
        return product

    def _part(self, key: tuple[int, int], part: Part, index: int, frame: Frame) -> np.ndarray:
        table = table_of(part)
        follow: bool | int = table.get("follow", False)
        now = part_at(table, self._numbers[index])
        # What is painted or shaped moves; how much it counts is that of the frame itself.
        shape = self._standing(now, index, frame) if follow is False else self._moved(key, table, follow, index)
        if now.get("invert", False):
            shape = 1 - shape
        return shape * np.float32(now["strength"]) if "strength" in now else shape

    def _moved(self, key: tuple[int, int], table: Mapping[str, Any], follow: bool | int, index: int) -> np.ndarray:
        """The mask of the frame that `follow` names, moved with the smoke to another."""
        if key not in self._following:
            if follow is not True and follow not in self._numbers:
                raise InputError(f"follow = {follow}: there is no such frame, expected one of the run")
            first = 0 if follow is True else self._numbers.index(follow)
            start = self._standing(part_at(table, self._numbers[first]), first, self._frames[first])
            self._following[key] = FollowingMask(start, first, self._frames, self._numbers)
        return self._following[key].at(index)

    def _standing(self, part: Mapping[str, Any], index: int, frame: Frame) -> np.ndarray:
        """A mask in a frame where it stands, without its strength."""
        shape, form = frame.density.shape, form_of(part)
        if form == "everywhere":
            return np.ones(shape, np.float32)
        if form == "grid":
            return self._checked(input_grid(self._files, index, part["grid"]), shape, part, f"grid {part['grid']!r}")
        if form == "file":
            key = part["file"], part.get("grid")
            if key not in self._mask_files:
                self._mask_files[key] = MaskFiles(*key, self._files, self._numbers)
            return self._checked(self._mask_files[key].at(index), shape, part, part["file"])
        if form == "image":
            size = image_size(self._targets[0].recipe, shape)
            if part["image"] not in self._pictures:
                self._pictures[part["image"]] = painted(part["image"], size)
            return projected(self._pictures[part["image"]].values, part["view"], shape, size)
        return shape_mask(form, part, shape, frame.placement)

    def _checked(self, values: np.ndarray, shape: Shape, part: Mapping[str, Any], name: str) -> np.ndarray:
        """A stored grid as a mask; without a range, the values that it has are noted."""
        bounds = part.get("range")
        mask = checked_grid(values, shape, name, bounds)
        if bounds is None:
            least, largest = float(values.min()), float(values.max())
            before = self._spans.get(name, (least, largest))
            self._spans[name] = min(least, before[0]), max(largest, before[1])
        return mask


def regions_of(
    recipe: Recipe,
    frames: Sequence[Frame],
    numbers: Sequence[int | float | None],
    files: Sequence[Frame] | None = None,
) -> Regions | None:
    """The regions of a recipe; None if it has neither masks nor targets of its own.

    Args:
        recipe: with absolute paths.
        frames: the frames, with velocities in cells per frame.
        numbers: of the frames.
        files: the same frames as they are stored, whose grids masks may name; None if they are `frames`.

    Raises:
        InputError: it has targets beside goals or a mask of its own.
    """
    targets = targets_of(recipe)
    if not any(target.mask or target.number for target in targets):
        return None
    return Regions(targets, frames, frames if files is None else files, numbers)
