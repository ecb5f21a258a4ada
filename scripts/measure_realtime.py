"""Loss against time: an optimisation, a trained network, and a network whose potentials are refined.

    python scripts/measure_realtime.py MODEL INPUT… [--refine N…] [--iterations N…]

Every INPUT is a frame that the network has not learned from. All are judged alike: the mean loss in the three fixed
views, with the scales that the terms have for the unstylized smoke. Times are those of a second run of each, so without
compiling kernels, and without reading, judging and writing. Prints a table in Markdown.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import tnst_mi
from tnst_mi.fields.density_unit import scaled
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.items.store import MemoryStore
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.optimisation.single_frame import optimise
from tnst_mi.realtime.model import Model, read_model
from tnst_mi.realtime.prediction import fields_of, predicted
from tnst_mi.run.from_model import FromModel, begun_by
from tnst_mi.training.footage import Footage


class Measured:
    """The ways to stylize a frame, each giving its density."""

    def __init__(self, frame: tnst_mi.Frame, recipe: tnst_mi.Recipe, network: GoogLeNet, model: Model) -> None:
        self.frame, self.recipe, self.network, self.model = frame, recipe, network, model
        self.footage = Footage(frame.name, [frame], recipe, network)

    def loss(self, density: np.ndarray) -> float:
        """The mean loss in the fixed views."""
        plan = self.footage.plan
        return self.footage.problem.judge(plan.frames[0], scaled(density, plan.density_scale))[0]

    def optimised(self, iterations: int) -> np.ndarray:
        """By so many iterations in each octave."""
        recipe = self.recipe.updated({"iterations": iterations}, "--iterations: ", Path.cwd())
        return optimise(self.frame, recipe, self.network).density

    def in_one_pass(self) -> np.ndarray:
        """By the network: its potentials, and the transport by these."""
        plan, octave, take = self.footage.plan, self.footage.problem.octave, self.footage.take(0)
        potentials = predicted(self.model.network, take.density.numpy())
        fields = fields_of(potentials, self.model.network.architecture, octave.cell_size)
        parameterisation = plan.frames[0].parameterisation
        fields = parameterisation.carried(fields, octave, plan.full)
        moved = parameterisation.density(fields, take.full, plan.full.cell_size)
        return moved.numpy() / np.float32(plan.density_scale)

    def refined(self, iterations: int) -> np.ndarray:
        """By the network, and iterations that go on from there."""
        plan, _ = begun_by(FromModel(self.model.path, iterations), self.footage.plan, {}, [self.frame], None)
        ((_, found),) = SequenceOptimisation(plan, [self.frame], self.network, MemoryStore()).run()
        return found.density


def rows(measured: Measured, iterations: list[int], refine: list[int]) -> Iterator[tuple[str, float, float]]:
    """Of each way: what it is, its seconds, and its loss."""
    ways: list[tuple[str, Callable[[], np.ndarray]]] = [
        (f"optimised, {n * measured.recipe.octaves} iterations", lambda n=n: measured.optimised(n)) for n in iterations
    ]
    ways += [("network", measured.in_one_pass)]
    ways += [(f"network, then {n} iterations", lambda n=n: measured.refined(n)) for n in refine]
    for name, way in ways:
        way()
        begun = time.perf_counter()
        density = way()
        yield name, time.perf_counter() - begun, measured.loss(density)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("inputs", type=Path, nargs="+")
    parser.add_argument("--refine", type=int, nargs="*", default=[10])
    parser.add_argument("--iterations", type=int, nargs="+", default=[13, 20], help="in each octave")
    parser.add_argument("--views", type=int, default=tnst_mi.Recipe().views, help="of an iteration")
    arguments = parser.parse_args()
    tnst_mi.activate()
    network, model = GoogLeNet.load(), read_model(arguments.model)
    recipe = tnst_mi.recipe_of_model(arguments.model).updated({"views": arguments.views}, "--views: ", Path.cwd())
    print("| smoke | how | seconds | loss | gone, of what the longest optimisation takes |\n|---|---|---|---|---|")
    for path in arguments.inputs:
        frame = tnst_mi.load_frames(path)[0]
        measured = Measured(frame, recipe, network, model)
        before, found = measured.loss(frame.density), list(rows(measured, arguments.iterations, arguments.refine))
        full = found[len(arguments.iterations) - 1][2]
        print(f"| {path} | unstylized | | {before:.1f} | |")
        for how, seconds, loss in found:
            print(f"| | {how} | {seconds:.2f} | {loss:.1f} | {(before - loss) / (before - full):.0%} |", flush=True)


if __name__ == "__main__":
    main()
