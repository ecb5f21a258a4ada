"""What passes between a run and its crew: tasks that are given, and what is answered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from distributed import Future

from tnst_mi.cluster.parcels import Parcel
from tnst_mi.cluster.tasks import Task, Told


@dataclass(frozen=True)
class Done:
    """A task has been done, with what it returns, and what it has written if the folder of the run is not shared."""

    task: Task
    result: Any
    parcels: Sequence[Parcel] = ()


@dataclass(frozen=True)
class Iterated:
    """An iteration of a frame has been done, with its entry for the log."""

    entry: dict[str, Any]


@dataclass(frozen=True)
class Given:
    """A task that Dask has been given.

    Attributes:
        future: of the task.
        told: with it.
        asked: the processes that it is for, or the one that would be best.
    """

    future: Future
    told: Told
    asked: frozenset[str]
