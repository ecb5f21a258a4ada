"""Which task a process was at when it died, and whether the task is the cause.

Processes die for reasons of their own: their time is up, their machine is needed for others. A task is the cause if
several die at it one after the other without getting any further.
"""

from __future__ import annotations

from collections import Counter

from tnst_mi.cluster.tasks import Task

#: How many processes have to die at a task for it to be the cause.
MOST_DEATHS = 4


class Blame:
    """The deaths of processes, by the tasks that they were at.

    Attributes:
        at: the task that each process is at, by its address.
    """

    def __init__(self) -> None:
        self.at: dict[str, Task] = {}
        self._deaths: Counter[Task] = Counter()
        #: Tasks of which Dask says that too many have died.
        self._suspected: set[Task] = set()
        #: The furthest iteration of a frame that was reported from a task that is several.
        self._reached: dict[Task, int] = {}

    def begun(self, address: str, task: Task) -> None:
        """A process has begun a task."""
        self.at[address] = task

    def iterated(self, address: str, iteration: int) -> None:
        """A process has done an iteration of the task that it is at: one that is new is a reason to forget deaths."""
        task = self.at.get(address)
        if task is not None and iteration > self._reached.get(task, -1):
            self._reached[task] = iteration
            self._forgive(task)

    def ended(self, address: str, task: Task) -> None:
        """A process has carried out a task."""
        self.at.pop(address, None)
        self._reached.pop(task, None)
        self._forgive(task)

    def left(self, address: str) -> Task | None:
        """A process is gone; the task that is the cause, if there is one."""
        task = self.at.pop(address, None)
        if task is None:
            return None
        self._deaths[task] += 1
        return task if self._deaths[task] >= MOST_DEATHS else None

    def killed(self, task: Task) -> bool:
        """Dask says that too many processes have died that had been given a task; whether it is the cause.

        Dask also counts those to which it had been given while they were at others: so once is no proof.
        """
        known = task in self._suspected
        self._suspected.add(task)
        return known or self._deaths[task] >= MOST_DEATHS

    def _forgive(self, task: Task) -> None:
        self._deaths.pop(task, None)
        self._suspected.discard(task)
