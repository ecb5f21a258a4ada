"""How far the time left that a run shows is from the truth, which is known once it has ended.

    python scripts/measure_time_left.py [--weights FILE|FOLDER]

Five runs: a tiny grid, a small one and a large one of one frame, a sequence, and one with a window. The truth counts
until the results are written, as long as a second is left: the bar shows whole ones. All is counted in seconds of the
CPUs, which other work on the machine does not change.
Prints the rows of a table of docs/performance.md.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

import tnst_mi  # before mitsuba: it chooses the LLVM library
from tnst_mi.fields.resampling import resample_density
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames
from tnst_mi.run import progress
from tnst_mi.run.time_left import OctaveSize, TimeLeft

SCENES = Path(__file__).resolve().parents[1] / "scenes"

#: (octave, seconds left as estimated, when), after every iteration.
Estimates = list[tuple[int, float, float]]


def main() -> None:
    """Measure all runs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights")
    weights = parser.parse_args().weights
    jet = list(load_frames(SCENES / "smokejet"))
    recipe: dict[str, Any] = {"style": ["flames"], "views": 3, "weights": weights}
    runs = {
        "16×24×16, one frame": (resampled(jet[:1], (16, 24, 16)), {"octaves": 3}),
        "48×72×48, one frame": (jet[4:5], {"octaves": 2}),
        "128×192×128, one frame": (resampled(jet[4:5], (128, 192, 128)), {"octaves": 3, "iterations": 10}),
        "48×72×48, 4 frames": (jet[4:8], {"octaves": 2, "iterations": 10}),
        "48×72×48, 4 frames, window 3": (jet[4:8], {"octaves": 2, "iterations": 10, "window": 3}),
    }
    for name, (frames, keys) in runs.items():
        estimates, end = run(frames, recipe | keys)
        print(f"{name}: {row(estimates, end)}", flush=True)


def resampled(frames: list[Frame], shape: tuple[int, int, int]) -> list[Frame]:
    """The frames on a grid of another fineness, without velocities."""
    tnst_mi.activate()
    found = []
    for frame in frames:
        h = frame.density.shape[1] / shape[1]
        density = resample_density(mi.TensorXf(frame.density), 1.0, shape, h).numpy()
        found.append(Frame(np.maximum(density, 0), name=frame.name, number=frame.number))
    return found


def run(frames: list[Frame], recipe: dict[str, Any]) -> tuple[Estimates, float]:
    """Stylize into a folder; the estimates, and when it had ended."""
    estimates: Estimates = []

    class Noted(TimeLeft):
        def __init__(self, sizes: Sequence[OctaveSize], cells: int, frames: int) -> None:
            super().__init__(sizes, cells, frames, time.process_time)

        def after(self, octave: int, done: int, total: int) -> float:
            left = super().after(octave, done, total)
            estimates.append((octave, left, time.process_time()))
            return left

    progress.TimeLeft = Noted
    with tempfile.TemporaryDirectory() as folder:
        tnst_mi.stylize(frames, recipe, Path(folder) / "out", progress=False)
        return estimates, time.process_time()


def row(estimates: Estimates, end: float) -> str:
    """The errors: in the middle of the first octave, and from the second iteration of the second on."""
    first = [entry for entry in estimates if entry[0] == 0]
    _, left, when = first[len(first) // 2]
    later = [entry for entry in estimates if entry[0] > 0 and end - entry[2] >= 1][1:]
    errors = np.array([left / (end - when) - 1 for _, left, when in later])
    writing = end - estimates[-1][2]
    total = end - estimates[0][2]
    within, at_first = np.mean(np.abs(errors) <= 0.25), left / (end - when) - 1
    return (
        f"{total:.1f} s, of which {writing:.1f} s after the last iteration; first octave {at_first:+.0%}; "
        f"from the second on {errors.min():+.0%} to {errors.max():+.0%}, {within:.0%} of them within 25%"
    )


if __name__ == "__main__":
    main()
