"""What each process of a cluster has done of a run, and what the tasks of each kind took: for run.json."""

from __future__ import annotations

import time
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


class Shares:
    """The shares of all processes, by their addresses."""

    def __init__(self) -> None:
        self._of: dict[str, Share] = {}
        #: By kind of task and octave: tasks, seconds, bytes read and written.
        self._kinds: dict[tuple[str, int], list[float]] = {}
        self._begun = time.perf_counter()

    def came(self, address: str, name: str, host: str) -> None:
        """A process is there."""
        self._of.setdefault(address, Share(name, host))

    def left(self, address: str) -> None:
        """A process is no longer there."""
        self._of[address].until = time.perf_counter()

    def count(self, address: str, took: dict[str, Any]) -> None:
        """Count a task that a process has reported."""
        if (share := self._of.get(address)) is not None:
            share.tasks += 1
            share.seconds += took["seconds"]
            share.read += took["read"]
            share.written += took["written"]
        numbers = 1, took["seconds"], took["read"], took["written"]
        total = self._kinds.setdefault((took["kind"], took["level"]), [0.0] * 4)
        total[:] = [before + now for before, now in zip(total, numbers, strict=True)]

    def record(self, address: str) -> dict[str, Any]:
        """What run.json says of a cluster, by its address: each process, and the means of each kind of task."""
        kinds = {
            f"{kind} {level + 1}": {
                "tasks": int(tasks),
                "seconds": round(seconds / tasks, 6),
                "bytes_read": round(read / tasks),
                "bytes_written": round(written / tasks),
            }
            for (kind, level), (tasks, seconds, read, written) in sorted(self._kinds.items())
        }
        return {
            "address": address,
            "seconds": round(time.perf_counter() - self._begun, 3),
            "workers": [share.record() for share in self._of.values() if share.tasks],
            "tasks": kinds,
        }
