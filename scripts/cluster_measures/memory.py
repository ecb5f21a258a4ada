"""Whether the memory of workers grows over a long sequence."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cluster_measures.observed import Apart
from cluster_measures.part import Part, table
from cluster_measures.processes import processes
from cluster_measures.setting import Setting
from cluster_measures.watching import watched

#: Growth that counts as none, in MB per 100 frames: pools of memory fill up in steps of about that.
FLAT = 2.0


def memory(folder: Path, frames: int = 200) -> Part:
    """Memory of two workers and of the coordinator while many tiny frames are stylized."""
    part = Part("Memory")
    setting = Setting(folder, frames, (16, 24, 16), {"window": 5, "octaves": 1, "iterations": 2, "views": 1})
    with processes(folder / "cluster", [(), ()]) as cluster:
        seen, use = watched(Apart(setting.trial(cluster.address)), cluster)
    # By the tasks that are done, the frame that an even course would have reached.
    when = [task["when"] for task in seen.tasks]
    reached = np.interp(use.when, when, np.linspace(0, frames, len(when)))
    there = (reached > 0) & (reached < frames)
    rows = []
    for name, values in use.memory.items():
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
