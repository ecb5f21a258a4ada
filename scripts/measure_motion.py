"""How well a sequence is reconstructed where its velocities are estimated, known, or left out.

    python scripts/measure_motion.py FRAMES --frames 52:57 --out FOLDER [--views 4 9] [--only MODE…] [--figure FILE]

Renders the frames of a simulation from known cameras (scripts/render_views.py), reconstructs them in three ways, and
prints two tables in Markdown: of each frame the PSNR of views that were held out and the relative L2 distance of the
density; of each velocity that was estimated its distance from the simulation's, beside that of no velocity at all, and
its angle to it, where there is smoke. What was stopped goes on by the same command. The figure shows the distances, and
velocities in a plane.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from render_views import write_views

import tnst_mi
from tnst_mi.io import open_frames
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

GAMMA, HELD_OUT = 0.1, 8

#: What is measured: its name, and what is given as velocities; None stands for the simulation.
MODES = {"as it is": "none", "estimated": "estimate", "known": None}

#: Density above which there is smoke, in parts of the largest, and speed below which a direction is none.
SMOKE, RESTS = 0.05, 0.3


def measured(truth: tnst_mi.Frame, found: tnst_mi.Frame, record: Any) -> dict[str, float]:
    """How near a frame comes to the simulation."""
    distance = np.linalg.norm(found.density - truth.density) / np.linalg.norm(truth.density)
    told = {"number": truth.number, "psnr": record["psnr"], "distance": float(distance), "seconds": record["seconds"]}
    if found.velocity is None or record["velocity"]["source"] != "estimated":
        return told
    assert truth.velocity is not None
    smoke = truth.density > SMOKE * truth.density.max()
    u, v = found.velocity[smoke], truth.velocity[smoke]
    speed, own = np.linalg.norm(v, axis=1), np.linalg.norm(u, axis=1)
    moves = speed > RESTS
    cosine = (u * v).sum(1)[moves] / np.maximum(speed * own, 1e-9)[moves]
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    told |= {"error": float(np.linalg.norm(u - v, axis=1).mean()), "speed": float(speed.mean())}
    return told | {"angle": float(angle.mean()), "motion_seconds": record["velocity"]["seconds"]}


def reconstructed(
    folder: Path, cameras: Path, span: str, mode: str, simulation: Path
) -> list[tuple[tnst_mi.Frame, Any]]:
    """The frames that are found in one of the three ways, and their records."""
    out = folder / mode.replace(" ", "_")
    resumed = (out / "state.safetensors").is_file()
    velocities = MODES[mode] or simulation
    found = tnst_mi.reconstruct(cameras, out, frames=span, velocities=velocities, resume=resumed, overwrite=not resumed)
    if found.interrupted:
        raise SystemExit("stopped; the same command goes on")
    return [(open_frames(file)[0], record) for file, record in zip(found.densities, found.records, strict=True)]


def draw(path: Path, numbers: dict[tuple[int, str], list[dict[str, float]]], pair: tuple[Any, Any]) -> None:
    """Distances by frame, and velocities of the simulation and of its pictures in the middle plane."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 5), layout="constrained", width_ratios=(1.5, 1, 1))
    colours = {"as it is": "tab:red", "estimated": "tab:blue", "known": "tab:green"}
    for (views, mode), frames in numbers.items():
        style = "-" if views == max(v for v, _ in numbers) else "--"
        label, numbered = f"{mode}, {views} views", [frame["number"] for frame in frames]
        axes[0].plot(numbered, [f["distance"] for f in frames], style, color=colours[mode], label=label)
    axes[0].set(xlabel="frame", ylabel="density, relative L2 distance", ylim=(0, None))
    axes[0].legend(fontsize=8)
    for axis, frame, title in zip(axes[1:], pair, ("simulation", "from pictures"), strict=True):
        middle = frame.density.shape[0] // 2
        axis.imshow(frame.density[middle], origin="lower", cmap="Greys", vmax=1.2)
        u = frame.velocity[middle]
        y, x = np.nonzero(np.linalg.norm(u, axis=-1) > RESTS)
        y, x = y[(y % 3 == 0) & (x % 3 == 0)], x[(y % 3 == 0) & (x % 3 == 0)]
        arrows = {"angles": "xy", "scale_units": "xy", "scale": 0.4, "width": 0.008, "color": "tab:blue"}
        axis.quiver(x, y, u[y, x, 0], u[y, x, 1], **arrows)
        axis.text(0.04, 0.03, title, transform=axis.transAxes)
        axis.set(xticks=[], yticks=[])
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input", type=Path, help="folder of numbered frames with velocities")
    parser.add_argument("--frames", required=True, help="FIRST:LAST")
    parser.add_argument("--out", type=Path, required=True, help="folder for pictures and results")
    parser.add_argument("--views", type=int, nargs="+", default=[4, 9])
    parser.add_argument("--only", nargs="+", choices=MODES, default=list(MODES))
    parser.add_argument("--figure", type=Path, help="PNG to draw")
    given = parser.parse_args()
    tnst_mi.activate()
    first, last = (int(part) for part in given.frames.split(":"))
    truth = list(open_frames(given.input, (first, last)))
    side = max(truth[0].density.shape)
    renderer = EmissionAbsorptionRenderer(truth[0].density.shape, GAMMA, "exact", 1.0, size=(side, side))
    numbers: dict[tuple[int, str], list[dict[str, float]]] = {}
    pair = None
    for views in given.views:
        folder = given.out / f"{views}_views"
        if not (folder / "cameras.toml").is_file():
            write_views(folder, truth, renderer, (views, HELD_OUT), 0.0, GAMMA)
        for mode in given.only:
            frames = reconstructed(folder, folder / "cameras.toml", given.frames, mode, given.input)
            numbers[views, mode] = [measured(t, *found) for t, found in zip(truth, frames, strict=True)]
            if mode == "estimated":
                pair = truth[-2], frames[-2][0]
    print(tables(numbers, [frame.number for frame in truth]))
    if given.figure and pair:
        draw(given.figure, numbers, pair)


def tables(numbers: dict[tuple[int, str], list[dict[str, float]]], frames: list[int | float | None]) -> str:
    """The numbers in Markdown."""
    heads = " | ".join(str(frame) for frame in frames)
    lines = [f"| views | velocities | {heads} | seconds |", "|" + "---|" * (len(frames) + 3)]
    for (views, mode), found in numbers.items():
        cells = " | ".join(f"{one['psnr']:.1f} dB, {one['distance']:.3f}" for one in found)
        seconds = np.mean([one["seconds"] + one.get("motion_seconds", 0) for one in found[1:]])
        lines.append(f"| {views} | {mode} | {cells} | {seconds:.0f} |")
    lines += ["", "| views | error, cells per frame | of no velocity | angle |", "|---|---|---|---|"]
    for (views, _), found in numbers.items():
        moved = [one for one in found if "error" in one]
        if moved:
            error, speed, angle = (np.mean([one[name] for one in moved]) for name in ("error", "speed", "angle"))
            lines.append(f"| {views} | {error:.2f} | {speed:.2f} | {angle:.0f}° |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
