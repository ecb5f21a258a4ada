"""How well drafts and previews predict the final, what they cost, and what is left to do after them.

    python scripts/measure_previews.py [SCENE…] [--out FOLDER] [--weights FILE|FOLDER]

Of each scene: a draft, a preview that goes on from it, a final that goes on from that, and one that begins anew. Prints
the rows of the tables in docs/preview.md, with CPU times, which other work on the machine does not change, beside those
of the clock.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import torch

from tnst_mi.io.pictures.exr import read_exr

SCENES = Path(__file__).resolve().parents[1] / "scenes"

#: By name: the frame, the recipe, and whether that asks for a class of the network that ships with the package.
FRAMES = {
    "suzanne": ("suzanne/frame_0010.npz", "suzanne/recipe.toml", False),
    "jet": ("smokejet/frame_0061.npz", "smokejet/recipe.toml", False),
    "obstacle": ("obstacle/frame_0056.npz", "obstacle/recipe.toml", False),
    "by name": ("smokejet/frame_0061.npz", "by_name.toml", True),
}


def main() -> None:
    """Measure the scenes that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=", ".join(FRAMES))
    parser.add_argument("--out", type=Path, default=Path("previews"))
    parser.add_argument("--weights", help="of the styles; by default, those that are found")
    options = parser.parse_args()
    if unknown := set(options.scenes) - set(FRAMES):
        parser.error(f"{sorted(unknown)[0]}: expected one of {', '.join(FRAMES)}")
    for scene in options.scenes or FRAMES:
        measure(scene, options.out / scene.replace(" ", "_"), options.weights)


def measure(scene: str, out: Path, weights: str | None) -> None:
    """Make the runs of a scene, and print its row."""
    frame, recipe, shipped = FRAMES[scene]
    given = [str(SCENES / frame), "--recipe", str(SCENES / recipe)]
    given += [] if shipped or weights is None else ["--weights", weights]
    times = {
        "draft": stylize(out / "draft", *given, "--quality", "draft"),
        "preview": stylize(out / "preview", *given, "--quality", "preview", "--from", str(out / "draft")),
        "rest": stylize(out / "rest", *given, "--from", str(out / "preview")),
        "final": stylize(out / "final", *given),
    }
    changes = {name: change(out / name) for name in times}
    loss = {name: record(out / name)["loss_after"] for name in times}
    print(scene)
    for one, other in (("draft", "preview"), ("draft", "final"), ("preview", "final")):
        print(f"  {one} → {other}: correlation {correlation(changes[one], changes[other]):.2f}")
    for name, (wall, cpu) in times.items():
        print(f"  {name}: {wall:.1f} s, CPU {cpu:.1f} s, loss {loss[name]:.6g}")
    print(f"  final from preview: {times['rest'][1] / times['final'][1]:.0%} of final's CPU time", flush=True)


def stylize(out: Path, *arguments: str) -> tuple[float, float]:
    """Run the command into a folder; returns the seconds of the clock and of the CPUs, everything included."""
    since, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "tnst_mi", "stylize", *arguments, "--out", str(out), "--overwrite"]
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - since, cpu


def record(out: Path) -> dict:
    """The record of the only frame of a run."""
    return json.loads((out / "run.json").read_text("utf-8"))["frames"][0]


def change(out: Path) -> np.ndarray:
    """After − before in the main view, on the pixels of the draft: 1.8 times as large as those of the final."""
    name = record(out)["name"]
    before, after = (read_exr(out / "images" / f"{name}_{state}.exr") for state in ("before", "after"))
    size = [int(n / 1.8) for n in before.shape]
    difference = torch.from_numpy(np.ascontiguousarray(after - before))[None, None]
    return torch.nn.functional.interpolate(difference, size=size, mode="area").numpy().ravel()


def correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Pearson's."""
    return float(np.corrcoef(one, other)[0, 1])


if __name__ == "__main__":
    main()
