"""Where the mask of a target is in the smoke of a frame, prepared for pictures from any side."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np

from tnst_mi.frame import Frame
from tnst_mi.machine.turns import turn
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.targets import Target
from tnst_mi.regions.regions import Regions
from tnst_mi.regions.shapes import smoke_extent
from tnst_mi.rendering.driving import image_size
from tnst_mi.studio.choices.masks import mask_tables
from tnst_mi.studio.view.opened import BEFORE, Opened, pooled

#: The colour of what is in a mask.
_COLOUR = np.array([1.0, 0.36, 0.26], np.float32)

#: Frames and sides whose masked smoke is kept: both sides of a wipe.
_KEPT = 2


@dataclass(frozen=True, eq=False)
class MaskedSmoke:
    """The smoke of a frame that is in a mask.

    Attributes:
        mask: (D, H, W) float32 in [0, 1].
        full, coarse: density times mask, float32, on both grids of a frame.
    """

    mask: np.ndarray
    full: np.ndarray
    coarse: np.ndarray


class MaskOverlay:
    """Evaluates the masks of recipes in the frames of what is opened.

    Args:
        opened: an input or a run. Masks are those of its input, on whose grid its results are, too.
    """

    def __init__(self, opened: Opened) -> None:
        self.opened = opened
        results = opened.results
        self._frames = results.frames if results.inputs is None else results.inputs
        self._frame: tuple[int, Frame] | None = None
        #: The latest mask: what it follows from, and its evaluation, which goes on from frame to frame.
        self._regions: tuple[str, Regions] | None = None
        self._smoke: OrderedDict[tuple[str, int, str], MaskedSmoke] = OrderedDict()
        self._evaluating = threading.RLock()

    def mask(self, recipe: Recipe, target: int, index: int) -> np.ndarray | None:
        """The mask of a target of a recipe, by its index, in a frame: (D, H, W) float32 in [0, 1].

        Returns:
            None if there is no such target, or it has no mask.

        Raises:
            InputError: the mask cannot be evaluated.
        """
        with self._evaluating:
            found = self._found(recipe, target)
            return None if found is None else self._evaluated(found[1], index)

    def smoke(self, recipe: Recipe, target: int, index: int, side: str) -> MaskedSmoke | None:
        """The smoke of a side of a frame that is in a mask; see `mask`."""
        with self._evaluating:
            if (found := self._found(recipe, target)) is None:
                return None
            if (key := (found[0], index, side)) not in self._smoke:
                mask = self._evaluated(found[1], index)
                grids = self.opened.frame(side, index)
                full = mask * grids.full.density
                coarse = full if grids.coarse is grids.full else pooled(full, round(grids.coarse.h))
                self._smoke[key] = MaskedSmoke(mask, full, coarse)
                while len(self._smoke) > _KEPT:
                    self._smoke.popitem(last=False)
            self._smoke.move_to_end(key)
            return self._smoke[key]

    def share(self, recipe: Recipe, target: int, index: int) -> float | None:
        """The part of the smoke of a frame, before, that is in the mask of a target, in [0, 1]; see `mask`."""
        masked = self.smoke(recipe, target, index, BEFORE)
        if masked is None:
            return None
        mass = float(self.opened.frame(BEFORE, index).full.density.sum(dtype=np.float64))
        return float(masked.full.sum(dtype=np.float64)) / mass if mass > 0 else 0.0

    def place(self, index: int) -> dict[str, list[list[float]] | None]:
        """Where a frame lies in the scene, in whose units masks are.

        Returns:
            "to_scene", the (3, 4) matrix from cells (x, y, z), the first of which is centred at 0, to the scene; and
            "smoke", the lowest and the highest coordinates in the scene of cells with smoke, None without any.
        """
        with self._evaluating:
            frame = self._at(index)
        density, placement = frame.density, frame.placement
        to_scene = np.eye(3, 4)
        if placement is not None:
            d, h, w = density.shape
            affine = placement.to_scene((d, h, w))
            to_scene = np.column_stack([affine.matrix, affine.offset])
        smoke = smoke_extent(density, placement)
        return {"to_scene": to_scene.tolist(), "smoke": None if smoke is None else smoke.tolist()}

    def _found(self, recipe: Recipe, target: int) -> tuple[str, Regions] | None:
        masks, results = mask_tables(recipe), self.opened.results
        if target >= len(masks) or not masks[target]:
            return None
        key = repr((target, masks[target], image_size(recipe, self.opened.shape)))
        if self._regions is None or self._regions[0] != key:
            alone = Target(recipe, tuple(masks[target]), number=target + 1 if recipe.target else 0)
            self._regions = key, Regions([alone], self._frames, self._frames, results.numbers)
        return self._regions

    def _evaluated(self, regions: Regions, index: int) -> np.ndarray:
        frame = self._at(index)
        with turn():  # masks that follow the smoke are moved on the device
            (mask,) = regions.masks(index, frame)
        assert mask is not None  # there are only regions where there is one
        return mask

    def _at(self, index: int) -> Frame:
        """A frame without what masks do not need of it here: those that do read it themselves."""
        if self._frame is None or self._frame[0] != index:
            read = self._frames[index]
            placement = None if read.placement is None else replace(read.placement, own=None, source=None)
            self._frame = index, Frame(read.density, name=read.name, number=read.number, placement=placement)
        return self._frame[1]


def tinted(picture: np.ndarray, share: np.ndarray) -> np.ndarray:
    """A picture, (rows, columns) or (rows, columns, 3), in the colour of masks in place of its own.

    As far as the share (rows, columns) in [0, 1] says.
    """
    if picture.ndim == 2:
        picture = picture[..., None]
    share = share[..., None]
    return (1 - share) * picture + share * picture.max(2, keepdims=True) * _COLOUR
