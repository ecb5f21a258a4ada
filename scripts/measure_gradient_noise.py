"""Noise and bias of the gradients of renderers, against what they cost: a fixed weighted sum of the pixels of one view.

    python scripts/measure_gradient_noise.py [FRAME] --out FOLDER [--albedo 0 0.3 0.8] [--repeats 12] [--draw FILE.png]

Each estimate is repeated with other random numbers, all in turn. The sums are kept in FOLDER, so that the script goes
on where it was stopped; at the end it prints a table, and --draw draws it. Noise is the RMS over all cells in or beside
smoke of the standard deviation, in parts of the RMS of the gradient. Bias is the RMS of the deviation of the mean from
a reference, likewise, from products of independent halves, so that noise does not count: 0 on average without bias. The
reference is ours with the most paths, which finite differences of `prbvolpath` check along directions. Seconds are
those of the processor, of all threads.
"""

from __future__ import annotations

import tnst_mi  # first: it lets torch's idle threads sleep

# isort: split
import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from noise_measures.plain import PlainPathTracer

from tnst_mi.compare.path_tracing import PathTracer
from tnst_mi.io.atomic import written_whole
from tnst_mi.recipe.paths import LIGHTS
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer, Renderer
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer
from tnst_mi.rendering.shadows import beside_smoke

FRAME = Path(__file__).resolve().parents[1] / "scenes" / "suzanne" / "frame_0010.npz"
VIEW = [(0.0, 0.0)]
GAMMA = 0.3
SPP = (1, 4, 16, 64)

#: Densities above this count as thick smoke.
THICK = 0.05

#: Single cells whose derivative is taken by finite differences, and the step in density to either side.
CELLS, CELL_STEP = 6, 0.1

#: The albedo at which finite differences are taken, which are slow.
CHECKED_ALBEDO = 0.3

#: Directions along which the reference is checked: steps to either side in parts of the direction.
DIRECTION_STEP, DIRECTION_SPP = 0.1, 64

Gradient = Callable[[int], np.ndarray]


class Sums:
    """Of repeated estimates of a field: those of even and odd numbers, of the squares, and the seconds of each."""

    def __init__(self, path: Path, shape: tuple[int, ...]) -> None:
        self.path, self.seconds = path, []
        self.halves, self.squares = np.zeros((2, *shape)), np.zeros(shape)
        if path.exists():
            with np.load(path) as file:
                self.halves, self.squares = file["halves"], file["squares"]
                self.seconds = file["seconds"].tolist()

    def add(self, value: np.ndarray, seconds: float) -> None:
        """Add an estimate, and write all of it."""
        self.halves[len(self.seconds) % 2] += value
        self.squares += np.square(value, dtype=np.float64)
        self.seconds.append(seconds)
        with written_whole(self.path) as temporary, temporary.open("wb") as file:
            np.savez(file, halves=self.halves, squares=self.squares, seconds=self.seconds)

    @property
    def mean(self) -> np.ndarray:
        """The mean of all estimates."""
        return self.halves.sum(0) / len(self.seconds)

    @property
    def variance(self) -> np.ndarray:
        """The variance of one estimate, without bias."""
        n = len(self.seconds)
        return np.maximum(self.squares / n - self.mean**2, 0) * n / (n - 1)

    @property
    def half_means(self) -> np.ndarray:
        """The means (2, …) of two independent halves."""
        n = len(self.seconds)
        return self.halves / np.array([(n + 1) // 2, n // 2]).reshape(2, *[1] * self.squares.ndim)


class Bench:
    """One frame, one view, one objective."""

    def __init__(self, density: np.ndarray, folder: Path) -> None:
        self.density, self.folder = density, folder
        self.smoke = mi.TensorXf(density)
        self.weights = smooth((1, *density.shape[1:]), 4.0, 1)
        self.near = beside_smoke(self.smoke.array, density.shape).numpy().reshape(density.shape)
        random = np.random.default_rng(2)
        filled = np.argwhere(density > THICK)
        self.cells = filled[random.choice(len(filled), CELLS, replace=False)]

    def by_adjoint(self, renderer: Renderer) -> Gradient:
        """All of an iteration's rendering: the images, and the derivative of the objective."""

        def gradient(number: int) -> np.ndarray:
            images = renderer.images(self.smoke, VIEW, [number])
            dr.eval(images)
            return renderer.gradient(self.smoke, VIEW, [number], images, mi.TensorXf(self.weights)).numpy()

        return gradient

    def by_differences(self, renderer: Renderer) -> Gradient:
        """The derivatives with respect to the single cells, by central differences with common random numbers."""

        def gradient(number: int) -> np.ndarray:
            return np.array([self.slope(renderer, self.only(cell), CELL_STEP, number) for cell in self.cells])

        return gradient

    def only(self, cell: np.ndarray) -> np.ndarray:
        """The direction of a single cell."""
        direction = np.zeros_like(self.density)
        direction[tuple(cell)] = 1.0
        return direction

    def slope(self, renderer: Renderer, direction: np.ndarray, step: float, number: int) -> float:
        """The derivative of the objective along a direction, by central differences; by those to one side, where smoke
        would be less than none on the other."""
        back = -step if (self.density >= step * direction).all() else 0.0
        values = []
        for along in (step, back):
            moved = (self.density + along * direction).astype(np.float32)
            image = renderer.images(mi.TensorXf(moved), VIEW, [number]).numpy()
            values.append(float((self.weights * image).sum(dtype=np.float64)))
        return (values[0] - values[1]) / (step - back)

    def sums(self, name: str, shape: tuple[int, ...] | None = None) -> Sums:
        """What is kept of an estimator."""
        return Sums(self.folder / f"{name}.npz", self.density.shape if shape is None else shape)


def smooth(shape: tuple[int, ...], sigma: float, seed: int) -> np.ndarray:
    """Gaussian noise of standard deviation 1, smoothed over `sigma` cells: float32."""
    spectrum = np.fft.fftn(np.random.default_rng(seed).normal(size=shape))
    for axis, n in enumerate(shape):
        frequency = np.fft.fftfreq(n).reshape([-1 if i == axis else 1 for i in range(len(shape))])
        spectrum *= np.exp(-2 * (np.pi * sigma * frequency) ** 2)
    field = np.fft.ifftn(spectrum).real
    return (field / field.std()).astype(np.float32)


def estimators(bench: Bench, albedo: float) -> dict[str, tuple[Gradient, tuple[int, ...] | None]]:
    """By name, what is measured at an albedo, and the shape of its result if it is not the grid's."""
    shape, found = bench.density.shape, {}
    if albedo == 0:
        ours = EmissionAbsorptionRenderer(shape, GAMMA, "exact", 1.0)
        tracer = PathTracer(bench.density, VIEW, GAMMA)
        found["emission–absorption"] = (bench.by_adjoint(ours), None)
        found["emission–absorption, differences"] = (bench.by_differences(ours), (CELLS,))
        for spp in SPP:
            found[f"prbvolpath {spp}"] = (lambda n, spp=spp: tracer.gradient(bench.weights, spp, n), None)
        return found
    light = LIGHTS / "key.xml"
    for spp in SPP:
        lighting = Lighting(albedo, 0.0, light, spp)
        found[f"prbvolpath {spp}"] = (bench.by_adjoint(PlainPathTracer(shape, GAMMA, 1.0, lighting)), None)
        found[f"ours {spp}"] = (bench.by_adjoint(ScatteringRenderer(shape, GAMMA, 1.0, lighting)), None)
        if (albedo, spp) == (CHECKED_ALBEDO, 16):
            plain = PlainPathTracer(shape, GAMMA, 1.0, lighting)
            found[f"prbvolpath {spp}, differences"] = (bench.by_differences(plain), (CELLS,))
    return found


def measure(bench: Bench, albedo: float, repeats: int) -> None:
    """Repeat all estimates until there are as many as asked for; slow ones a third as often."""
    found = estimators(bench, albedo)
    kept = {name: bench.sums(f"{albedo:g} {name}", shape) for name, (_, shape) in found.items()}
    wanted = {name: repeats // 3 if " 64" in name or "differences" in name else repeats for name in found}
    warm = set()
    for number in range(repeats):
        for name, (gradient, _) in found.items():
            if number < wanted[name] and len(kept[name].seconds) == number:
                if name not in warm:  # kernels are compiled
                    gradient(10_000)
                    warm.add(name)
                begin = time.process_time()
                value = gradient(number)
                kept[name].add(value, time.process_time() - begin)
                print(f"albedo {albedo:g}, {name}: {number + 1} of {wanted[name]}", flush=True)


def directions(bench: Bench) -> dict[str, np.ndarray]:
    """Directions in density: smoke that gets thicker in places, and smoke that appears beside it."""
    beside = bench.near & (bench.density == 0)
    found = {f"thicker {seed}": bench.density * smooth(bench.density.shape, 5.0, seed) for seed in (11, 12)}
    return found | {"beside": np.where(beside, 0.1, 0).astype(np.float32)}


def check_directions(bench: Bench, albedo: float, repeats: int) -> None:
    """Finite differences of images of `prbvolpath` along the directions; of one side beside smoke."""
    renderer = PlainPathTracer(
        bench.density.shape, GAMMA, 1.0, Lighting(albedo, 0.0, LIGHTS / "key.xml", DIRECTION_SPP)
    )
    for number in range(repeats):
        for name, direction in directions(bench).items():
            sums = bench.sums(f"{albedo:g} along {name}", ())
            if len(sums.seconds) == number:
                begin = time.process_time()
                sums.add(
                    np.array(bench.slope(renderer, direction, DIRECTION_STEP, number)), time.process_time() - begin
                )


def table(bench: Bench, albedo: float) -> list[dict]:
    """A row for each estimator."""
    truth = bench.sums(f"{albedo:g} " + ("ours 64" if albedo else "emission–absorption"))
    reference = truth.mean
    smoke, beside = bench.density > 0, bench.near & (bench.density == 0)
    thick = bench.density > THICK
    # Less what noise adds to the RMS of the mean.
    signal, in_thick = (
        float(np.sqrt(np.square(reference[where]).mean() - truth.variance[where].mean() / len(truth.seconds)))
        for where in (bench.near, thick)
    )
    rows = []
    for name, (_, shape) in estimators(bench, albedo).items():
        sums = bench.sums(f"{albedo:g} {name}", shape)
        if len(sums.seconds) < 2:
            continue
        seconds = float(np.median(sums.seconds))
        if shape is not None:
            # Two images for each cell that a transport can use.
            seconds *= int(bench.near.sum()) / CELLS
            at = reference[tuple(bench.cells.T)]
            noise = rms(np.sqrt(sums.variance)) / signal
            row = {"deviation in cells": rms(sums.mean - at) / signal}
        else:
            noise = float(np.sqrt(sums.variance[bench.near].mean())) / signal
            row = {
                "noise in thick smoke": float(np.sqrt(sums.variance[thick].mean())) / in_thick,
                "bias in smoke": bias(sums, truth, smoke, albedo),
                "bias beside": bias(sums, truth, beside, albedo),
            }
        rows.append({"albedo": albedo, "estimator": name, "seconds": seconds, "noise": noise, **row})
        rows[-1]["repeats"] = len(sums.seconds)
    return rows


def bias(sums: Sums, truth: Sums, where: np.ndarray, albedo: float) -> tuple[float, float]:
    """(b², its standard error): the square of the bias in parts of the mean square of the reference."""
    differences = sums.half_means[:, where] - (truth.half_means if albedo else truth.mean[None])[:, where]
    products = differences[0] * differences[1]
    power = float((truth.half_means[:, where].prod(0) if albedo else truth.mean[where] ** 2).mean())
    # Neighbouring cells share paths: blocks of cells that are far apart in storage count as independent.
    blocks = np.array([part.mean() for part in np.array_split(products, 32)])
    return float(products.mean()) / power, float(blocks.std(ddof=1)) / np.sqrt(len(blocks)) / power


def rms(values: np.ndarray) -> float:
    """The root of the mean square."""
    return float(np.sqrt(np.square(values).mean()))


def checked(bench: Bench, albedo: float) -> list[dict]:
    """The reference along the directions against finite differences of prbvolpath, and its own derivative there."""
    rows = []
    for name, direction in directions(bench).items():
        found = bench.sums(f"{albedo:g} along {name}", ())
        if len(found.seconds) < 2:
            continue
        along = {
            side: float((bench.sums(f"{albedo:g} {side} 64").mean * direction).sum()) for side in ("ours", "prbvolpath")
        }
        error = float(np.sqrt(found.variance / len(found.seconds)))
        rows.append({"albedo": albedo, "along": name, "differences": float(found.mean), "error": error, **along})
    return rows


def draw(rows: list[dict]) -> Figure:
    """Noise against seconds, a panel for each albedo."""
    albedos = sorted({row["albedo"] for row in rows})
    figure = Figure(figsize=(3.4 * len(albedos), 3.6), layout="constrained")
    for axes, albedo in zip(
        np.atleast_1d(figure.subplots(1, len(albedos), sharex=True, sharey=True)), albedos, strict=True
    ):
        series = (
            ("prbvolpath", "C3", "o", lambda name: name.startswith("prbvolpath") and "diff" not in name),
            ("ours, path traced", "C0", "s", lambda name: name.startswith("ours")),
            ("prbvolpath, finite differences", "C1", "x", lambda name: name.startswith("prb") and "diff" in name),
        )
        for label, colour, marker, belongs in series:
            points = [
                (row["seconds"], row["noise"]) for row in rows if row["albedo"] == albedo and belongs(row["estimator"])
            ]
            if points:
                axes.plot(*zip(*points, strict=True), color=colour, marker=marker, label=label)
        for row in rows:
            if row["albedo"] == 0 and row["estimator"] == "emission–absorption":
                axes.axvline(row["seconds"], color="k", ls=":", label="emission–absorption: no noise")
        title = "albedo 0: absorption alone" if albedo == 0 else f"albedo {albedo:g}, key light"
        axes.set(xscale="log", yscale="log", title=title, xlabel="processor seconds per gradient")
        axes.axhline(1.0, color="0.8", lw=0.8, zorder=0)
    figure.axes[-1 if len(albedos) < 2 else 1].legend(fontsize=7, loc="upper right")
    figure.axes[0].set_ylabel("noise over signal")
    return figure


def main() -> None:
    """Measure what is missing, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frame", type=Path, nargs="?", default=FRAME)
    parser.add_argument("--out", type=Path, required=True, help="a folder, also of an earlier run")
    parser.add_argument("--albedo", type=float, nargs="+", default=[0.0, 0.3, 0.8])
    parser.add_argument("--repeats", type=int, default=12)
    parser.add_argument("--draw", type=Path, help="a PNG to draw")
    arguments = parser.parse_args()
    tnst_mi.activate()
    arguments.out.mkdir(parents=True, exist_ok=True)
    bench = Bench(tnst_mi.load_frames(arguments.frame)[0].density, arguments.out)
    rows, checks = [], []
    for albedo in arguments.albedo:
        measure(bench, albedo, arguments.repeats)
        if albedo == CHECKED_ALBEDO:
            check_directions(bench, albedo, arguments.repeats // 2)
            checks = checked(bench, albedo)
        rows += table(bench, albedo)
    with written_whole(arguments.out / "table.json") as temporary:
        temporary.write_text(json.dumps({"rows": rows, "checks": checks}, indent=1, ensure_ascii=False) + "\n", "utf-8")
    for row in rows + checks:
        print(json.dumps(row, ensure_ascii=False))
    if arguments.draw:
        figure = draw(rows)
        with written_whole(arguments.draw) as temporary:
            figure.canvas = FigureCanvasAgg(figure)
            figure.savefig(str(temporary), dpi=100, format="png")


if __name__ == "__main__":
    main()
