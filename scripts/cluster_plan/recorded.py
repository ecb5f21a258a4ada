"""What a run on a cluster has measured of its tasks, from its folder."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from cluster_plan.measured import ALONE, WINDOWED, Cost, Measured
from tnst_mi.errors import InputError, naming
from tnst_mi.recipe.quality import iterations_run
from tnst_mi.recipe.recipe import Recipe


def measured_by(folder: Path) -> Measured:
    """The measurements of a run; if it was resumed, of all its parts.

    What the coordinator does before and after the tasks takes as long for any number of frames, and what it does
    without a cluster, it does for each. What it computes for each task is that of the scheduler too where this is in
    the same process, as with --cluster local:N. How many bytes tasks have read depends on what their workers had kept,
    and is left out: see `Cost`.

    Raises:
        InputError: it is no run on a cluster, or its record is damaged or lacks a kind of task.
        OSError: it cannot be read.
    """
    path = folder / "run.json"
    try:
        run = json.loads(path.read_text("utf-8"))
        parts = [part["tasks"] for part in run.get("cluster", ())]
        windowed = len(run["frames"]) > 1
        together = sum(part["seconds"] for part in run.get("cluster", ()))
        before, after, cpu = (
            sum(part[key] for part in run.get("cluster", ())) for key in ("before", "after", "coordinator_cpu")
        )
        alone = run["seconds"] - together
    except (ValueError, TypeError, KeyError, AttributeError, ZeroDivisionError, RecursionError):
        raise InputError(f"{path}: is not the record of a run") from None
    if not parts:
        raise InputError(f"{path}: the run was none on a cluster; give one that had --cluster local:1 or another")
    recipe = Recipe.from_toml(folder / "recipe.toml")
    window = recipe.window if windowed else 1
    iterations = tuple(iterations_run(recipe, octave) for octave in range(recipe.octaves))
    with naming(path):
        costs = {
            (kind, octave): _mean(parts, f"{kind} {octave + 1}")
            for octave in range(recipe.octaves)
            for kind in (WINDOWED if window > 1 else ALONE)
            if kind != "finish" or octave == recipe.octaves - 1
        }
    finish = "finish", recipe.octaves - 1
    if (last := costs[finish]) is not None:
        costs[finish] = replace(last, bytes_written=_result_bytes(folder) / len(run["frames"]))
    costs = {of: cost for of, cost in costs.items() if cost is not None}
    tasks = sum(entry["tasks"] for part in parts for entry in part.values())
    return Measured(
        window,
        iterations,
        costs,
        prepare_seconds=before,
        conclude_seconds=after,
        coordinator_seconds=max(alone, 0.0) / len(run["frames"]),
        scheduler_seconds=cpu / max(tasks, 1),
    )


def _result_bytes(folder: Path) -> float:
    """What the arrays of all frames take; pictures are the coordinator's."""
    return sum(file.stat().st_size for name in ("density", "velocity") for file in folder.glob(f"{name}/*"))


def _mean(parts: list[dict[str, Any]], name: str) -> Cost | None:
    """The means over the tasks of a kind in an octave; None if there were none.

    Raises:
        InputError: the record is damaged, or has none of a kind that every run has.
    """
    try:
        told = [part[name] for part in parts if name in part]
        tasks = sum(entry["tasks"] for entry in told)
        seconds, written = (sum(entry["tasks"] * entry[key] for entry in told) for key in ("seconds", "bytes_written"))
        firsts = sum(entry["firsts"] for entry in told)
        in_firsts = sum(entry["firsts"] * entry["first_seconds"] for entry in told if entry["firsts"])
    except (TypeError, KeyError):
        raise InputError(f"tasks of {name}: damaged") from None
    if tasks:
        first = in_firsts / firsts if firsts else None
        usual = (seconds - in_firsts) / (tasks - firsts) if tasks > firsts else first
        assert usual is not None
        return Cost(usual, None, written / tasks, first)
    if name.split()[0] not in ("gain", "scales"):
        raise InputError(f"no tasks of {name}, which the run has; give one that was not begun without --cluster")
    return None
