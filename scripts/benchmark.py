"""Times the parts of an iteration and a whole run: medians of interleaved repetitions, as a table and as JSON.

    python scripts/benchmark.py [--size 64] [--views 3] [--repeat 7] [--weights FILE] [--json FILE]

The smoke is the bundled frame, resampled to the size asked for. Without weights the parts that need the network are
left out.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

import tnst_mi
from tnst_mi.environment import device, versions
from tnst_mi.grid import Octave
from tnst_mi.optimise import optimise
from tnst_mi.parameterisation import Transport
from tnst_mi.resample import resample_density
from tnst_mi.scene import GridScene

SCENES = Path(__file__).resolve().parents[1] / "scenes"
STYLE_LAYERS = ["conv2/3x3", "inception_3b/output", "inception_4b/output"]


def bundled_density(size: int) -> np.ndarray:
    """The bundled frame (64×96×64), resampled to `size` cells along x."""
    with np.load(SCENES / "suzanne" / "frame_0010.npz") as arrays:
        density = arrays["density"]
    shape = (size, size * 3 // 2, size)
    return np.clip(resample_density(density, 1.0, shape, 64 / size), 0, 1)


def field_tasks(density: np.ndarray, views: int) -> dict[str, Callable[[], object]]:
    """Transport and rendering, forward and backward, on the grid of the density."""
    shape = density.shape
    transport, scene = Transport(1.0), GridScene(shape, 0.1, "paper", 1.0, views)
    transport.enter(Octave(shape, 1.0))
    wave = 0.5 * np.sin(np.arange(shape[2]) / 3)
    transport.fields["phi"] = mi.TensorXf(np.broadcast_to(np.float32(wave), shape).copy())
    smoke, mask = mi.TensorXf(density), mi.TensorXf(density)
    angles = [tuple(view) for view in tnst_mi.sample_views(views)]

    def transport_forward() -> object:
        return transport.density(smoke)

    def transport_backward() -> object:
        transport.attach()
        dr.backward(dr.sum(dr.square(transport.density(smoke)), axis=None))
        return dr.grad(transport.fields["phi"])

    def render_forward() -> object:
        return scene.render(smoke, angles)

    def render_backward() -> object:
        leaf = dr.detach(smoke)
        dr.enable_grad(leaf)
        dr.backward(dr.sum(dr.square(scene.render(leaf, angles)), axis=None))
        return dr.grad(leaf)

    def step() -> object:
        transport.attach()
        dr.set_grad(transport.fields["phi"], smoke)
        before = transport.fields["phi"]
        transport.find_steps(mask, 1e-9, shape[1], 3)
        transport.descend()
        after, transport.fields["phi"] = transport.fields["phi"], before
        return after

    return {
        "transport forward": transport_forward,
        "transport forward + backward": transport_backward,
        f"render {views} views forward": render_forward,
        f"render {views} views forward + backward": render_backward,
        "smooth, normalise, step": step,
    }


def network_task(weights: str | None, views: int, rows: int, columns: int) -> Callable[[], object]:
    """Features of the style layers and their gradient with respect to the images."""
    import torch

    network = tnst_mi.GoogLeNet.load(weights)
    images = torch.rand(views, 3, rows, columns, generator=torch.Generator().manual_seed(0))

    def network_backward() -> object:
        leaf = images.clone().requires_grad_()
        features = network(leaf, layers=STYLE_LAYERS)
        sum(features[layer].square().mean() for layer in STYLE_LAYERS).backward()
        return leaf.grad

    return network_backward


def medians(tasks: dict[str, Callable[[], object]], repeat: int) -> dict[str, dict[str, float]]:
    """Seconds of each task: the first call (with compilation), and the median of `repeat` interleaved calls."""
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(repeat + 1):
        for name, task in tasks.items():
            dr.sync_thread()
            start = time.perf_counter()
            dr.eval(task())
            dr.sync_thread()
            times[name].append(time.perf_counter() - start)
    return {name: {"first": values[0], "median": statistics.median(values[1:])} for name, values in times.items()}


def whole_runs(weights: str | None, density: np.ndarray) -> dict[str, float]:
    """Seconds of the two reference runs: 2 octaves × 20 iterations × 3 views, without loading the network."""
    network = tnst_mi.GoogLeNet.load(weights)
    short = {"octaves": 2, "iterations": 20, "views": 3}
    recipes = {
        "style run": tnst_mi.Recipe(style=("spirals",), **short),
        "semantic run": tnst_mi.Recipe(semantic=("inception_4b/pool_proj:16",), lam=0.0, **short),
    }
    recipes = {name: recipe.updated({"style": list(recipe.style)}, "", Path.cwd()) for name, recipe in recipes.items()}
    frame = tnst_mi.Frame(density)
    return {name: optimise(frame, recipe, network).timings["total"] for name, recipe in recipes.items()}


def main() -> None:
    """Measure, print a table, and write the JSON file if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=64, help="cells along x; H is 3/2 of it (default 64)")
    parser.add_argument("--views", type=int, default=3, help="views per launch (default 3)")
    parser.add_argument("--repeat", type=int, default=7, help="timed calls of each part (default 7)")
    parser.add_argument("--weights", help="GoogLeNet weights (default: searched for)")
    parser.add_argument("--json", type=Path, help="file for the results")
    arguments = parser.parse_args()

    variant = tnst_mi.activate()
    density = bundled_density(arguments.size)
    tasks = field_tasks(density, arguments.views)
    runs: dict[str, float] = {}
    try:
        tasks[f"network {arguments.views} views forward + backward"] = network_task(
            arguments.weights, arguments.views, *density.shape[1:]
        )
        runs = whole_runs(arguments.weights, density)
    except tnst_mi.InputError as error:
        print(f"without the network: {error}")
    results = {
        "versions": versions(),
        "device": device(variant),
        "shape": list(density.shape),
        "seconds": medians(tasks, arguments.repeat),
        "runs": runs,
        "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    print(f"grid {density.shape}, {variant}, {dr.thread_count()} threads: milliseconds, median (first)")
    for name, seconds in results["seconds"].items():
        print(f"  {name:42s} {1e3 * seconds['median']:8.1f}  ({1e3 * seconds['first']:.0f})")
    for name, seconds in runs.items():
        print(f"  {name:42s} {seconds:8.1f} s")
    print(f"  peak memory {results['peak_memory_mib']:.0f} MiB")
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2) + "\n", "utf-8")


if __name__ == "__main__":
    main()
