"""The time left of a run, whose octaves cost differently.

An iteration costs something that is the same in all octaves, something per pixel of its images (the network), and
something per cell of its grid. How much of each depends on the machine. As long as one octave has been timed, it is
taken to be in the proportions that were measured on one: on tiny grids nearly all is the first. Once two octaves
have been timed, what an iteration of a later one costs is bounded: from below by the mixture of the three with the most
of what grows slowly, from above by that with the most of what grows fast. Their harmonic mean has the smallest error in
the worst case, less than a quarter for the octaves of a default run. What is left after the iterations, the results of
each frame, is counted in: of a fine grid it takes longer than many of them.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tnst_mi.fields.grid import Shape
from tnst_mi.recipe.quality import iterations_run
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.levels import levels_of

#: Seconds of an iteration on two CPU cores (docs/performance.md): in any octave, per pixel of all images, and per cell.
#: Only their proportions count.
_TYPICAL = (34e-3, 7.8e-6, 60e-9)

#: Seconds of the results of a frame, there: for pictures and plots, and per cell of the input's grid for transport and
#: compression. They do not get faster with the iterations, as on a GPU.
_TYPICAL_RESULTS = (0.35, 0.55e-6)

#: Seconds in which a sequence is concluded, there: for its plots, and per frame for its flicker and its video.
_TYPICAL_CONCLUSION = (0.6, 0.1)


@dataclass(frozen=True)
class OctaveSize:
    """Number of cells of an octave's grid, of pixels of the images of an iteration, and of its iterations."""

    cells: int
    pixels: int
    iterations: int

    @property
    def costs(self) -> tuple[float, float, float]:
        """What the costs of an iteration grow with."""
        return 1.0, float(self.pixels), float(self.cells)

    @property
    def typical(self) -> float:
        """What an iteration costs where costs are in the typical proportions."""
        return sum(seconds * count for seconds, count in zip(_TYPICAL, self.costs, strict=True))


def octave_sizes(recipe: Recipe, shape: Shape) -> list[OctaveSize]:
    """The sizes of a recipe's octaves for frames of a shape (D, H, W), from coarse to fine."""
    return [
        OctaveSize(math.prod(level.shape), recipe.views * math.prod(level.size), iterations_run(recipe, octave))
        for octave, level in enumerate(levels_of(recipe, shape))
    ]


@dataclass
class _Timed:
    """What is known of an octave: the time and the count of its first report, and of its last."""

    first: tuple[float, int]
    last: tuple[float, int]
    begin: float
    #: Seconds in between that went to the results of frames.
    results: float = 0.0

    @property
    def seconds(self) -> float | None:
        """Of an iteration; None before the second report, since the first also has kernels to compile."""
        (start, at_start), (end, at_end) = self.first, self.last
        return (end - start - self.results) / (at_end - at_start) if at_end > at_start else None


class TimeLeft:
    """Estimates the time left from the reports of a run's iterations.

    Args:
        sizes: of the octaves, from coarse to fine.
        cells: of the input's grid.
        frames: how many have results to be written.
        clock: seconds that pass; the time of construction counts as the beginning of the run.
    """

    def __init__(
        self, sizes: Sequence[OctaveSize], cells: int, frames: int, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._octaves, self._cells, self._frames, self._clock = sizes, cells, frames, clock
        once, by_frame = _TYPICAL_CONCLUSION
        self._conclusion = once + by_frame * frames if frames > 1 else 0.0
        #: Seconds that went to the results of frames.
        self._results: list[float] = []
        self._timed: dict[int, _Timed] = {}
        self._now = clock()

    def after(self, octave: int, done: int, total: int) -> float:
        """The seconds left after an iteration.

        Args:
            octave: that of the iteration, from 0.
            done: iterations done, of all frames and octaves.
            total: iterations to do, likewise.
        """
        before, self._now = self._now, self._clock()
        if octave in self._timed:
            self._timed[octave].last = self._now, done
        else:
            self._timed[octave] = _Timed((self._now, done), (self._now, done), before)
        frames = total // sum(size.iterations for size in self._octaves)
        each = [frames * size.iterations for size in self._octaves]
        here = (sum(each[: octave + 1]) - done) * self._seconds(octave)
        later = range(octave + 1, len(each))
        iterations = here + sum(each[at] * self._seconds(at) + self._entering(frames) for at in later)
        return iterations + self._frames * self._of_results() + self._conclusion

    def frame_done(self) -> None:
        """The results of a frame have been written."""
        before, self._now = self._now, self._clock()
        self._results.append(self._now - before)
        self._frames = max(0, self._frames - 1)
        if self._timed:
            self._timed[max(self._timed)].results += self._now - before

    def _of_results(self) -> float:
        """What the results of a frame take, as measured, or as is typical."""
        if self._results:
            return sum(self._results) / len(self._results)
        once, by_cell = _TYPICAL_RESULTS
        return once + by_cell * self._cells

    def _seconds(self, octave: int) -> float:
        """What an iteration of an octave takes, as measured, or as expected from other octaves."""
        measured = {at: timed.seconds for at, timed in self._timed.items() if timed.seconds is not None}
        known = [(at, seconds) for at, seconds in sorted(measured.items()) if seconds is not None][-2:]
        if octave in measured:
            return dict(known)[octave]
        if not known:
            (at, timed), *_ = self._timed.items()
            return (timed.first[0] - timed.begin) * self._octaves[octave].typical / self._octaves[at].typical
        sizes = self._octaves
        if len(known) == 1:
            ((at, seconds),) = known
            return seconds * sizes[octave].typical / sizes[at].typical
        return _expected(sizes[octave], *((sizes[at], seconds) for at, seconds in known))

    def _entering(self, frames: int) -> float:
        """What the first iteration of an octave takes besides, as far as is known.

        The run's first one says nothing about it, since kernels are compiled there and the network is loaded; the loss
        is scaled with an evaluation of it for each frame.
        """
        at = max(self._timed)
        latest, seconds = self._timed[at], self._seconds(at)
        if len(self._timed) == 1:
            return frames * seconds
        return max(0.0, latest.first[0] - latest.begin - seconds)


def _expected(size: OctaveSize, *known: tuple[OctaveSize, float]) -> float:
    """The seconds of an iteration at a size, from those at two other sizes."""
    (one, in_one), (two, in_two) = known
    bounds = []
    for a, b in itertools.combinations(range(3), 2):
        # in_one = x one.costs[a] + y one.costs[b], and likewise for two.
        determinant = one.costs[a] * two.costs[b] - one.costs[b] * two.costs[a]
        if determinant == 0:
            continue
        x = (in_one * two.costs[b] - in_two * one.costs[b]) / determinant
        y = (one.costs[a] * in_two - two.costs[a] * in_one) / determinant
        if x >= 0 and y >= 0:
            bounds.append(x * size.costs[a] + y * size.costs[b])
    # Costs that fall, or grow faster than the cells, are those of a machine with other work.
    if not bounds or min(bounds) <= 0:
        return in_two * max(1.0, in_two / in_one) if in_one > 0 else in_two
    return 2 / (1 / min(bounds) + 1 / max(bounds))
