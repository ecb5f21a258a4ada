"""Lit pictures of the view: path traced in the studio of a look, and less noisy each time they are asked for again."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.pictures.png import srgb
from tnst_mi.io.pictures.srgb import linear_of
from tnst_mi.machine.turns import turn
from tnst_mi.rendering.studio import Smoke, Studio
from tnst_mi.studio.view.opened import AFTER, BEFORE, Opened
from tnst_mi.studio.view.sight import AS_SEEN, Sight

#: Pictures whose paths are kept: both sides of a wipe.
_KEPT = 2

#: Paths per pixel beyond which a picture is as good as it gets.
_MOST_PATHS = 128


@dataclass
class _Paths:
    """The sum of some pictures (rows, columns, 3) of one path per pixel each, and their number."""

    total: np.ndarray
    count: int = 0


class LitPainter:
    """Paints what is opened in the light of a studio.

    Args:
        opened: an input or a run.
    """

    def __init__(self, opened: Opened) -> None:
        self.opened = opened
        self._studio: tuple[tuple[object, ...], Studio] | None = None
        self._paths: OrderedDict[Sight, _Paths] = OrderedDict()

    def paint(self, sight: Sight) -> np.ndarray:
        """A picture (rows, columns, 3), values for the display in [0, 1], of one path per pixel more than before.

        Raises:
            InputError: it is of no look, or of something else than one side of a frame; the camera is below the ground
                or inside the smoke; or a file cannot be read.
        """
        if sight.look == AS_SEEN or sight.mode not in (BEFORE, AFTER) or sight.cut:
            raise InputError("view: one side of a frame is lit, in one of the looks, and uncut")
        grid = self.opened.frame(sight.mode, sight.frame).full
        # Temperatures that are shown as colours are those of what glows, and no albedo.
        tinted = sight.coloured and self.opened.coloured and self.opened.results.temperature is None
        colour = linear_of(grid.colour) if tinted and grid.colour is not None else None
        with turn():
            paths = self._paths.setdefault(sight, _Paths(np.zeros((sight.rows, sight.columns, 3))))
            self._paths.move_to_end(sight)
            while len(self._paths) > _KEPT:
                self._paths.popitem(last=False)
            if paths.count < _MOST_PATHS:
                studio = self._studio_of(sight, grid.density, tinted)
                paths.total += studio.render(grid.density, sight.camera, 1, (0, paths.count), colour=colour)
                paths.count += 1
            return srgb(paths.total / paths.count)

    def _studio_of(self, sight: Sight, density: np.ndarray, coloured: bool) -> Studio:
        """The studio for pictures of a size; loaded anew if the frame has denser smoke than those before."""
        largest = float(density.max())
        key = sight.look, sight.rows, sight.columns, coloured
        if self._studio is None or self._studio[0] != key or self._studio[1].smoke.largest < largest:
            known = 0.0 if self._studio is None else self._studio[1].smoke.largest
            # All of the grid counts as occupied: Mitsuba does not free all memory of a scene, so that it must not
            # depend on the frame.
            d, h, w = density.shape
            smoke = Smoke((d, h, w), max(largest, known), (slice(0, d), slice(0, h), slice(0, w)))
            size = sight.columns, sight.rows
            self._studio = key, Studio(sight.look, "volpath", smoke, [sight.camera], size, coloured=coloured)
        return self._studio[1]
