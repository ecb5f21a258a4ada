"""What is opened, as it is shown: from any side, with its masks and its movement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.reopened import Reopened
from tnst_mi.studio.source import Source
from tnst_mi.studio.view.lit import LitPainter
from tnst_mi.studio.view.opened import Opened
from tnst_mi.studio.view.painting import SightPainter
from tnst_mi.studio.view.sight import Sight


@dataclass(frozen=True, eq=False)
class Shown:
    """What is opened.

    Attributes:
        painter, lit: paint it.
        source: the input that is stylized: what is opened, or what the opened run has stylized; None if that was no
            file.
    """

    painter: SightPainter
    lit: LitPainter
    source: Source | None

    @classmethod
    def of(cls, found: Opened) -> Shown:
        """What has been opened."""
        return cls(SightPainter(found), LitPainter(found), Source.of(found.results))

    @property
    def results(self) -> Reopened:
        """What was read of it."""
        return self.painter.opened.results

    def paint(self, query: Mapping[str, str], recipe: Recipe) -> tuple[Sight, np.ndarray]:
        """What a tab wants to see, by the query of `Sight.of_query`, and its picture with values in [0, 1].

        Raises:
            InputError: it cannot be seen so.
        """
        sight = Sight.of_query(query, len(self.results.frames))
        return sight, self.lit.paint(sight) if sight.lit else self.painter.paint(sight, recipe)

    def arrows(self, query: Mapping[str, str]) -> dict[str, Any]:
        """v* as arrows in the picture of a query, as values for JSON; see `SightPainter.arrows`.

        Raises:
            InputError: it has no v*.
        """
        return self.painter.arrows(Sight.of_query(query, len(self.results.frames))).described()

    def place(self, frame: int) -> dict[str, Any]:
        """Where a frame, by its index, lies in the scene; see `MaskOverlay.place`."""
        return self.painter.masks.place(self.painter.index(frame))

    def share(self, recipe: Recipe, target: int, frame: int) -> float | None:
        """The part of the smoke of a frame, by its index, that is in the mask of a target; see `MaskOverlay.share`."""
        return self.painter.masks.share(recipe, target, self.painter.index(frame))
