"""Measure what grows while a process stylizes many frames, and many times.

    python scripts/long_runs.py [--frames 200] [--runs 30] [--window 1] [--out FOLDER]

A drifting ball of 16×24×16 cells is stylized as a sequence into a folder, and after each of its frames these are noted:

memory     resident, in MB, after Python's garbage collection
threads    of the process
files      that are open
variables  of Dr.Jit; those of up to 512 numbers that differ from frame to frame are kept
kernels    of Dr.Jit that were compiled or loaded for this frame
seconds    since the frame before
read       bytes that were read from files, in MB

Then one frame is stylized again and again, each time as a run of its own, and the same is noted. Prints the medians of
the second quarter (the first one warms up) and of the last, and writes all values to FOLDER/long_runs.json.
"""

from __future__ import annotations

import tnst_mi  # first: it lets torch's idle threads sleep

# isort: split
import argparse
import gc
import json
import re
import statistics
import tempfile
import time
from pathlib import Path

import drjit as dr
import numpy as np
import psutil

from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare

SHAPE = (16, 24, 16)
RECIPE = {"style": ["spirals"], "octaves": 2, "iterations": 3, "views": 2, "weights": "patterns"}

Values = dict[str, float]


def kernels() -> int:
    """How many kernels Dr.Jit has compiled, or loaded from its cache on disk, in this process."""
    # Its history of kernels would tell, but takes gigabytes in a long run.
    found = re.search(r"(\d+) soft, (\d+) hard misses", dr.whos(as_string=True))
    assert found is not None
    return int(found[1]) + int(found[2])


class Meter:
    """Takes the values, each time those since the last."""

    def __init__(self) -> None:
        self._process = psutil.Process()
        self._at, self._read, self._kernels = time.perf_counter(), self._bytes_read(), kernels()

    def _bytes_read(self) -> int:
        return self._process.io_counters().read_chars

    def values(self) -> Values:
        """The values now; taking them counts for nothing."""
        seconds, read = time.perf_counter() - self._at, self._bytes_read() - self._read
        gc.collect()
        found = {
            "memory": self._process.memory_info().rss / 1e6,
            "threads": self._process.num_threads(),
            "files": self._process.num_fds(),
            "variables": len(re.findall(r"^ *\d+ ", dr.whos(as_string=True), re.MULTILINE)),
            "kernels": kernels() - self._kernels,
            "seconds": seconds,
            "read": read / 1e6,
        }
        self._at, self._read, self._kernels = time.perf_counter(), self._bytes_read(), kernels()
        return found


def ball(number: int) -> Frame:
    """A ball that drifts upwards by a tenth of a cell per frame, and down again."""
    z, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in SHAPE), indexing="ij")
    height = 4 * np.sin(number / 40)
    distance = np.sqrt(x**2 + (y - height) ** 2 + z**2)
    velocity = np.zeros((*SHAPE, 3), np.float32)
    velocity[..., 1] = 0.1 * np.cos(number / 40)
    return Frame(np.clip(6 - distance, 0, 1), velocity, name=f"ball_{number:04d}", number=number)


def sequence(frames: Path, out: Path, window: int) -> list[Values]:
    """The values after each frame of one run."""
    run, values = Run(prepare(frames, Recipe.from_dict(RECIPE | {"window": window}), out), progress=False), []
    meter = Meter()
    for _ in run:
        values.append(meter.values())
    return values


def repeated(count: int, folder: Path) -> list[Values]:
    """The values after each of many runs of one frame."""
    meter, values = Meter(), []
    for number in range(count):
        tnst_mi.stylize(ball(0), RECIPE, folder / str(number), progress=False)
        values.append(meter.values())
    return values


def table(title: str, values: list[Values]) -> str:
    """Medians of the second and the last quarter."""
    quarter = max(1, len(values) // 4)
    lines = [f"{title:<22} {'second quarter':>15} {'last quarter':>15}"]
    for name in values[0]:
        early, late = (
            statistics.median(of[name] for of in part) for part in (values[quarter : 2 * quarter], values[-quarter:])
        )
        lines.append(f"{name:<22} {early:>15.4g} {late:>15.4g}")
    return "\n".join(lines)


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--window", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("long_runs"))
    given = parser.parse_args()
    tnst_mi.activate()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_frames(folder / "in", [ball(number) for number in range(given.frames)])
        measured = {
            f"frames of {given.frames}": sequence(folder / "in", folder / "out", given.window),
            f"runs of {given.runs}": repeated(given.runs, folder / "runs"),
        }
    for title, values in measured.items():
        print(table(title, values))
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "long_runs.json").write_text(json.dumps(measured, indent=1), "utf-8")


if __name__ == "__main__":
    main()
