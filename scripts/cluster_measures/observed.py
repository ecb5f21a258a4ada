"""A run, in this process or in one of its own, and what can be seen of it while it goes on."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import tnst_mi
from tnst_mi.cluster.crew import Crew
from tnst_mi.cluster.run import ClusterRun
from tnst_mi.cluster.shares import Shares
from tnst_mi.machine.backend import network_threads
from tnst_mi.optimisation.result import Progress
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.cluster_address import cluster_of
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare

#: What all runs have in common. The network ships with the package.
RECIPE: dict[str, Any] = {"style": ["spirals"], "weights": "patterns", "threads": 1}


@dataclass
class Observed:
    """What was seen of a run.

    Attributes:
        iterations: when each was reported, in seconds of `time.monotonic`.
        tasks: what workers have told of each task: when, worker, kind, level, seconds, read and written.
        record: the contents of run.json in the end.
        cpu_seconds: of the process of the run.
    """

    iterations: list[float] = field(default_factory=list)
    tasks: list[dict[str, Any]] = field(default_factory=list)
    record: dict[str, Any] = field(default_factory=dict)
    cpu_seconds: float = 0.0


@dataclass(frozen=True)
class Trial:
    """A run to be made.

    Attributes:
        frames: the folder of the input.
        out: that of the results.
        keys: of the recipe, beside `RECIPE`.
        address: of a cluster; None for a run in its own process.
        homes: whether workers are asked to take neighbouring frames.
        cache_bytes: of items that a worker keeps; None for as many as there is memory for.
    """

    frames: Path
    out: Path
    keys: Mapping[str, Any]
    address: str | None = None
    homes: bool = True
    cache_bytes: int | None = None


#: Is called when a worker has told of a task, with what has been seen so far.
OnTask = Callable[[Observed], None]


def observe(trial: Trial, on_task: OnTask = lambda seen: None) -> Observed:
    """Make a run in this process, or resume it.

    Args:
        trial: the run.
        on_task: see there.

    Raises:
        StoppedError: the cluster is gone.
    """
    tnst_mi.activate()
    seen, since = Observed(), time.process_time()
    count, home = Shares.count, Crew._home

    def counted(shares: Shares, address: str, took: dict[str, Any]) -> None:
        count(shares, address, took)
        seen.tasks.append({"when": time.monotonic(), "worker": address} | took)
        on_task(seen)

    def advanced(progress: Progress) -> None:
        seen.iterations.append(time.monotonic())

    threads = network_threads()
    prepared = prepare(trial.frames, Recipe.from_dict(RECIPE | dict(trial.keys)), trial.out, resume=True)
    if trial.cache_bytes is not None:
        prepared = dataclasses.replace(prepared, cache_bytes=trial.cache_bytes)
    if trial.address is None:
        run = Run(prepared, progress=False)
    else:
        run = ClusterRun(prepared, cluster_of(trial.address), progress=False)
    run._bar.advance = advanced
    try:
        with (
            mock.patch.object(Shares, "count", counted),
            mock.patch.object(Crew, "_home", home if trial.homes else lambda crew, frame: None),
        ):
            for _ in run:
                pass
    finally:
        network_threads(threads)
    seen.record, seen.cpu_seconds = run.record, time.process_time() - since
    return seen


class Apart:
    """A run in a process of its own.

    Args:
        trial: the run.
        cores: those on which its process may compute; all, if it is empty.
    """

    def __init__(self, trial: Trial, cores: Collection[int] = ()) -> None:
        told, self._file = json.dumps(dataclasses.asdict(trial), default=str), _file_of(trial)
        paths = str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")
        self._process = subprocess.Popen(
            [*pinned(cores), sys.executable, "-m", "cluster_measures.observed", told],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
        )
        self.pid = self._process.pid

    def running(self) -> bool:
        """Whether it goes on."""
        return self._process.poll() is None

    def observed(self) -> Observed:
        """What was seen of it, once it has ended.

        Raises:
            RuntimeError: it has failed.
        """
        if code := self._process.wait():
            raise RuntimeError(f"the run has failed: exit code {code}")
        return Observed(**json.loads(self._file.read_text("utf-8")))


def _file_of(trial: Trial) -> Path:
    """Where a process of its own writes what was seen."""
    return trial.out.with_suffix(".json")


def pinned(cores: Collection[int]) -> list[str]:
    """The beginning of a command that may compute on some cores only."""
    return ["taskset", "-c", ",".join(map(str, sorted(cores)))] if cores else []


def unpinnable() -> str:
    """Why processes cannot have cores of their own here, the first two; empty if they can."""
    if shutil.which("taskset") is None or not hasattr(os, "sched_getaffinity"):
        return "there is no program taskset (package util-linux), which gives processes cores of their own"
    if not {0, 1} <= os.sched_getaffinity(0):
        return "this machine has fewer than two cores"
    return ""


def main() -> None:
    """What a process of its own does."""
    given = json.loads(sys.argv[1])
    trial = Trial(**given | {"frames": Path(given["frames"]), "out": Path(given["out"])})
    _file_of(trial).write_text(json.dumps(dataclasses.asdict(observe(trial))), "utf-8")


if __name__ == "__main__":
    main()
