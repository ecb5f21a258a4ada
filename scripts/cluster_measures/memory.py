"""Whether the memory of workers grows over a long sequence."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from cluster_measures.observed import Apart, Observed
from cluster_measures.part import Part, table
from cluster_measures.processes import processes
from cluster_measures.setting import Setting
from cluster_measures.watching import Use, watched

#: Growth of a worker that counts as none, in MB per 100 frames.
FLAT = 10.0

#: Bytes of items that workers keep. By default, as many as the whole sequence has, if there is memory: they fill up.
KEPT = 4 << 20

#: From which part of a phase on growth is counted: before, libraries are loaded and kernels compiled.
_FROM = 0.25


def memory(folder: Path, frames: int = 200) -> Part:
    """Memory of two workers, the scheduler and the coordinator while many tiny frames are stylized."""
    part, rows = Part("Memory"), []
    setting = Setting(folder, frames, (16, 24, 16), {"window": 5, "octaves": 1, "iterations": 3, "views": 1})
    with processes(folder / "cluster", [(), ()]) as cluster:
        trial = replace(setting.trial(cluster.address), cache_bytes=KEPT)
        seen, use = watched(Apart(trial), cluster)
    for name in use.memory:
        cells = []
        for phase, (first, last) in _phases(seen).items():
            begin, end, slope = _growth([task["when"] for task in seen.tasks[first:last]], use, name, frames)
            part.values[f"{name}, {phase}"] = {"begin": begin, "end": end, "slope": slope}
            cells.append(f"{begin:.0f} → {end:.0f} MB ({slope:+.1f})")
            if name.startswith("worker"):
                part.holds[f"{name}, {phase}: grows by at most {FLAT:g} MB per 100 frames"] = slope <= FLAT
        rows.append((name, *cells))
    part.lines = [
        f"{setting.described()}; {len(seen.tasks)} tasks, workers keep {KEPT >> 20} MiB of items. Memory after "
        f"{_FROM:.0%} of each phase and in its end, and the slope in between, in MB per 100 frames:",
        "",
        *table(("process", *_phases(seen)), rows),
    ]
    return part


def _phases(seen: Observed) -> dict[str, tuple[int, int]]:
    """The tasks of each phase of a run of one octave, each with its own kernels: the first, and one after the last."""
    kinds = [task["kind"] for task in seen.tasks]
    begins = [0, *(kinds.index(kind) for kind in ("scales", "step", "finish")), len(kinds)]
    return dict(zip(("entering", "measuring", "iterating", "finishing"), pairwise(begins), strict=True))


def _growth(when: list[float], use: Use, name: str, frames: int) -> tuple[float, float, float]:
    """Memory of a process in MB after the first part of a phase and in its end, and the slope per 100 frames."""
    since = when[round(_FROM * (len(when) - 1))]
    moments = np.linspace(since, when[-1], 200)
    values = np.interp(moments, use.when, use.memory[name])
    reached = np.interp(moments, when, np.linspace(0, frames, len(when)))
    return float(values[0]), float(values[-1]), float(np.polyfit(reached, values, 1)[0] * 100)
