"""What the processes of a run use of memory and of the CPUs, while it goes on."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import psutil

from cluster_measures.observed import Apart, Observed
from cluster_measures.processes import Processes

#: Seconds between two looks.
_LOOK = 0.2


@dataclass
class Use:
    """What the processes of a run have used.

    Attributes:
        when: (N), the moments of the looks, in seconds of `time.monotonic`.
        memory: by process, (N), resident, in MB.
        cpu: by process, (N), seconds of the CPUs since its beginning.
    """

    when: np.ndarray
    memory: dict[str, np.ndarray]
    cpu: dict[str, np.ndarray]

    def cpu_between(self, since: float, until: float, names: Iterable[str] | None = None) -> float:
        """Seconds of the CPUs that processes, all or those of these names, used together between two moments."""
        used = self.cpu.values() if names is None else [self.cpu[name] for name in names]
        ends = [np.interp([since, until], self.when, seconds) for seconds in used]
        return float(sum(end - begin for begin, end in ends))


def watched(run: Apart, cluster: Processes | None = None) -> tuple[Observed, Use]:
    """A run to its end, on a cluster or on none, and what its processes have used."""
    pids = {"coordinator": run.pid}
    if cluster is not None:
        pids |= {"scheduler": cluster.scheduler.pid}
        pids |= {f"worker {number}": worker.pid for number, worker in enumerate(cluster.workers, 1)}
    processes = {name: psutil.Process(pid) for name, pid in pids.items()}
    looks: list[tuple[float, Mapping[str, tuple[float, float]]]] = []
    while run.running():
        looks.append((time.monotonic(), {name: _use(process) for name, process in processes.items()}))
        time.sleep(_LOOK)
    use = Use(
        np.array([when for when, _ in looks]),
        {name: np.array([of[name][0] for _, of in looks]) for name in pids},
        {name: np.array([of[name][1] for _, of in looks]) for name in pids},
    )
    return run.observed(), use


def _use(process: psutil.Process) -> tuple[float, float]:
    with process.oneshot():
        times = process.cpu_times()
        return process.memory_info().rss / 1e6, times.user + times.system
