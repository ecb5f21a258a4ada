"""Loss against time: an optimisation, a trained network, and a network whose potentials are refined.

    python scripts/measure_realtime.py MODEL INPUT… [--refine N…] [--iterations N…] [--figure FILE.png]

Every INPUT is a frame that the network has not learned from. All are judged alike: the mean loss in the three fixed
views, with the scales that the terms have for the unstylized smoke. Times are those of a second run of each, so without
compiling kernels, and without reading, judging and writing. Prints a table in Markdown, and draws loss against time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tnst_mi
from tnst_mi.fields.density_unit import scaled
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.items.store import MemoryStore
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.optimisation.single_frame import optimise
from tnst_mi.realtime.model import Model, read_model
from tnst_mi.realtime.prediction import predicted_fields
from tnst_mi.run.from_model import begun_by
from tnst_mi.run.prepare import load_network
from tnst_mi.run.request import FromModel
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
        take = self.footage.take(0)
        fields = predicted_fields(self.model.network, take.plan, self.footage.problem.octave, take.density)
        return self.footage.moved(0, fields) / np.float32(self.footage.plan.density_scale)

    def refined(self, iterations: int) -> np.ndarray:
        """By the network, and iterations that go on from there."""
        plan, _ = begun_by(FromModel(self.model.path, iterations), self.footage.plan, {}, [self.frame], None)
        ((_, found),) = SequenceOptimisation(plan, [self.frame], self.network, MemoryStore()).run()
        return found.density


@dataclass(frozen=True)
class Row:
    """A way to stylize a frame: its kind, what it is called, its seconds, and the loss that it leaves."""

    kind: str
    name: str
    seconds: float
    loss: float


def rows(measured: Measured, iterations: list[int], refine: list[int]) -> Iterator[Row]:
    """All ways, from the fewest iterations to the most."""
    ways: list[tuple[str, str, Callable[[], np.ndarray]]] = [
        ("optimised", f"{n * measured.recipe.octaves} iterations", lambda n=n: measured.optimised(n))
        for n in iterations
    ]
    ways += [("network", "alone", measured.in_one_pass)]
    ways += [("network", f"then {n} iterations", lambda n=n: measured.refined(n)) for n in refine]
    for kind, name, way in ways:
        way()
        begun = time.perf_counter()
        density = way()
        yield Row(kind, name, time.perf_counter() - begun, measured.loss(density))


def draw(found: Mapping[str, tuple[float, Sequence[Row]]], path: Path) -> None:
    """Loss against time, a picture for each input."""
    figure, axes = plt.subplots(1, len(found), figsize=(5 * len(found), 4), squeeze=False)
    for axis, (name, (before, ways)) in zip(axes[0], found.items(), strict=True):
        for kind, start in (("optimised", [(0.0, before)]), ("network", [])):
            points = [*start, *((way.seconds, way.loss) for way in ways if way.kind == kind)]
            axis.plot(*zip(*points, strict=True), marker="o", label=kind)
        axis.set(title=Path(name).name, xlabel="seconds", ylabel="mean loss in the fixed views")
        axis.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=90)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("inputs", type=Path, nargs="+")
    parser.add_argument("--refine", type=int, nargs="*", default=[5, 10])
    parser.add_argument("--iterations", type=int, nargs="+", default=[5, 13, 20], help="in each octave")
    parser.add_argument("--figure", type=Path, help="PNG of loss against time")
    parser.add_argument("--views", type=int, default=tnst_mi.Recipe().views, help="of an iteration")
    arguments = parser.parse_args()
    tnst_mi.activate()
    model = read_model(arguments.model)
    recipe = tnst_mi.recipe_of_model(arguments.model).updated({"views": arguments.views}, "--views: ", Path.cwd())
    network = load_network(recipe).model
    print("| smoke | how | seconds | loss | gone, of what the longest optimisation takes |\n|---|---|---|---|---|")
    drawn: dict[str, tuple[float, Sequence[Row]]] = {}
    for path in arguments.inputs:
        frame = tnst_mi.load_frames(path)[0]
        measured = Measured(frame, recipe, network, model)
        before, found = measured.loss(frame.density), list(rows(measured, arguments.iterations, arguments.refine))
        full = found[len(arguments.iterations) - 1].loss
        print(f"| {path} | unstylized | | {before:.1f} | |")
        for row in found:
            gone = (before - row.loss) / (before - full)
            print(f"| | {row.kind}, {row.name} | {row.seconds:.2f} | {row.loss:.1f} | {gone:.0%} |", flush=True)
        drawn[str(path)] = before, found
    if arguments.figure is not None:
        draw(drawn, arguments.figure)


if __name__ == "__main__":
    main()
