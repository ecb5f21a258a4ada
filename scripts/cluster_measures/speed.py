"""How fast a run is on workers with a core each, against one process on one core; and what plan_cluster predicts."""

from __future__ import annotations

import functools
import os
import statistics
import sys
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from cluster_plan.graph import graph_of
from cluster_plan.measured import Measured
from cluster_plan.recorded import measured_by
from cluster_plan.simulation import Cluster, simulate

from cluster_measures.costs import beside_tasks
from cluster_measures.observed import Apart, Observed, Trial, unpinnable
from cluster_measures.part import Part, table
from cluster_measures.processes import processes
from cluster_measures.setting import Setting
from cluster_measures.watching import Use, watched

REPETITIONS = 3

FRAMES, ITERATIONS = 12, 6

#: What is asked: of two workers' speed-up, and of the error of a predicted one.
LEAST, MOST_ERROR = 1.7, 0.15

#: The cores of each worker, by their number; three share two.
_CORES: dict[int, list[Collection[int]]] = {1: [{0}], 2: [{0}, {1}], 3: [{0, 1}] * 3}

#: A run, what was seen of it, and what its processes used, by the number of its workers: 0 for a run without a cluster.
_Repetition = dict[int, tuple[Trial, Observed, Use]]


def speed(folder: Path) -> Part:
    """Iterations per second while all frames are at it, and the speed-up of workers."""
    part = Part("Speed", skipped=unpinnable())
    if part.skipped:
        return part
    repetitions, loads = _repetitions(folder.parent / "speed")
    rates = {count: [_rate(of[count][1]) for of in repetitions] for count in (0, *_CORES)}
    medians = {count: statistics.median(values) for count, values in rates.items()}
    cpu = {count: statistics.median(_cpu(*of[count][1:]) for of in repetitions) for count in rates}
    tasks = [
        statistics.median(t["seconds"] for of in repetitions for t in of[1][1].tasks if t["kind"] == kind)
        for kind in ("step", "average")
    ]
    beside = [beside_tasks(of[1][1]) for of in repetitions]
    rows = [
        (
            f"{count} worker{'s' * (count > 1)}" if count else "one process, one core",
            *(f"{value:.3f}" for value in rates[count]),
            f"{medians[count]:.3f}",
            f"{medians[count] / medians[0]:.2f}",
            f"{cpu[count]:.0f} ms",
        )
        for count in rates
    ]
    numbers = (f"run {number}" for number in range(1, REPETITIONS + 1))
    head = ("", *numbers, "median, iterations/s", "speed-up", "CPU each")
    part.lines = [
        f"{_setting(folder).described()}; one worker's step takes {1000 * tasks[0]:.0f} ms, its average "
        f"{1000 * tasks[1]:.0f} ms, and each {statistics.median(beside):.1f} ms beside that; three workers share two "
        "cores",
        "",
        *table(head, rows),
        "",
        f"Load of the machine before each repetition: {', '.join(f'{load:.1f}' for load in loads)}",
    ]
    part.values = {"loads": loads, "rates": rates, "cpu": cpu, "beside": beside, "step": tasks[0], "average": tasks[1]}
    part.holds[f"two workers do at least {LEAST} times the work of one process"] = medians[2] / medians[0] >= LEAST
    return part


def predict(folder: Path) -> Part:
    """The speed-up of whole runs, predicted from each repetition's run on one worker, and as measured."""
    part, rows = Part("Prediction", skipped=unpinnable()), []
    if part.skipped:
        return part
    repetitions, _ = _repetitions(folder.parent / "speed")
    seconds = {count: statistics.median(of[count][1].record["seconds"] for of in repetitions) for count in _CORES}
    measured = [_measured(*of[1]) for of in repetitions]
    for count in [count for count in _CORES if count > 1]:
        found = []
        for costs in measured:
            graph = graph_of(costs, FRAMES)
            one, many = (simulate(costs, graph, Cluster(n, count, 2)).seconds for n in (1, count))
            found.append(one / many)
        predicted, real = statistics.median(found), seconds[1] / seconds[count]
        error = predicted / real - 1
        rows.append((count, f"{seconds[count]:.1f} s", f"{real:.2f}", f"{predicted:.2f}", f"{error:+.1%}"))
        part.values[str(count)] = {"measured": real, "predicted": found, "seconds": seconds[count]}
        part.holds[f"for {count} workers within {MOST_ERROR:.0%}"] = abs(error) <= MOST_ERROR
    rows.insert(0, (1, f"{seconds[1]:.1f} s", "1", "1", ""))
    part.lines = table(("workers", "time", "speed-up measured", "predicted", "error"), rows)
    return part


def _measured(trial: Trial, seen: Observed, use: Use) -> Measured:
    """What a run on one worker has measured, its scheduler, which is a process of its own, included."""
    measured = measured_by(trial.out)
    since, until = (seen.tasks[place]["when"] for place in (0, -1))
    scheduler = use.cpu_between(since, until, ["scheduler"]) / len(seen.tasks)
    return replace(measured, scheduler_seconds=measured.scheduler_seconds + scheduler)


def _setting(folder: Path) -> Setting:
    keys = {"window": 5, "octaves": 1, "iterations": ITERATIONS, "views": 3}
    return Setting(folder, FRAMES, (48, 72, 48), keys)


@functools.cache
def _repetitions(folder: Path) -> tuple[list[_Repetition], list[float]]:
    """The same run in all ways, one after the other, several times: what slows the machine down slows all of them.

    Also the load of the machine before each time.
    """
    setting, repetitions, loads = _setting(folder), list[_Repetition](), list[float]()
    for number in range(REPETITIONS):
        loads.append(os.getloadavg()[0])
        alone = setting.trial()
        found = {0: (alone, *watched(Apart(alone, cores={0})))}
        for count, cores in _CORES.items():
            with processes(folder / f"cluster_{number}_{count}", cores) as cluster:
                trial = setting.trial(cluster.address)
                found[count] = (trial, *watched(Apart(trial), cluster))
        repetitions.append(found)
        rates = ", ".join(f"{_rate(of[1]):.3f}" for of in found.values())
        print(f"repetition {number + 1} of {REPETITIONS}: {rates} iterations/s", file=sys.stderr, flush=True)
    return repetitions, loads


#: The iterations that are counted: in the first one of every frame kernels are compiled, beside the last one results
#: are written.
_FIRST, _LAST = FRAMES - 1, FRAMES * (ITERATIONS - 1) - 1


def _rate(seen: Observed) -> float:
    """Iterations per second."""
    return (_LAST - _FIRST) / (seen.iterations[_LAST] - seen.iterations[_FIRST])


def _cpu(seen: Observed, use: Use) -> float:
    """Milliseconds of the CPUs per iteration, of all processes together."""
    return 1000 * use.cpu_between(seen.iterations[_FIRST], seen.iterations[_LAST]) / (_LAST - _FIRST)
