"""How well smoke is reconstructed: by the number of views, with noise beside SART, and by the wrong renderer.

    python scripts/measure_reconstruction.py FRAME --out FOLDER [--only ROW…] [--figure FILE]

Renders FRAME from known cameras (scripts/render_views.py), reconstructs it, and prints a table in Markdown: the PSNR of
views that were held out, without noise; that of the pixels alone that show smoke; the relative L2 distance of the
density; seconds. Rows with more or less noise, and those of scattered light, are at half the resolution. Each row is
kept in FOLDER as it is measured, and one that was stopped goes on.

SART (Andersen and Kak 1984) is linear: it fits line integrals, here −log(1 − γ I) / γ, by the same rays and weights,
with negative values set to 0. Its row is that of the sweep and the relaxation with the least distance from the truth,
which nobody knows who has pictures alone: a bound on what it can do.

--figure shows a view that was held out, and the density in a plane, for 9, 18 and 36 views.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from matplotlib.figure import Figure
from render_views import camera_at, places, radius_around, write_views

import tnst_mi
from tnst_mi.fields.grid import octaves
from tnst_mi.fields.resampling import resample_density
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.pictures.exr import read_exr
from tnst_mi.recipe.paths import LIGHTS
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer

GAMMA, HELD_OUT, NOISE, ALBEDO = 0.1, 8, 0.01, 0.8

#: Relaxations and iterations of SART that are tried.
RELAXATIONS, SWEEPS = (1.0, 0.5, 0.2), 12

#: The least opacity of what is left of light: pixels are clipped there before the logarithm.
DARKEST = 5e-3


def sart(
    images: np.ndarray,
    cameras: list[tnst_mi.Camera],
    renderer: EmissionAbsorptionRenderer,
    gamma: float,
    relaxation: float,
) -> Iterator[np.ndarray]:
    """Densities after each sweep over all views.

    Args:
        images: (V, rows, columns) of emission and absorption.
        cameras: V.
        renderer: of an empty grid with γ = 1, whose derivatives are the line integrals and their adjoint.
        gamma: of the images.
        relaxation: above 0, at most 1.
    """
    nothing = mi.TensorXf(np.zeros(renderer.shape, np.float32))

    def integrals(density: np.ndarray, camera: tnst_mi.Camera) -> np.ndarray:
        return renderer.tangent(nothing, [camera], (0,), mi.TensorXf(density)).numpy()[0]

    def spread(image: np.ndarray, camera: tnst_mi.Camera) -> np.ndarray:
        weights = mi.TensorXf(image[None])
        empty = mi.TensorXf(np.zeros_like(image)[None])
        return renderer.gradient(nothing, [camera], (0,), empty, weights).numpy()

    ones, density = np.ones(renderer.shape, np.float32), np.zeros(renderer.shape, np.float32)
    lengths = [integrals(ones, camera) for camera in cameras]
    weights = [spread(np.ones(renderer.size, np.float32), camera) for camera in cameras]
    depths = -np.log(np.maximum(1 - gamma * images, DARKEST)) / gamma
    order = np.random.default_rng(0).permutation(len(cameras))
    for _ in range(SWEEPS):
        for view in order:
            wrong = depths[view] - integrals(density, cameras[view])
            share = np.divide(wrong, lengths[view], out=np.zeros_like(wrong), where=lengths[view] > 1e-3)
            back = spread(share.astype(np.float32), cameras[view])
            change = np.divide(back, weights[view], out=np.zeros_like(back), where=weights[view] > 1e-3)
            density = np.maximum(density + relaxation * change, 0).astype(np.float32)
        yield density


class Bench:
    """A frame, its cameras, and what becomes of it."""

    def __init__(self, frame: tnst_mi.Frame, gamma: float, out: Path) -> None:
        self.density, self.frame, self.gamma, self.out = frame.density, frame, gamma, out
        side = max(self.density.shape)
        self.renderer = EmissionAbsorptionRenderer(self.density.shape, gamma, "exact", 1.0, size=(side, side))
        radius = radius_around(self.density.shape)
        self.judges = [camera_at(place) for place in places(HELD_OUT, radius, 0.37)]
        self.truth = self.renderer.render(mi.TensorXf(self.density), self.judges).numpy()

    def judged(self, density: np.ndarray) -> dict[str, float]:
        """How near a density comes."""
        seen = self.renderer.render(mi.TensorXf(density), self.judges).numpy()
        squares, peak = ((seen - self.truth) / self.truth.max()) ** 2, self.truth.max()
        return {
            "psnr": -10 * float(np.log10(squares.mean())),
            "psnr_smoke": -10 * float(np.log10(squares[self.truth > 0.01 * peak].mean())),
            "distance": float(np.linalg.norm(density - self.density) / np.linalg.norm(self.density)),
        }

    def reconstructed(self, name: str, views: int, noise: float, keys: dict[str, Any]) -> dict[str, float]:
        """Of so many views with noise."""
        folder = self._pictures(name, views, noise)
        density, record = self._found(
            folder / "cameras.toml", folder / ("out_" + "_".join(keys) if keys else "out"), keys
        )
        return self.judged(density) | {"seconds": record["seconds"], "gamma": record["gamma"]}

    def scattered(self, name: str, views: int, keys: dict[str, Any]) -> dict[str, float]:
        """Of path-traced views, in which the smoke scatters the key light."""
        folder = self.out / "scattering"
        if not (folder / "cameras.toml").is_file():
            lighting = Lighting(ALBEDO, 0.0, LIGHTS / "key.xml", 32)
            renderer = ScatteringRenderer(self.density.shape, self.gamma, 1.0, lighting, self.renderer.size)
            write_views(folder, [self.frame], renderer, (views, HELD_OUT), 0.0, self.gamma)
        density, record = self._found(folder / "cameras.toml", self.out / name, keys)
        # Views of their own kind judge it: those of emission and absorption show another light.
        distance = self.judged(density)["distance"]
        return {"psnr": record["psnr"], "distance": distance, "seconds": record["seconds"]}

    def sart(self, name: str, views: int, noise: float) -> dict[str, float]:
        """The best of SART, of the same pictures as `reconstructed`."""
        folder = self._pictures(name, views, noise)
        cameras = [camera_at(place) for place in places(views, radius_around(self.density.shape))]
        images = np.stack([read_exr(folder / f"view_{number:02d}.exr") for number in range(views)])
        linear = EmissionAbsorptionRenderer(self.density.shape, 1.0, "exact", 1.0, size=self.renderer.size)
        begun = time.perf_counter()
        found = [
            self.judged(density) for step in RELAXATIONS for density in sart(images, cameras, linear, self.gamma, step)
        ]
        return min(found, key=lambda one: one["distance"]) | {"seconds": time.perf_counter() - begun}

    def _pictures(self, name: str, views: int, noise: float) -> Path:
        """The folder with so many views with noise, which is written if it is not there."""
        folder = self.out / name
        if not (folder / "cameras.toml").is_file():
            write_views(folder, [self.frame], self.renderer, (views, HELD_OUT), noise, self.gamma)
        return folder

    def _found(self, cameras: Path, out: Path, keys: dict[str, Any]) -> tuple[np.ndarray, dict[str, Any]]:
        """The density, and what its record says."""
        resumed = (out / "state.safetensors").is_file()
        found = tnst_mi.reconstruct(cameras, out, keys, resume=resumed, overwrite=not resumed)
        if found.interrupted:
            raise SystemExit("stopped; the same command goes on")
        with np.load(found.densities[0]) as file:
            return file["density"], dict(found.records[0])


def halved(frame: tnst_mi.Frame) -> tnst_mi.Frame:
    """The same density in cells twice as large."""
    shape = octaves(frame.density.shape, 2, 2.0)[0].shape
    return tnst_mi.Frame(resample_density(frame.density, 1.0, shape, frame.density.shape[1] / shape[1]))


def rows(bench: Bench, half: Bench) -> dict[str, Callable[[], dict[str, float]]]:
    """What is measured at the full resolution and at half of it, by name."""
    traced = {"integrator": "prbvolpath", "albedo": ALBEDO, "light": "key", "spp": 4, "iterations": 80, "levels": 2}
    return {
        "9 views": lambda: bench.reconstructed("views_9", 9, 0.0, {}),
        "18 views": lambda: bench.reconstructed("views_18", 18, 0.0, {}),
        "36 views": lambda: bench.reconstructed("views_36", 36, 0.0, {}),
        "36 views, 1% noise": lambda: bench.reconstructed("noise_36", 36, NOISE, {}),
        "36 views, 1% noise, SART": lambda: bench.sart("noise_36", 36, NOISE),
        "36 views, SART": lambda: bench.sart("views_36", 36, 0.0),
        "36 views, γ unknown": lambda: bench.reconstructed("views_36", 36, 0.0, {"gamma": "auto"}),
        "half, 18 views, 0.5% noise": lambda: half.reconstructed("noise_05", 18, 0.005, {}),
        "half, 18 views, 0.5% noise, SART": lambda: half.sart("noise_05", 18, 0.005),
        "half, 18 views, 1% noise": lambda: half.reconstructed("noise_1", 18, 0.01, {}),
        "half, 18 views, 1% noise, SART": lambda: half.sart("noise_1", 18, 0.01),
        "half, 18 views, 3% noise": lambda: half.reconstructed("noise_3", 18, 0.03, {}),
        "half, 18 views, 3% noise, SART": lambda: half.sart("noise_3", 18, 0.03),
        "scattering, by prbvolpath": lambda: half.scattered("traced", 18, traced),
        "scattering, by prbvolpath, longer": lambda: half.scattered(
            "longer", 18, traced | {"spp": 8, "iterations": 150}
        ),
        "scattering, by emission and absorption": lambda: half.scattered("gap", 18, {"gamma": "auto"}),
    }


def drawn(bench: Bench, path: Path) -> None:
    """Draw a held-out view and the plane with the most smoke, by 9, 18 and 36 views, as a picture."""
    plane = int(bench.density.sum(axis=(1, 2)).argmax())
    titles = ("picture, held out", "rendering", "ten times the difference", "density in a plane", "density found")
    figure = Figure(figsize=(10, 7), layout="constrained", facecolor="white")
    axes = figure.subplots(3, 5, width_ratios=(3, 3, 3, 2, 2))
    for row, views in zip(axes, (9, 18, 36), strict=True):
        folder = bench.out / f"views_{views}"
        picture, seen = (
            read_exr(folder / "held_out_00.exr"),
            read_exr(folder / "out" / "images" / "smoke_held_out_00.exr"),
        )
        with np.load(folder / "out" / "density" / "smoke.npz") as file:
            found = file["density"][plane]
        shown = (picture, seen, 10 * np.abs(seen - picture), bench.density[plane][::-1], found[::-1])
        for axis, image, title in zip(row, shown, titles if views == 9 else ("",) * 5, strict=True):
            most = picture.max() if image.shape == picture.shape else bench.density[plane].max()
            axis.imshow(image, cmap="gray", vmin=0, vmax=most, aspect="equal")
            axis.set(xticks=[], yticks=[], title=title)
        row[0].set_ylabel(f"{views} views")
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=90)


def main() -> None:
    """Measure what is not measured yet, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frame", type=Path, help="a density file")
    parser.add_argument("--out", type=Path, required=True, help="folder for pictures, results and numbers")
    parser.add_argument("--only", nargs="*", metavar="ROW", help="names of rows; all by default")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="a PNG file of what was found from clean pictures")
    given = parser.parse_args()
    tnst_mi.activate()
    frame, kept = tnst_mi.load_frames(given.frame)[0], given.out / "numbers.json"
    bench = Bench(frame, GAMMA, given.out)
    # γ is per cell: smoke in fewer cells is as thick by more of it.
    half = Bench(halved(frame), 2 * GAMMA, given.out / "half")
    numbers = json.loads(kept.read_text("utf-8")) if kept.is_file() else {}
    for name, measure in rows(bench, half).items():
        if name in numbers or (given.only and name not in given.only):
            continue
        numbers[name] = measure()
        with written_whole(kept) as temporary:
            temporary.write_text(json.dumps(numbers, indent=1) + "\n", "utf-8")
    print("| pictures | held-out PSNR | where there is smoke | density, relative L2 | seconds |\n|---|---|---|---|---|")
    for name, n in numbers.items():
        smoke = f"{n['psnr_smoke']:.1f} dB" if "psnr_smoke" in n else "–"
        print(f"| {name} | {n['psnr']:.1f} dB | {smoke} | {n['distance']:.3f} | {n['seconds']:.0f} |")
    if given.figure:
        drawn(bench, given.figure)


if __name__ == "__main__":
    main()
