"""The progress bar of a frame, with the time left by what steps have taken so far.

Steps on fine grids cost more than those on coarse ones, and the first one compiles kernels: it says nothing about the
others, and is left out.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from tqdm import tqdm

from tnst_mi.machine.progress_bar import progress_bar


@dataclass(frozen=True)
class LevelCost:
    """The steps on a grid, and what each costs, in any unit that all grids share."""

    steps: int
    each: float


class StepBar:
    """Grid, step and error on stderr.

    Args:
        costs: of all grids, from coarse to fine.
        first: the grid that the frame begins with.
        name: what is found.
        shown: whether anything is.
    """

    def __init__(self, costs: Sequence[LevelCost], first: int, name: str, shown: bool) -> None:
        self._costs, self._first = costs, first
        self._total = sum(cost.steps * cost.each for cost in costs[first:])
        self._bar = progress_bar(total=self._total, desc=name, disable=not shown)
        self._level = first
        self._begun = time.perf_counter()
        #: When the last step ended; None before the first.
        self._ended: float | None = None
        #: Steps timed on each grid, and their seconds.
        self._timed = [(0, 0.0) for _ in costs]

    def close(self) -> None:
        """End the line."""
        self._bar.close()

    def enter(self, level: int, done: int) -> None:
        """Take note that the next steps are on a grid on which some are done."""
        before = sum(cost.steps * cost.each for cost in self._costs[self._first : level])
        self._level, self._bar.n = level, before + done * self._costs[level].each

    def advance(self, text: str) -> None:
        """Show one more step, with a text."""
        now = time.perf_counter()
        if self._ended is not None:
            count, seconds = self._timed[self._level]
            self._timed[self._level] = count + 1, seconds + now - self._ended
        self._ended = now
        each = self._costs[self._level].each
        left = self.seconds_left(self._bar.n + each)
        told = "?" if left is None else tqdm.format_interval(left)
        elapsed = tqdm.format_interval(now - self._begun)
        self._bar.bar_format = f"{{desc}}: {{percentage:3.0f}}%|{{bar}}| [{elapsed}<{told}{{postfix}}]"
        self._bar.set_postfix_str(text, refresh=False)
        self._bar.update(each)

    def seconds_left(self, done: float) -> float | None:
        """The seconds that are left when so much of the cost is done; None before two steps.

        The steps of the latest grid that has been timed tell what others take, in proportion to their costs.
        """
        timed = [level for level, (count, _) in enumerate(self._timed) if count]
        if not timed:
            return None
        count, seconds = self._timed[timed[-1]]
        rate = seconds / count / self._costs[timed[-1]].each
        return rate * (self._total - done)
