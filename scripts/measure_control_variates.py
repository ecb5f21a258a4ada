"""How much noise of the path tracer's gradient control variates could take away: correlations of gradients.

    python scripts/measure_control_variates.py [FRAME] [--repeats 24] [--albedo 0.3] [--spp 4]

An estimate g that is correlated by ρ with another, whose mean is known or cheap, can have its variance lowered to
1 − ρ² of it, and no further. Measured over random numbers, for all cells in or beside smoke together, is ρ between the
gradient of `prbvolpath` and, from the same random numbers,

- that of the smoke as it absorbs light from behind it, of which our emission–absorption renderer knows the mean;
- that of light scattered once, of which ours sums up the mean;
- that of the smoke an iteration earlier, moved by a tenth of a cell, and by a whole cell: paths shared by iterations.
"""

from __future__ import annotations

import tnst_mi  # first: it lets torch's idle threads sleep

# isort: split
import argparse
import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from measure_gradient_noise import FRAME, GAMMA, VIEW, Bench
from noise_measures.plain import PlainPathTracer

from tnst_mi.recipe.paths import LIGHTS
from tnst_mi.rendering.scattering import Lighting


class Absorbed(PlainPathTracer):
    """What lights behind the smoke show of it."""

    def _integrators(self, majorant: float) -> tuple[dict[str, Any], dict[str, Any]]:
        return tuple(one | {"hide_emitters": False} for one in super()._integrators(majorant))


class ScatteredOnce(PlainPathTracer):
    """Light that is scattered once."""

    def _integrators(self, majorant: float) -> tuple[dict[str, Any], dict[str, Any]]:
        return tuple(one | {"max_depth": 2} for one in super()._integrators(majorant))


def moved(density: np.ndarray, cells: float) -> np.ndarray:
    """A density moved along x."""
    whole, part = int(cells), cells % 1
    near = np.roll(density, whole, 2)
    return ((1 - part) * near + part * np.roll(near, 1, 2)).astype(np.float32)


def correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Σ cov / √(Σ var Σ var) over cells, of estimates (repeats, cells)."""
    a, b = first - first.mean(0), second - second.mean(0)
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frame", type=Path, nargs="?", default=FRAME)
    parser.add_argument("--repeats", type=int, default=24)
    parser.add_argument("--albedo", type=float, default=0.3)
    parser.add_argument("--spp", type=int, default=4)
    arguments = parser.parse_args()
    tnst_mi.activate()
    bench = Bench(tnst_mi.load_frames(arguments.frame)[0].density, Path.cwd())

    def estimates(kind: type[PlainPathTracer], albedo: float, density: np.ndarray) -> np.ndarray:
        lighting = Lighting(albedo, 0.0, LIGHTS / "key.xml", arguments.spp)
        renderer, smoke = kind(density.shape, GAMMA, 1.0, lighting), mi.TensorXf(density)
        weights = mi.TensorXf(bench.weights)
        return np.stack(
            [
                renderer.gradient(smoke, VIEW, [number], weights, weights).numpy()[bench.near]
                for number in range(arguments.repeats)
            ]
        ).astype(np.float64)

    scattered = estimates(PlainPathTracer, arguments.albedo, bench.density)
    others = {
        "absorption": estimates(Absorbed, 0.0, bench.density),
        "scattered once": estimates(ScatteredOnce, arguments.albedo, bench.density),
        "moved by 0.1 cells": estimates(PlainPathTracer, arguments.albedo, moved(bench.density, 0.1)),
        "moved by 1 cell": estimates(PlainPathTracer, arguments.albedo, moved(bench.density, 1.0)),
    }
    for name, other in others.items():
        print(json.dumps({"with": name, "correlation": round(correlation(scattered, other), 3)}), flush=True)


if __name__ == "__main__":
    main()
