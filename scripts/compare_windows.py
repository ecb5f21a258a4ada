"""One sequence, one recipe, several windows: how steady is it, and what does that cost?

    python scripts/compare_windows.py FRAMES --recipe RECIPE.toml --out FOLDER [--windows 1,5,9] [--keys 'eta = 0.003']

Stylizes the sequence with each window (runs that are there already are resumed) and writes windows.json, windows.md (a
table) and windows.png: two consecutive frames, close up, for the first window above the last one (as in the paper's
figure), with the difference between the change of the one, carried along with the smoke, and that of the other.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tnst_mi import Recipe, activate, advect, render
from tnst_mi.frame import Frame
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.sequence import open_frames
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare
from tnst_mi.run.stored_arrays import StoredArrays

COLUMNS = ("window", "flicker", "relative to 1", "loss before", "loss after", "reduction", "relative to 1", "change")


def stylized(frames: Path, recipe: Recipe, out: Path) -> dict[str, Any]:
    """The record of a run, which is resumed if it has begun."""
    job = Run(prepare(frames, recipe, out, resume=out.exists()))
    for _ in job:
        pass
    if job.record["status"] != "done":
        raise SystemExit("interrupted; the same command goes on")
    return job.record


def rows_of(records: dict[int, dict[str, Any]]) -> list[dict[str, Any]]:
    """What the table says of each window, the first being what the others are compared with."""
    rows = []
    for window, record in records.items():
        sequence = record["sequence"]
        # Scales are found anew in each run: only terms without them can be compared.
        before, after = (sum(sequence[key].values()) for key in ("terms_before", "terms_after"))
        row = {"window": window, "loss_before": before, "loss_after": after, "loss_change": before - after}
        row |= {key: sequence[key] for key in ("flicker", "relative_change")} | {"seconds": record["seconds"]}
        row["peak_memory_bytes"] = record["peak_memory_bytes"]
        rows.append(row)
    for row in rows:
        row["relative_flicker"] = row["flicker"] / rows[0]["flicker"]
        row["relative_loss_change"] = row["loss_change"] / rows[0]["loss_change"]
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """The rows in Markdown."""
    lines = [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    for row in rows:
        # Activations to be raised are losses below 0, of which there is no share.
        share = f"{row['loss_change'] / row['loss_before']:.0%}" if row["loss_before"] > 0 else "–"
        cells = (
            row["window"],
            f"{row['flicker']:.3f}",
            f"{row['relative_flicker']:.2f}",
            f"{row['loss_before']:.4g}",
            f"{row['loss_after']:.4g}",
            share,
            f"{row['relative_loss_change']:.0%}",
            f"{row['relative_change']:.2f}",
        )
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


def close_up(image: np.ndarray) -> tuple[slice, slice]:
    """Half the extent of what is seen, about the middle of its upper part, where the smoke is busiest."""
    rows, columns = (np.flatnonzero(image.max(axis) > 0.1) for axis in (1, 0))
    height, width = max(12, len(rows) // 2), max(12, 2 * len(columns) // 3)
    top, left = rows[0] + len(rows) // 8, columns[0] + (len(columns) - width) // 2
    return slice(top, top + height), slice(left, left + width)


def draw(frames: list[Frame], recipe: Recipe, exposure: float, runs: dict[int, list[np.ndarray]]) -> Figure:
    """Two consecutive frames for each window, and what is new in the second one's change."""
    before = [exposure * picture(frame.density, recipe) for frame in frames]
    part = close_up(before[0])
    figure = Figure(figsize=(9, 3.1 * (len(runs) + 1)), layout="constrained")
    grid = figure.subplots(len(runs) + 1, 3, squeeze=False)
    titles = (frames[0].name, frames[1].name, "what is new in the change")
    for axes in grid.flat:
        axes.set(xticks=[], yticks=[])
    for axes, image in zip(grid[0], before, strict=False):
        axes.imshow(image[part], cmap="gray", vmin=0, vmax=1, interpolation="bicubic")
    grid[0][0].set_ylabel("unstylized")
    grid[0][2].set_visible(False)
    for axes_row, (window, densities) in zip(grid[1:], runs.items(), strict=True):
        changes = [after - frame.density for after, frame in zip(densities, frames, strict=True)]
        new = changes[1] - advect(changes[0], frames[0].velocity, "semi_lagrangian", outside="edge")
        for axes, density in zip(axes_row, densities, strict=False):
            image = exposure * picture(density, recipe)
            axes.imshow(image[part], cmap="gray", vmin=0, vmax=1, interpolation="bicubic")
        strength = np.abs(new).max(0)[::-1][part]
        axes_row[2].imshow(strength, cmap="magma", vmin=0, vmax=1, interpolation="bicubic")
        axes_row[0].set_ylabel(f"window {window}")
    for axes, title in zip(grid[1], titles, strict=True):
        axes.set_title(title, fontsize=10)
    return figure


def picture(density: np.ndarray, recipe: Recipe) -> np.ndarray:
    """Main view (H, W), unexposed."""
    return render(density, recipe.main_view, recipe.gamma, recipe.quadrature)


def main() -> None:
    """Stylize with each window, measure, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--recipe", type=Path, required=True)
    parser.add_argument("--keys", default="", help="further recipe keys in TOML, which apply to windows above 1")
    parser.add_argument("--windows", default="1,5,9")
    parser.add_argument("--shown", type=int, default=None, help="number of the first frame shown (default: the middle)")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    recipe = Recipe.from_toml(arguments.recipe)
    activate(recipe.variant)
    records = {}
    for window in map(int, arguments.windows.split(",")):
        keys = {"window": window} | (tomllib.loads(arguments.keys) if window > 1 else {})
        of_window = recipe.updated(keys, "windows: ", Path.cwd())
        records[window] = stylized(arguments.frames, of_window, arguments.out / f"window_{window}")
    rows = rows_of(records)
    with written_whole(arguments.out / "windows.json") as temporary:
        temporary.write_text(json.dumps(rows, indent=1) + "\n", "utf-8")
    with written_whole(arguments.out / "windows.md") as temporary:
        temporary.write_text(table(rows), "utf-8")
    print(table(rows), end="")

    frames = open_frames(arguments.frames, recipe.frame_range)
    numbers = [record["number"] for record in next(iter(records.values()))["frames"]]
    if arguments.shown is not None and arguments.shown not in numbers[:-1]:
        parser.error(f"--shown {arguments.shown}: expected a frame from {numbers[0]} to {numbers[-2]}")
    first = len(frames) // 2 - 1 if arguments.shown is None else numbers.index(arguments.shown)
    pair = [frames[first], frames[first + 1]]
    runs = {
        window: StoredArrays(arguments.out / f"window_{window}", "density", [frame.name for frame in pair])
        for window in (min(records), max(records))
    }
    figure = draw(pair, recipe, next(iter(records.values()))["exposure"], {w: list(a) for w, a in runs.items()})
    with written_whole(arguments.out / "windows.png") as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))


if __name__ == "__main__":
    main()
