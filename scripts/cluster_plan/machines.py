"""Machines whose workers share their cores."""

from __future__ import annotations

import heapq
import math


class Machine:
    """Tasks that run on the cores of one machine.

    With more tasks than cores, each gets the same part of a core. So the work that a task would have received since
    the beginning is counted once for all of them, in seconds on a core of its own, and a task ends when this count has
    grown by the task's seconds.

    Args:
        cores: how many there are; infinity if workers do not slow each other down.
    """

    def __init__(self, cores: float) -> None:
        self._cores = cores
        self._received, self._when = 0.0, 0.0
        #: The count at which each ends, its worker, and the task.
        self._running: list[tuple[float, int, int]] = []
        #: How often tasks have begun or ended: what was foreseen before is void.
        self.changes = 0

    def _rate(self) -> float:
        return min(1.0, self._cores / len(self._running)) if self._running else 1.0

    def _advance(self, now: float) -> None:
        self._received += (now - self._when) * self._rate()
        self._when = now
        self.changes += 1

    def start(self, now: float, seconds: float, worker: int, task: int) -> None:
        """A worker begins a task."""
        self._advance(now)
        heapq.heappush(self._running, (self._received + seconds, worker, task))

    def next_end(self) -> float:
        """When the next task ends, if none begins before; infinity if none is running."""
        if not self._running:
            return math.inf
        return self._when + max(self._running[0][0] - self._received, 0.0) / self._rate()

    def end(self, now: float) -> tuple[int, int]:
        """The next task ends, now: its worker, and the task."""
        self._advance(now)
        count, worker, task = heapq.heappop(self._running)
        # Exactly, so that rounding errors do not add up.
        self._received = count
        return worker, task
