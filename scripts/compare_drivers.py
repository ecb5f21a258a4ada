"""One frame, one style, stylized twice: driven by emission–absorption, and driven by Mitsuba's path tracer.

    python scripts/compare_drivers.py [FRAME.npz] [--style net] [--keys 'gamma = 1.0'] --out FOLDER

Both runs have the same recipe but for `integrator`. The style distance before and after each is measured under both
renderers, from the azimuths -8°, 0° and 8°: does what one of them saw improve stay an improvement for the other? Time
per iteration and the noise of the gradient are what the path tracer costs. Writes drivers.png and drivers.json.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tomllib
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tnst_mi import Frame, GoogLeNet, Recipe, activate, load_frames
from tnst_mi.fields.pyramid import gaussian
from tnst_mi.io.atomic import written_whole
from tnst_mi.losses.evaluation import BoundObjective
from tnst_mi.machine.backend import torch_device
from tnst_mi.machine.environment import device, versions
from tnst_mi.optimisation.goals import objective_of
from tnst_mi.optimisation.mask import soft_mask
from tnst_mi.optimisation.parameterisation import GRADIENT_SIGMA
from tnst_mi.optimisation.single_frame import optimise
from tnst_mi.rendering.driving import driving_renderer, main_view
from tnst_mi.run.progress import ProgressBar
from tnst_mi.run.time_left import octave_sizes

FRAME = Path(__file__).resolve().parents[1] / "scenes" / "suzanne" / "frame_0010.npz"
VIEWS = [(azimuth, 0.0) for azimuth in (-8.0, 0.0, 8.0)]
METHOD = {"lam": 1.0, "transport": "step", "motif_size": "cells", "octaves": 2, "iterations": 20, "views": len(VIEWS)}
METHOD |= {"gamma": 0.3, "spp": 16}
NAMES = {"emission_absorption": "emission–absorption", "prbvolpath": "prbvolpath"}

#: Paths per pixel of the pictures that are judged: their noise must not count as style.
JUDGED_SPP = 128

#: Gradients of the same density with other random numbers, whose scatter is the noise.
REPEATS = 16


class Judge:
    """One of the two renderers at full resolution, with the exposure that it gives the unstylized frame."""

    def __init__(self, frame: Frame, recipe: Recipe, network: GoogLeNet, spp: int = JUDGED_SPP) -> None:
        self.recipe, self.spp = recipe, spp
        self.exposure = 1.0 / float(main_view(frame.density, recipe).max())
        self.loss: BoundObjective = objective_of(recipe).bind(network, *frame.density.shape[1:])

    def pictures(self, density: np.ndarray) -> np.ndarray:
        """Exposed pictures (3, H, W) of a density (D, H, W); the same noise each time."""
        renderer = driving_renderer(self.recipe, density.shape, 1.0, self.spp)
        return self.exposure * renderer.render(mi.TensorXf(density), VIEWS, [self.recipe.seed]).numpy()

    def judge(self, density: np.ndarray) -> tuple[float, np.ndarray]:
        """Style distance, the mean over the views, and the picture (H, W) from the front."""
        pictures = self.pictures(density)
        with torch.no_grad():
            return float(self.loss(torch.from_numpy(pictures).to(torch_device()))) / len(VIEWS), pictures[1]

    def gradient(self, density: np.ndarray, seed: int) -> mi.TensorXf:
        """Derivative of the loss (D, H, W) as an iteration takes it, with the recipe's few paths."""
        renderer = driving_renderer(self.recipe, density.shape, 1.0)
        leaf = mi.TensorXf(density)
        dr.enable_grad(leaf)

        @dr.wrap(source="drjit", target="torch")
        def loss(images):  # noqa: ANN202
            return self.loss(images)

        dr.backward(loss(renderer.render(leaf, VIEWS, [self.recipe.seed, seed]) * self.exposure))
        return dr.grad(leaf)

    def noise(self, frame: Frame) -> dict[str, float | None]:
        """Relative standard deviation of the gradient where the mask lets it act, per voxel and once smoothed."""
        mask = soft_mask(frame.density, frame.obstacle)
        gradients = [self.gradient(frame.density, repeat) for repeat in range(REPEATS)]
        smoothed = [gaussian(gradient, GRADIENT_SIGMA) for gradient in gradients]
        return {
            name: relative_deviation(np.stack([mask * field.numpy() for field in fields]))
            for name, fields in (("voxels", gradients), ("smoothed", smoothed))
        }


def relative_deviation(fields: np.ndarray) -> float | None:
    """RMS standard deviation of repeated estimates (R, D, H, W) over the RMS of what they estimate.

    The mean of R estimates has a noise of its own, variance / R, which is taken off its square; None where nothing
    is left then.
    """
    variance = float(fields.var(0, ddof=1).mean())
    signal = float(np.square(fields.mean(0)).mean()) - variance / len(fields)
    return float(np.sqrt(variance / signal)) if signal > 0 else None


def compare(frame: Frame, recipe: Recipe) -> tuple[dict, dict[str, list[np.ndarray]]]:
    """Losses, times and noise by renderer, and the front pictures before and after each run."""
    network = GoogLeNet.load(recipe.weights).to(torch_device())
    recipes = {name: recipe.updated({"integrator": name}, "drivers: ", Path.cwd()) for name in NAMES}
    renderers = {name: Judge(frame, of_driver, network) for name, of_driver in recipes.items()}
    densities, drivers = {"before": frame.density}, {}
    for name, renderer in renderers.items():
        bar = ProgressBar(True, octave_sizes(recipes[name], frame.density.shape), frame.density.size, 1)
        stylized = optimise(frame, recipes[name], network, renderer.exposure, bar.advance)
        bar.close()
        densities[name] = stylized.density
        drivers[name] = {
            # Medians, since the first iterations of an octave compile its kernels.
            "seconds_per_iteration": [
                statistics.median(
                    e["seconds"] for e in stylized.history if e["octave"] == octave and e["iteration"] > 1
                )
                for octave in range(recipe.octaves)
            ],
            "gradient_noise": renderer.noise(frame),
            "mass_kept": float(stylized.density.sum() / frame.density.sum()),
        }
    losses, pictures = {}, {}
    for name, renderer in renderers.items():
        judged = {state: renderer.judge(density) for state, density in densities.items()}
        losses[name] = {state: loss for state, (loss, _) in judged.items()}
        pictures[name] = [picture for _, picture in judged.values()]
    record = {
        "frame": frame.name,
        "style": [Path(style).name for style in recipe.style],
        "recipe": {key: getattr(recipe, key) for key in METHOD},
        "network": network.flavour,
        "loss_under": losses,
        "driven_by": drivers,
    }
    return record, pictures


def noise_in_words(noise: float | None) -> str:
    """A relative standard deviation as a multiple of the signal."""
    return "too large to tell" if noise is None else f"{noise:.2g} of the signal"


def draw(record: dict, pictures: dict[str, list[np.ndarray]]) -> Figure:
    """A row for each renderer: the frame before, driven by the one, driven by the other, each with its loss."""
    figure = Figure(figsize=(6.6, 7.6), layout="constrained")
    states = ("before", *(f"driven by {name}" for name in NAMES.values()))
    for row, (axes_row, name) in enumerate(zip(figure.subplots(len(NAMES), 3), NAMES, strict=True)):
        for axes, state, picture, loss in zip(
            axes_row, states, pictures[name], record["loss_under"][name].values(), strict=True
        ):
            axes.imshow(np.clip(picture, 0, 1), cmap="gray", vmin=0, vmax=1)
            axes.set(xticks=[], yticks=[], xlabel=f"style distance {loss:.3f}")
            if row == 0:
                axes.set_title(state, fontsize=10)
        axes_row[0].set_ylabel(f"seen by {NAMES[name]}")
    costs = "\n".join(
        f"{NAMES[name]}: {cost['seconds_per_iteration'][-1]:.2f} s an iteration at full resolution, "
        f"gradient noise {noise_in_words(cost['gradient_noise']['smoothed'])}"
        for name, cost in record["driven_by"].items()
    )
    recipe = record["recipe"]
    figure.suptitle(
        f"{record['frame']}, style {', '.join(record['style'])}, γ {recipe['gamma']:g}, {recipe['octaves']} octaves × "
        f"{recipe['iterations']} iterations × {recipe['views']} views, {recipe['spp']} paths per pixel\n{costs}",
        fontsize=9,
    )
    return figure


def main() -> None:
    """Stylize twice, measure, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frame", type=Path, nargs="?", default=FRAME)
    parser.add_argument("--style", default="net", help="a picture, or the name of a shipped one (default net)")
    parser.add_argument("--keys", default="", help="further recipe keys in TOML, such as 'iterations = 20'")
    parser.add_argument("--out", type=Path, required=True, help="a folder")
    arguments = parser.parse_args()
    keys = METHOD | {"style": [arguments.style]} | tomllib.loads(arguments.keys)
    recipe = Recipe.from_dict(keys, "drivers: ", Path.cwd())
    variant = activate(recipe.variant)
    record, pictures = compare(load_frames(arguments.frame)[0], recipe)
    record |= {"versions": versions(), "device": device(variant)}
    arguments.out.mkdir(parents=True, exist_ok=True)
    with written_whole(arguments.out / "drivers.json") as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
    figure = draw(record, pictures)
    with written_whole(arguments.out / "drivers.png") as temporary:
        figure.canvas = FigureCanvasAgg(figure)
        figure.savefig(str(temporary), dpi=100, format="png")
    print(json.dumps({key: record[key] for key in ("loss_under", "driven_by")}, indent=1))


if __name__ == "__main__":
    main()
