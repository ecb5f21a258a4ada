"""What a process has to know to compute a run: names and numbers, so that it can be sent to another machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tnst_mi.frame import Frame
from tnst_mi.optimisation.plan import Plan
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.inputs import ScaledFrames, UnchangedFrames
from tnst_mi.run.measure import Measure


@dataclass(frozen=True)
class Work:
    """The work of a run.

    Attributes:
        recipe: with all paths absolute.
        frames: the input.
        step: how far the frames are apart, 2 for every second one; see `moving`.
        measures: measurements of each frame.
        plan: of the optimisation.
        cache_bytes: memory that a process may take besides, see `run.memory.cache_bytes`.
        out: the folder of the results, or None.
        suffix: file suffix of the results, of the recipe's format or else of the input's, if that can be written.
        context: indices of frames that are stylized for the sake of their neighbours, and have no results.
    """

    recipe: Recipe
    frames: Sequence[Frame]
    step: int | float
    measures: Sequence[Measure]
    plan: Plan
    cache_bytes: int
    out: Path | None
    suffix: str
    context: frozenset[int]

    @property
    def unchanged(self) -> Sequence[Frame]:
        """The frames, each of them checked on access to be what it was when it was measured."""
        return UnchangedFrames(self.frames, [measure.sha256 for measure in self.measures])

    @property
    def moving(self) -> Sequence[Frame]:
        """The same with velocities that lead from each to the next, which may not be the next of the simulation."""
        return self.unchanged if self.step == 1 else ScaledFrames(self.unchanged, velocity_factor=self.step)

    @property
    def wanted(self) -> list[int]:
        """The indices of the frames that have results."""
        return [index for index in range(len(self.measures)) if index not in self.context]

    @property
    def names(self) -> list[str]:
        """Of the frames."""
        return [measure.name for measure in self.measures]
