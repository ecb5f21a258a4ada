"""How near the colours of smoke come that are found from pictures: numbers, and a figure.

    python scripts/measure_colour_reconstruction.py scenes/obstacle/frame_0056.npz --out measured/ [--figure colour.png]

The smoke gets a colour that changes in all directions, of which the strongest channel is 1 everywhere. Its views are
rendered, with noise and without, and it is found again from these, and as grey smoke. What is there already is kept.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from render_views import write_views

import tnst_mi
from tnst_mi.io.pictures.png import write_png
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.reconstruction.output.sides import three_sides
from tnst_mi.rendering.coloured_renderer import ColouredRenderer

GAMMA = 0.1

#: Of the figure: times that each pixel is repeated.
_LARGER = 3


def coloured(frame: tnst_mi.Frame) -> tnst_mi.Frame:
    """The frame in colours that change from warm to cold upwards, and with the distance from the middle."""
    z, y, x = (places / n for places, n in zip(np.indices(frame.density.shape), frame.density.shape, strict=True))
    across = np.abs(2 * x - 1) + 0.3 * np.sin(9 * z)
    colour = np.stack([1.9 - 2.2 * y, 1.1 - 1.6 * across, 2.2 * y - 0.4], axis=-1).clip(0.05, 1)
    grids = {"Cd": (colour / colour.max(axis=-1, keepdims=True)).astype(np.float32)}
    return tnst_mi.Frame(frame.density, grids=grids, name="coloured")


class ColourBench:
    """The coloured frame and what is found of it.

    Args:
        frame: a density.
        out: folder for pictures and results.
    """

    def __init__(self, frame: tnst_mi.Frame, out: Path) -> None:
        self.frame, self.out = coloured(frame), out
        side = max(frame.density.shape)
        self.renderer = ColouredRenderer(frame.density.shape, GAMMA, "exact", 1.0, size=(side, side))

    def found(self, views: int, noise: float, channel: str) -> tuple[Path, str]:
        """Reconstruct from so many views; gives the folder and a row of the table."""
        folder = self.out / f"views_{views}_{noise:g}"
        if not (folder / "cameras.toml").is_file():
            write_views(folder, [self.frame], self.renderer, (views, 8), noise, GAMMA)
        out = folder / channel
        resumed = (out / "state.safetensors").is_file()
        found = tnst_mi.reconstruct(folder / "cameras.toml", out, {"channel": channel}, resume=resumed)
        with np.load(found.densities[0]) as file:
            density, colour = file["density"], file.get("Cd")
        true = self.frame.density
        told = f"{np.linalg.norm(density - true) / np.linalg.norm(true):.3f}"
        error = "–"
        if colour is not None:
            squares = ((colour - self.frame.grids["Cd"]) ** 2).mean(axis=-1)
            error = f"{np.sqrt((squares * true).sum() / true.sum()):.3f}"
        record = found.records[0]
        name = f"{views} views{f', {noise:.0%} noise' if noise else ''}, {channel}"
        return out, f"| {name} | {record['psnr']:.1f} dB | {told} | {error} | {record['seconds']:.0f} |"


def write_comparison(path: Path, truth: tnst_mi.Frame, found: Path) -> None:
    """Write a picture: above the truth from three sides, below what was found."""
    rows = []
    for density, colour in ((truth.density, truth.grids["Cd"]), _read(found)):
        rows.append(three_sides(GAMMA * density, colour))
    picture = np.concatenate(rows).repeat(_LARGER, 0).repeat(_LARGER, 1)
    write_png(path, srgb(picture.clip(0, 1)))


def _read(found: Path) -> tuple[np.ndarray, np.ndarray]:
    with np.load(found / "density" / "smoke.npz") as file:
        return file["density"], file["Cd"]


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frame", type=Path, help="a density file")
    parser.add_argument("--out", type=Path, required=True, help="folder for pictures and results")
    parser.add_argument("--figure", type=Path, help="write the truth and what was found from 36 views as PNG")
    parser.add_argument("--only", type=int, help="number of the one row to measure, from 0")
    given = parser.parse_args()
    tnst_mi.activate()
    bench = ColourBench(tnst_mi.load_frames(given.frame)[0], given.out)
    rows = [(9, 0.0, "rgb"), (36, 0.0, "rgb"), (36, 0.0, "luminance"), (36, 0.01, "rgb")]
    print("| pictures | held-out PSNR | density, relative L2 | colour, RMS | seconds |\n|---|---|---|---|---|")
    for views, noise, channel in rows if given.only is None else [rows[given.only]]:
        out, row = bench.found(views, noise, channel)
        print(row, flush=True)
        if given.figure and (views, noise, channel) == (36, 0.0, "rgb"):
            write_comparison(given.figure, bench.frame, out)


if __name__ == "__main__":
    main()
