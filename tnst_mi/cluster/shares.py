"""What each process of a cluster has done of a run, and what the tasks of each kind took: for run.json."""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Share:
    """What a process has done of a run."""

    name: str
    host: str
    since: float = field(default_factory=time.perf_counter)
    until: float | None = None
    tasks: int = 0
    seconds: float = 0.0
    read: int = 0
    written: int = 0
    #: Kinds of tasks that it has done, each in an octave.
    kinds: set[tuple[str, int]] = field(default_factory=set)

    def record(self) -> dict[str, Any]:
        """For run.json: the tasks, the time that they took, bytes of items, and the share of its time without task."""
        there = (time.perf_counter() if self.until is None else self.until) - self.since
        return {
            "worker": self.name,
            "host": self.host,
            "tasks": self.tasks,
            "seconds": round(self.seconds, 3),
            "bytes_read": self.read,
            "bytes_written": self.written,
            "idle": round(max(0.0, 1 - self.seconds / there), 4) if there > 0 else None,
        }


@dataclass
class Total:
    """What the tasks of a kind in an octave took together, and those of them that were a process's first."""

    tasks: int = 0
    seconds: float = 0.0
    firsts: int = 0
    first_seconds: float = 0.0
    read: int = 0
    written: int = 0

    def record(self) -> dict[str, Any]:
        """For run.json: the means."""
        return {
            "tasks": self.tasks,
            "seconds": round(self.seconds / self.tasks, 6),
            "firsts": self.firsts,
            "first_seconds": round(self.first_seconds / self.firsts, 6) if self.firsts else None,
            "bytes_read": round(self.read / self.tasks),
            "bytes_written": round(self.written / self.tasks),
        }


class Shares:
    """The shares of all processes, by their addresses."""

    def __init__(self) -> None:
        self._of: dict[str, Share] = {}
        #: By kind of task and octave.
        self._totals: defaultdict[tuple[str, int], Total] = defaultdict(Total)
        self._begun = time.perf_counter()
        #: Wall time, and time of the CPUs in this process, when the first task began and when the last one had ended.
        self._first: tuple[float, float] | None = None
        self._last = self._begun, 0.0

    def came(self, address: str, name: str, host: str) -> None:
        """A process is there."""
        self._of.setdefault(address, Share(name, host))

    def left(self, address: str) -> None:
        """A process is no longer there."""
        self._of[address].until = time.perf_counter()

    def count(self, address: str, took: dict[str, Any]) -> None:
        """Count a task that a process has reported."""
        kind, total = (took["kind"], took["level"]), self._totals[took["kind"], took["level"]]
        for one in (self._of.get(address), total):
            if one is not None:
                one.tasks += 1
                one.seconds += took["seconds"]
                one.read += took["read"]
                one.written += took["written"]
        if (share := self._of.get(address)) is not None and kind not in share.kinds:
            # Libraries are loaded and kernels compiled.
            share.kinds.add(kind)
            total.firsts += 1
            total.first_seconds += took["seconds"]
        self._last = time.perf_counter(), time.process_time()
        if self._first is None:
            self._first = self._last[0] - took["seconds"], self._last[1]

    def record(self, address: str) -> dict[str, Any]:
        """What run.json says of a cluster, by its address: each process, and the means of each kind of task."""
        now, first = time.perf_counter(), self._first or (self._last[0], 0.0)
        return {
            "address": address,
            "seconds": round(now - self._begun, 3),
            # Until the first task began, after the last one, and what this process computed in between.
            "before": round(first[0] - self._begun, 3),
            "after": round(now - self._last[0], 3),
            "coordinator_cpu": round(self._last[1] - first[1], 3),
            "workers": [share.record() for share in self._of.values() if share.tasks],
            "tasks": {f"{kind} {level + 1}": total.record() for (kind, level), total in sorted(self._totals.items())},
        }
