"""Whether the memory of workers grows over a long sequence."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import psutil

from cluster_measures.observed import Apart
from cluster_measures.part import Part, table
from cluster_measures.processes import Processes, processes
from cluster_measures.setting import Setting

#: Growth that counts as none, in MB per 100 frames: pools of memory fill up in steps of about that.
FLAT = 2.0

#: Seconds between two looks at the memory.
_LOOK = 0.2


def memory(folder: Path, frames: int = 200) -> Part:
    """Memory of two workers and of the coordinator while many tiny frames are stylized."""
    part = Part("Memory")
    setting = Setting(folder, frames, (16, 24, 16), {"window": 5, "octaves": 1, "iterations": 2, "views": 1})
    with processes(folder / "cluster", [(), ()]) as cluster:
        run = Apart(setting.trial(cluster.address))
        samples = _sampled(run, cluster)
        seen = run.observed()
    # By the tasks that are done, the frame that an even course would have reached.
    when = [task["when"] for task in seen.tasks]
    reached = np.interp([at for at, _ in samples], when, np.linspace(0, frames, len(when)))
    there = (reached > 0) & (reached < frames)
    rows = []
    for name in samples[0][1]:
        values = np.array([of[name] for _, of in samples])
        late = there & (reached >= frames / 4)
        slope = float(np.polyfit(reached[late], values[late], 1)[0] * 100)
        quarters = [float(np.interp(frames * part, reached[there], values[there])) for part in (0.25, 0.5, 0.75, 1)]
        rows.append((name, *(f"{value:.0f} MB" for value in quarters), f"{slope:+.2f} MB"))
        part.values[name] = {"quarters": quarters, "slope": slope}
        if name != "coordinator":
            part.holds[f"{name} grows by at most {FLAT:g} MB per 100 frames"] = slope <= FLAT
    head = ("process", "after 1/4 of the tasks", "1/2", "3/4", "all", "slope after 1/4, per 100 frames")
    part.lines = [f"{setting.described()}; {len(when)} tasks", "", *table(head, rows)]
    return part


def _sampled(run: Apart, cluster: Processes) -> list[tuple[float, dict[str, float]]]:
    """When, and the resident memory of each process in MB then, until a run ends."""
    pids = {"coordinator": run.pid, "scheduler": cluster.scheduler.pid}
    pids |= {f"worker {number}": worker.pid for number, worker in enumerate(cluster.workers, 1)}
    samples = []
    while run.running():
        values = {name: psutil.Process(pid).memory_info().rss / 1e6 for name, pid in pids.items()}
        samples.append((time.monotonic(), values))
        time.sleep(_LOOK)
    return samples
