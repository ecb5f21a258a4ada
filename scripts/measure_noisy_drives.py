"""What the noise of a renderer's gradient does to a stylization: one frame and style, at equal processor time.

    python scripts/measure_noisy_drives.py [FRAME] --out FOLDER [--budgets 6 18] [--draw FILE.png]

Runs by emission and absorption, by `prbvolpath` as it is, and by ours, with several paths per pixel, each as long as
its budget of processor seconds lasts. All results are judged alike, by emission and absorption and by path tracing with
many paths. Each run is kept in FOLDER, so that the script goes on where it was stopped; in the end it prints a table,
and --draw draws it.
"""

from __future__ import annotations

import tnst_mi  # first: it lets torch's idle threads sleep

# isort: split
import argparse
import json
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from compare_drivers import FRAME, Judge
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from noise_measures.plain import PlainPathTracer

from tnst_mi.frame import Frame
from tnst_mi.io.atomic import written_whole
from tnst_mi.machine.backend import torch_device
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.single_frame import optimise
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering import driving

METHOD = {"style": ["net"], "lam": 1.0, "transport": "step", "motif_size": "cells", "octaves": 1, "views": 3}
METHOD |= {"gamma": 0.3, "albedo": 0.3, "integrator": "prbvolpath"}

#: By name, the recipe's keys of a drive, and whether `prbvolpath` renders it as it is.
DRIVES: dict[str, tuple[dict[str, Any], bool]] = {
    "emission–absorption": ({"integrator": "emission_absorption"}, False),
    "prbvolpath, 4 paths": ({"spp": 4}, True),
    "prbvolpath, 16 paths": ({"spp": 16}, True),
    "ours, 1 path": ({"spp": 1}, False),
    "ours, 4 paths": ({"spp": 4}, False),
}
#: Paths per pixel of the pictures that are judged: most of their light is summed up without noise.
JUDGED_SPP = 32

JUDGES = {"emission_absorption": "seen by emission–absorption", "prbvolpath": "seen path traced"}


@contextmanager
def path_tracer(plain: bool) -> Iterator[None]:
    """`prbvolpath` as it is in place of our renderer, or not."""
    driving._scattering.cache_clear()
    with mock.patch.object(driving, "ScatteringRenderer", PlainPathTracer if plain else driving.ScatteringRenderer):
        yield
    driving._scattering.cache_clear()


def stylized(frame: Frame, recipe: Recipe, network: GoogLeNet, exposure: float) -> tuple[np.ndarray, float]:
    """The density after all iterations of a recipe, and the median processor seconds of one."""
    marks = [time.process_time()]
    result = optimise(frame, recipe, network, exposure, lambda _: marks.append(time.process_time()))
    # The first iterations compile kernels.
    return result.density, statistics.median(np.diff(marks)[1:])


def run_all(folder: Path, frame: Frame, budgets: list[int]) -> list[dict]:
    """A record for each drive and budget: iterations, seconds and losses, unless it is too little for two steps."""
    base = Recipe.from_dict(METHOD, "drives: ", Path.cwd())
    network = GoogLeNet.load(base.weights).to(torch_device())
    judges = {
        name: Judge(frame, base.updated({"integrator": name}, "", Path.cwd()), network, JUDGED_SPP) for name in JUDGES
    }
    kept, path = {}, folder / "runs.json"
    if path.exists():
        kept = json.loads(path.read_text("utf-8"))

    def keep(key: str, record: dict) -> None:
        kept[key] = record
        with written_whole(path) as temporary:
            temporary.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", "utf-8")

    if "before" not in kept:
        keep(
            "before",
            {"drive": "before", "losses": {name: judge.judge(frame.density)[0] for name, judge in judges.items()}},
        )
    for budget in budgets:
        for drive, (keys, plain) in DRIVES.items():
            key = f"{drive}, {budget} s"
            if key in kept:
                continue
            recipe = base.updated(keys, "", Path.cwd())
            exposure = judges[recipe.integrator].exposure
            with path_tracer(plain):
                speed = kept.get(f"speed of {drive}")
                if speed is None:
                    _, speed = stylized(frame, recipe.updated({"iterations": 3}, "", Path.cwd()), network, exposure)
                    keep(f"speed of {drive}", speed)
                iterations = round(budget / speed)
                if iterations < 2:
                    continue
                density, speed = stylized(
                    frame, recipe.updated({"iterations": iterations}, "", Path.cwd()), network, exposure
                )
            np.save(folder / f"{key}.npy", density)
            losses = {name: judge.judge(density)[0] for name, judge in judges.items()}
            keep(key, {"drive": drive, "iterations": iterations, "seconds": iterations * speed, "losses": losses})
            print(json.dumps(kept[key], ensure_ascii=False), flush=True)
    for key, record in kept.items():
        if not key.startswith("speed") and "pictures" not in record:
            density = frame.density if key == "before" else np.load(folder / f"{key}.npy")
            pictures = np.stack([judge.pictures(density)[1] for judge in judges.values()])
            np.save(folder / f"{key} pictures.npy", pictures)
            keep(key, record | {"pictures": f"{key} pictures.npy"})
    return [record for key, record in kept.items() if not key.startswith("speed")]


def draw(records: list[dict], folder: Path) -> Figure:
    """Losses against seconds by either judge, and the pictures of the longest runs."""
    before, *runs = records
    longest = {record["drive"]: record for record in sorted(runs, key=lambda record: record["seconds"])}
    figure = Figure(figsize=(10.5, 9.0), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1, 1.6))
    for axes, (judge, title) in zip(above.subplots(1, 2), JUDGES.items(), strict=True):
        for number, drive in enumerate(DRIVES):
            points = sorted((r["seconds"], r["losses"][judge]) for r in runs if r["drive"] == drive)
            axes.plot(*zip(*points, strict=True), marker="o", color=f"C{number}", label=drive)
        axes.axhline(before["losses"][judge], color="0.6", ls=":", label="before")
        axes.set(title=title, xlabel="processor seconds", ylabel="style distance", xlim=0)
    above.axes[0].legend(fontsize=7, loc="lower left")
    shown = [before, *(longest[drive] for drive in DRIVES)]
    rows = below.subplots(2, len(shown))
    for axes, title in zip(rows[:, 0], JUDGES.values(), strict=True):
        axes.set_ylabel(title)
    for column, record in enumerate(shown):
        for axes, picture, judge in zip(rows[:, column], np.load(folder / record["pictures"]), JUDGES, strict=True):
            axes.imshow(np.clip(picture, 0, 1), cmap="gray", vmin=0, vmax=1)
            axes.set(xticks=[], yticks=[], xlabel=f"{record['losses'][judge]:.3f}")
        steps = f"\n{record['iterations']} iterations" if "iterations" in record else "\n"
        rows[0, column].set_title(record["drive"] + steps, fontsize=8)
    return figure


def main() -> None:
    """Stylize what is missing, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frame", type=Path, nargs="?", default=FRAME)
    parser.add_argument("--out", type=Path, required=True, help="a folder, also of an earlier run")
    parser.add_argument("--budgets", type=int, nargs="+", default=[6, 18], help="processor seconds of a run")
    parser.add_argument("--draw", type=Path, help="a PNG to draw")
    arguments = parser.parse_args()
    tnst_mi.activate()
    arguments.out.mkdir(parents=True, exist_ok=True)
    records = run_all(arguments.out, tnst_mi.load_frames(arguments.frame)[0], arguments.budgets)
    for record in records:
        print(json.dumps(record, ensure_ascii=False))
    if arguments.draw:
        figure = draw(records, arguments.out)
        with written_whole(arguments.draw) as temporary:
            figure.canvas = FigureCanvasAgg(figure)
            figure.savefig(str(temporary), dpi=80, format="png")


if __name__ == "__main__":
    main()
