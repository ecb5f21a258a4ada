"""What a cluster costs beside the work: the time of each task, and bytes that are read."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import psutil
from distributed import Client, get_worker

from cluster_measures.observed import RECIPE, Apart, Observed, observe, unpinnable
from cluster_measures.part import Part, table
from cluster_measures.processes import processes
from cluster_measures.setting import Setting, small
from tnst_mi.cluster import member
from tnst_mi.cluster.crew import Crew, Done
from tnst_mi.cluster.graph import TaskGraph, iterating
from tnst_mi.cluster.tasks import Task, Told
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.prepare import prepare

#: What is asked of a task's cost, in milliseconds.
MOST_MILLISECONDS = 3.0


# ---------------------------------------------------------------- overhead


def overhead(folder: Path) -> Part:
    """Tasks that do nothing, and what tasks of a run on one worker take beside their own seconds."""
    part = Part("What a task costs beside its own seconds", skipped=unpinnable())
    if part.skipped:
        return part
    wall, cpu, tasks = _empty_tasks(folder)
    setting = small(folder / "run")
    with processes(folder / "cluster", [{0}]) as cluster:
        beside = beside_tasks(Apart(setting.trial(cluster.address), cores={1}).observed())
    rows = [
        (f"empty tasks ({tasks}), from one to the next", f"{wall:.2f} ms"),
        *((f"of these, CPU of the {name}", f"{value:.2f} ms") for name, value in cpu.items()),
        (f"a run on one worker: {setting.described()}", f"{beside:.2f} ms"),
    ]
    part.lines = table(("what", "per task"), rows)
    part.values = {"empty": wall, "cpu": cpu, "run": beside, "tasks": tasks}
    within = cpu["scheduler"] + cpu["coordinator"]
    part.holds[f"CPU of scheduler and coordinator at most {MOST_MILLISECONDS:g} ms"] = within <= MOST_MILLISECONDS
    part.holds[f"a worker waits at most {MOST_MILLISECONDS:g} ms between tasks"] = beside <= MOST_MILLISECONDS
    return part


def beside_tasks(seen: Observed) -> float:
    """What a task of the last octave takes of its only worker's time beside its own seconds, in milliseconds.

    Counted are steps and averages after the first iteration, while all frames are at it.
    """
    last = max(task["level"] for task in seen.tasks)
    counted = [number for number, task in enumerate(seen.tasks) if task["level"] == last and task["kind"] == "average"]
    frames = sum(task["kind"] == "finish" for task in seen.tasks)
    first, final = counted[frames], counted[-frames]
    busy = sum(task["seconds"] for task in seen.tasks[first + 1 : final + 1])
    wall = seen.tasks[final]["when"] - seen.tasks[first]["when"]
    return 1000 * (wall - busy) / (final - first)


def _empty_tasks(folder: Path, iterations: int = 60) -> tuple[float, dict[str, float], int]:
    """Wall time and CPU of each process in milliseconds per task, and the number of tasks."""
    trial = Setting(folder / "empty", 12, (8, 12, 8), {"window": 5, "octaves": 1, "iterations": iterations}).trial()
    plan = prepare(trial.frames, Recipe.from_dict(RECIPE | dict(trial.keys))).plan
    graph = TaskGraph(iterating(plan, 0, dict.fromkeys(range(12), 0), lambda *item: False, ()))
    tasks = len(graph)

    def nothing(run: str, task: Task, told: Told, parcels: None) -> None:
        """In place of `member.perform`: reports as that does."""
        worker, topic = get_worker(), member.topic_of(run)
        worker.log_event(topic, {"worker": worker.address, "task": task})
        entry = {"frame": "", "octave": 0, "iteration": 0, "loss": 0.0, "terms": {}, "seconds": 0.0}
        if task.kind == "step":
            worker.log_event(topic, {"worker": worker.address, "entry": entry})
        took = {"kind": task.kind, "level": task.level, "seconds": 0.0, "read": 0, "written": 0}
        worker.log_event(topic, {"worker": worker.address, "took": took, "task": task, "result": None})

    with (
        processes(folder / "empty_cluster", [()]) as cluster,
        Client(cluster.address, set_as_default=False) as client,
        mock.patch.object(member, "perform", nothing),
        mock.patch.object(member, "join", lambda run, sharing, versions, order: None),
    ):
        crew = Crew(client, b"", plan, print, lacking=None)
        told = Told(scales={"style": 1.0})
        crew.give(dict.fromkeys(graph.ready, told))
        pids = {"scheduler": cluster.scheduler.pid, "coordinator": None, "worker": cluster.workers[0].pid}
        counted, since, used = 0, 0.0, dict[str, float]()
        for answer in crew.answers():
            if not isinstance(answer, Done):
                continue
            crew.give(dict.fromkeys(graph.done(answer.task), told))
            counted += 1
            # The first ones come while the worker joins.
            if counted == tasks // 10:
                since, used = time.perf_counter(), _cpu(pids)
        wall, now, measured = time.perf_counter() - since, _cpu(pids), tasks - tasks // 10
        crew.close()
    return 1000 * wall / measured, {name: 1000 * (now[name] - used[name]) / measured for name in pids}, measured


def _cpu(pids: dict[str, int | None]) -> dict[str, float]:
    """Seconds of the CPUs that processes have used."""
    times = {name: psutil.Process(pid).cpu_times() for name, pid in pids.items()}
    return {name: time.user + time.system for name, time in times.items()}


# ---------------------------------------------------------------- locality


def locality(folder: Path, workers: Sequence[int] = (2, 3)) -> Part:
    """Bytes that workers read of items, with and without the hint of a home for each frame."""
    part, setting, rows = Part("Locality"), small(folder), list[tuple[Any, ...]]()
    for count in workers:
        read = []
        for homes in (True, False):
            (cluster,) = observe(setting.trial(f"local:{count}", homes)).record["cluster"]
            read.append(sum(worker["bytes_read"] for worker in cluster["workers"]))
        rows.append((count, *(f"{value / 1e6:.1f} MB" for value in read), f"{read[0] / read[1]:.2f}"))
        part.values[f"{count} workers"] = dict(zip(("homes", "none"), read, strict=True))
        part.holds[f"{count} workers read less with homes"] = read[0] < read[1]
    part.lines = [setting.described(), "", *table(("workers", "with homes", "without", "ratio"), rows)]
    return part
