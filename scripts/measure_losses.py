"""What an iteration costs with each loss of a style, of all pixels and of the smoke.

    python scripts/measure_losses.py [FRAME] [--style IMAGE] [--weights FILE] [--rounds 9]

An iteration at full resolution, nine views: transport, images, network and loss, forward and backward. All kinds take
turns, after a round that compiles their kernels; times are medians, and their ratios to "gram" are what counts. The
processor's time is that of all threads, which other work on the machine changes less. Without a frame, it is the
bundled one.
"""

from __future__ import annotations

import tnst_mi  # first: it lets torch's idle threads sleep

# isort: split
import argparse
import itertools
import time
from collections.abc import Callable
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.choices import STYLE_LOSSES, STYLE_STATISTICS
from tnst_mi.frame import Frame
from tnst_mi.machine.backend import torch_device
from tnst_mi.machine.environment import device
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import problem_of
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.recipe.recipe import Recipe

BUNDLED = Path(__file__).resolve().parents[1] / "scenes" / "suzanne" / "frame_0010.npz"


def iteration(frame: Frame, recipe: Recipe, network: GoogLeNet) -> Callable[[], None]:
    """The evaluation of the loss and its gradient in an iteration, with another seed each time."""
    shape = frame.density.shape
    exposure = 1 / float(tnst_mi.render(frame.density, [(0.0, 0.0)], gamma=recipe.extinction).max())
    plan = plan_of(recipe, ["frame"], [0], [1.0], [exposure], shape)
    (of_frame,) = plan.frames
    problem = problem_of(plan, plan.full, network)
    density = mi.TensorXf(frame.density)
    rng = np.random.default_rng(0)
    zeros = of_frame.parameterisation.zeros(plan.full)
    # Smoke that is moved, as it is after some iterations.
    moved = {name: rng.normal(size=field.shape).astype(np.float32) for name, field in zeros.items()}
    fields = Fields({name: mi.TensorXf(values) for name, values in moved.items()})
    numbers = itertools.count()

    def once() -> None:
        evaluation = problem.gradient(of_frame, fields, density, of_frame.seed(0, next(numbers)))
        dr.eval(*(dict(gradient) for gradient in evaluation.gradients))
        dr.sync_thread()
        evaluation.loss.item()

    return once


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("frame", nargs="?", type=Path, default=BUNDLED)
    parser.add_argument("--style", default="spirals")
    parser.add_argument("--weights", help="as of tnst-mi stylize")
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    variant = tnst_mi.activate()
    (frame,) = tnst_mi.load_frames(arguments.frame)
    network = GoogLeNet.load(arguments.weights).to(torch_device())
    kinds = list(itertools.product(STYLE_LOSSES, STYLE_STATISTICS))
    calls = {}
    for loss, statistics_of in kinds:
        keys = {"style": [arguments.style], "style_loss": loss, "style_statistics": statistics_of}
        recipe = Recipe.from_dict(keys)
        calls[loss, statistics_of] = iteration(frame, recipe, network)
    spent: dict[tuple[str, str], list[tuple[float, float]]] = {kind: [] for kind in kinds}
    for round_number in range(arguments.rounds + 1):
        for kind, call in calls.items():
            begin = time.perf_counter(), time.process_time()
            call()
            if round_number:
                spent[kind].append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
    medians = {kind: np.median(times, axis=0) for kind, times in spent.items()}
    print(f"{frame.density.shape} cells, network {network.flavour}, {device(variant)}, {arguments.rounds} rounds")
    print("| style_loss | style_statistics | s | ÷ gram | processor, s | ÷ gram |\n|---|---|---|---|---|---|")
    for kind, found in medians.items():
        columns = zip(found, found / medians["gram", "image"], strict=True)
        print(f"| {' | '.join(kind)} | {' | '.join(f'{time:.3f} | {ratio:.2f}' for time, ratio in columns)} |")


if __name__ == "__main__":
    main()
