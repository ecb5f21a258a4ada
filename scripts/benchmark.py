"""Times the parts of an iteration, ours against PyTorch and against plain Dr.Jit, and how the times scale.

    python scripts/benchmark.py [--size 128] [--weights FILE] [--out FOLDER] [--only SECTION,SECTION…]

parts      transport, rendering and both together, forward and backward, for one view; smoothing, normalising and
           stepping; the network, forward and backward
iteration  a whole iteration of a style recipe with 9 views, ours and PyTorch's
flow       transport and that iteration with one straight step and along the flow, for smoke that moves by half a cell
           and by eight
scaling    transport and rendering against the number of cells, views and threads, and an iteration of a sequence
           against its window, with the fitted exponents
sequence   an iteration of a frame of nine (64×96×64 cells, one view) with a window of 9, its state in a folder:
           seconds, and bytes read from there
cameras    rendering nine views with parallel rays and the same in perspective, from near and from far
floor      a lower bound for each part: bytes that must move, or operations that must be done, over this machine's
           bandwidth or rate
frame      a whole frame of the paper's size: 200×300×200 cells, semantic recipe, 3 octaves × 20 iterations × 9 views

All sides are measured alternately in one run; times are medians, and their ratios are what counts. The smoke is the
bundled frame, resampled. Writes benchmark.json and, for `scaling`, scaling.png. Peers: `scripts/peers`.
"""

from __future__ import annotations

import tnst_mi  # first: it lets torch's idle threads sleep

# isort: split
import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from peers import torch_peer
from peers.sides import GAMMA, Iteration, Ours, PlainDrJit, Torch, wavy_potential

from tnst_mi.fields.resampling import resample_density, resample_velocity
from tnst_mi.io.atomic import written_whole
from tnst_mi.machine.backend import torch_device
from tnst_mi.machine.environment import device, peak_memory, versions
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.goals import objective_of
from tnst_mi.optimisation.items.store import FolderStore, MemoryStore, Store
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.optimisation.result import Progress
from tnst_mi.optimisation.runner import CACHE_BYTES, SequenceOptimisation
from tnst_mi.optimisation.single_frame import optimise

SCENES = Path(__file__).resolve().parents[1] / "scenes"
VIEWS = 9

#: Transport and images of the paper, of which plain torch has counterparts.
ONE_STEP = {"lam": 1.0, "transport": "step", "motif_size": "cells"}

#: A whole iteration: the style recipe of the paper's figures.
STYLE = ONE_STEP | {"style": ["flames"], "octaves": 1, "views": VIEWS}

#: A whole frame of the paper's size (Table 2: semantic transfer).
PAPER_SHAPE = (200, 300, 200)
PAPER = ONE_STEP | {"semantic": ["inception_4b/pool_proj:16"], "octaves": 3, "iterations": 20, "views": VIEWS}

SECTIONS = ("parts", "iteration", "flow", "cameras", "scaling", "sequence", "floor", "frame")

Task = Callable[[], object]


def bundled_density(size: int | tuple[int, int, int]) -> np.ndarray:
    """The bundled frame (64×96×64), resampled to a shape, or to `size` cells along x."""
    with np.load(SCENES / "suzanne" / "frame_0010.npz") as arrays:
        density = arrays["density"]
    shape = (size, size * 3 // 2, size) if isinstance(size, int) else size
    return np.clip(resample_density(density, 1.0, shape, 64 / shape[2]), 0, 1)


PARTS = {
    "transport_forward": "transport, forward",
    "transport_backward": "transport, forward + backward",
    "render_forward": "rendering, forward",
    "render_backward": "rendering, forward + backward",
    "both_backward": "transport + rendering, forward + backward",
    "step": "smooth, normalise, step",
}


def medians(tasks: dict[str, Task], repeat: int) -> dict[str, float]:
    """Median seconds of each task over `repeat` alternating calls, after a warm-up."""
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(repeat + 1):
        for name, task in tasks.items():
            dr.sync_thread()
            start = time.perf_counter()
            result = task()
            if not isinstance(result, torch.Tensor | tuple):
                dr.eval(result)
            dr.sync_thread()
            if torch.cuda.is_available():
                torch.cuda.synchronize()
            times[name].append(time.perf_counter() - start)
    return {name: statistics.median(values[1:]) for name, values in times.items()}


def parts(size: int, repeat: int) -> dict[str, dict[str, float]]:
    """Seconds of every part, per side."""
    density = bundled_density(size)
    sides = {"ours": Ours, "torch": Torch, "plain Dr.Jit": PlainDrJit}
    made = {name: side(density, [(8.0, 3.0)]) for name, side in sides.items()}
    found: dict[str, dict[str, float]] = {}
    for part, label in PARTS.items():
        found[label] = medians({n: getattr(s, part) for n, s in made.items() if hasattr(s, part)}, repeat)
        print_row(label, found[label])
    return found


def iteration(size: int, weights: str | None, repeat: int) -> dict[str, Any]:
    """A whole iteration, ours as in `stylize`, and PyTorch's: transport, 9 views, network, normalised step."""
    density = bundled_density(size)
    recipe = tnst_mi.Recipe.from_dict(STYLE)
    network = GoogLeNet.load(weights).to(torch_device())
    exposure = 1 / float(tnst_mi.render(density, gamma=GAMMA).max())
    ours = Iteration(density, recipe, network, exposure)
    peer = torch_peer.StyleIteration(density, wavy_potential(density.shape), recipe, network, exposure)
    found = medians({"ours": ours, "torch": peer}, repeat)
    print_row(f"iteration, style, {VIEWS} views", found)
    return found


def flow(size: int, weights: str | None, repeat: int) -> dict[str, dict[str, float]]:
    """Seconds of transport, and of a style iteration with 9 views, by one step ("ours") and along the flow."""
    density = bundled_density(size)
    network = GoogLeNet.load(weights).to(torch_device())
    exposure = 1 / float(tnst_mi.render(density, gamma=GAMMA).max())
    names = {"ours": "step", "flow": "flow"}
    found: dict[str, dict[str, float]] = {}
    for speed in (0.5, 8.0):
        sides = {name: Ours(density, [], trace, speed) for name, trace in names.items()}
        for part in ("transport_forward", "transport_backward"):
            label = f"{PARTS[part]}, {speed:g} cells"
            found[label] = medians({name: getattr(side, part) for name, side in sides.items()}, repeat)
            print_row(label, found[label])
        recipes = {name: tnst_mi.Recipe.from_dict(STYLE | {"transport": trace}) for name, trace in names.items()}
        tasks: dict[str, Task] = {n: Iteration(density, r, network, exposure, speed) for n, r in recipes.items()}
        label = f"iteration, style, {VIEWS} views, {speed:g} cells"
        found[label] = medians(tasks, max(1, repeat // 3))
        print_row(label, found[label])
    return found


def cameras(size: int, repeat: int) -> dict[str, dict[str, float]]:
    """Seconds of rendering nine views with parallel rays ("ours"), and from distances of two and five heights."""
    density = bundled_density(size)
    angles = [tuple(view) for view in tnst_mi.sample_views(VIEWS)]
    distances = {"2 heights": 2 * density.shape[1], "5 heights": 5 * density.shape[1]}
    sides = {"ours": Ours(density, angles)}
    sides |= {name: Ours(density, [(*view, distance) for view in angles]) for name, distance in distances.items()}
    found: dict[str, dict[str, float]] = {}
    for part in ("render_forward", "render_backward"):
        label = f"{PARTS[part]}, {VIEWS} views"
        found[label] = medians({name: getattr(side, part) for name, side in sides.items()}, repeat)
        print_row(label, found[label])
    return found


def scaling(weights: str | None, repeat: int) -> dict[str, list[dict[str, float]]]:
    """Transport and rendering against cells, views and threads, and iterations of a sequence against its window."""
    found: dict[str, list[dict[str, float]]] = {"cells": [], "views": [], "threads": []}
    for size in (32, 48, 64, 96, 128, 160):
        density = bundled_density(size)
        seconds = medians({"ours": Ours(density, [(8.0, 3.0)]).both_backward}, repeat)["ours"]
        found["cells"].append({"cells": density.size, "seconds": seconds})
    for views in (1, 3, 9, 27):
        task = Ours(bundled_density(64), [tuple(view) for view in tnst_mi.sample_views(views)]).render_backward
        found["views"].append({"views": views, "seconds": medians({"ours": task}, repeat)["ours"]})
    everything = dr.thread_count()
    for threads in range(1, everything + 1):
        dr.set_thread_count(threads)
        task = Ours(bundled_density(96), [(8.0, 3.0)]).both_backward
        found["threads"].append({"threads": threads, "seconds": medians({"ours": task}, repeat)["ours"]})
    dr.set_thread_count(everything)
    found["window"] = [windowed(window, weights) for window in (1, 3, 5, 9)]
    for name, rows in found.items():
        for row in rows:
            each = 1e9 * row["seconds"] / row[name]
            print(f"  {name} {row[name]:>10}: {1e3 * row['seconds']:8.1f} ms, {each:.3g} ns each")
        if len(rows) > 2:
            print(f"  exponent {exponent(name, rows):.2f}")
    return found


def windowed(window: int, weights: str | None) -> dict[str, float]:
    """Seconds per iteration of one frame, in a sequence of nine with a window."""
    density = bundled_density(32)
    rising = np.zeros((*density.shape, 3), np.float32)
    rising[..., 1] = 0.4
    frames = [tnst_mi.Frame(density, velocity=rising, name=f"frame_{i}", number=i) for i in range(9)]
    recipe = tnst_mi.Recipe.from_dict(STYLE | {"views": 1, "iterations": 8, "window": window})
    passed = iterated(frames, recipe, weights, MemoryStore(), time.perf_counter)
    # With a window, all frames are processed before the first is due again; without, the first continues alone.
    turns = len(frames) if window > 1 else 1
    return {"window": window, "seconds": float(np.median(np.diff(passed[1:]))) / turns}


def iterated(
    frames: list[tnst_mi.Frame],
    recipe: tnst_mi.Recipe,
    weights: str | None,
    store: Store,
    read: Callable[[], Any],
    cache_bytes: int = CACHE_BYTES,
) -> list[Any]:
    """Stylize a sequence; what `read` gave after every iteration of the first frame."""
    names, numbers = zip(*((frame.name, frame.number) for frame in frames), strict=True)
    exposure = 1 / float(tnst_mi.render(frames[0].density, gamma=GAMMA).max())
    plan = plan_of(recipe, names, numbers, [1.0] * len(frames), [exposure] * len(frames), frames[0].density.shape)
    passed = []

    def note(progress: Progress) -> None:
        if progress.frame == names[0]:
            passed.append(read())

    for _ in SequenceOptimisation(plan, frames, GoogLeNet.load(weights), store, cache_bytes).run(note):
        pass
    return passed


def jet(shape: tuple[int, int, int]) -> list[tnst_mi.Frame]:
    """The nine frames of the bundled jet, resampled to a shape of the same proportions."""
    frames = []
    for frame in tnst_mi.load_frames(SCENES / "smokejet"):
        finer = shape[1] / frame.density.shape[1]
        density = resample_density(frame.density, 1.0, shape, 1 / finer)
        velocity = finer * resample_velocity(frame.velocity, 1.0, shape, 1 / finer)
        frames.append(tnst_mi.Frame(density, velocity=velocity, name=frame.name, number=frame.number))
    return frames


def sequence(weights: str | None, shape: tuple[int, int, int] = (64, 96, 64), views: int = 1) -> dict[str, float]:
    """Seconds and bytes read from the store by iteration of a frame, in a sequence of nine with a window of 9."""
    frames = jet(shape)
    recipe = tnst_mi.Recipe.from_dict(STYLE | {"views": views, "iterations": 6, "window": 9})
    with tempfile.TemporaryDirectory() as folder:
        store = FolderStore(Path(folder))
        # A budget that a run would find on a machine with a few GB to spare.
        passed = iterated(frames, recipe, weights, store, lambda: (time.perf_counter(), store.bytes_read), 4 << 30)
    # The first iteration compiles kernels.
    seconds, read = np.diff(np.array(passed[1:]), axis=0).T / len(frames)
    found = {"seconds": float(np.median(seconds)), "bytes_read": float(np.mean(read))}
    print(f"  {1e3 * found['seconds']:.1f} ms and {found['bytes_read'] / 1e6:.1f} MB read by iteration of a frame")
    return found


def memory() -> dict[str, int | None]:
    """Peak bytes held by the process, by Dr.Jit, and by torch on a GPU."""
    on_gpu = mi.variant().startswith("cuda")
    backend = dr.JitBackend.CUDA if on_gpu else dr.JitBackend.LLVM
    torch_peak = torch.cuda.max_memory_allocated() if on_gpu else None
    return {"process": peak_memory(), "drjit": dr.detail.malloc_watermark(backend), "torch_on_gpu": torch_peak}


def exponent(name: str, rows: list[dict[str, float]]) -> float:
    """Slope of log seconds over log size, without the smallest size."""
    sizes, seconds = ([np.log(row[key]) for row in rows[1:]] for key in (name, "seconds"))
    return float(np.polyfit(sizes, seconds, 1)[0])


#: Bytes per cell that must be read or written if every array is touched once: the inputs and results of a part.
BYTES = {
    "transport, forward": 12,  # Φ, d → d*
    "transport, forward + backward": 12 + 16,  # and Φ, d, ∂L/∂d* → ∂L/∂Φ
    "rendering, forward": 4,  # d
    "rendering, forward + backward": 4 + 8,  # and d → ∂L/∂d
    "transport + rendering, forward + backward": 12 + 16 + 4 + 8,
    "smooth, normalise, step": 8 + 16,  # g → bands, whose RMS must be known; bands, mask, Φ → Φ
}


def floor(size: int, weights: str | None, repeat: int) -> dict[str, Any]:
    """This machine's bandwidth and rate of multiplication, and the resulting lower bound for every part in seconds."""
    from torch.utils.flop_counter import FlopCounterMode

    density = bundled_density(size)
    device = torch_device()
    source, target = torch.ones(2, 1 << 26, device=device)
    matrix = torch.ones(2048, 2048, device=device)
    network = GoogLeNet.load(weights).to(device)
    bound = objective_of(tnst_mi.Recipe.from_dict(STYLE)).bind(network, *density.shape[1:])
    view = torch.zeros(1, *density.shape[1:], device=device, requires_grad=True)
    tasks = {
        "copy": lambda: target.copy_(source),
        "multiply": lambda: matrix @ matrix,
        "network": lambda: torch.autograd.grad(bound(view), view),
    }
    seconds = medians(tasks, repeat)
    with FlopCounterMode(display=False) as counter:
        tasks["network"]()
    bandwidth, rate = 2 * source.nbytes / seconds["copy"], 2 * 2048**3 / seconds["multiply"]
    print(f"  {bandwidth / 1e9:.1f} GB/s, {rate / 1e9:.0f} GFLOP/s in float32")
    found = {name: density.size * count / bandwidth for name, count in BYTES.items()}
    found["network, one view, forward + backward"] = counter.get_total_flops() / rate
    for name, value in found.items():
        print(f"  {name:44s} {1e3 * value:8.2f} ms at least")
    print(f"  the network takes {1e3 * seconds['network']:.0f} ms")
    return {"bandwidth": bandwidth, "operations": rate, "seconds": found, "network_seconds": seconds["network"]}


def frame(weights: str | None) -> dict[str, Any]:
    """A whole frame of the paper's size."""
    density = bundled_density(PAPER_SHAPE)
    network = GoogLeNet.load(weights)
    since = time.perf_counter()
    result = optimise(tnst_mi.Frame(density), tnst_mi.Recipe.from_dict(PAPER), network)
    seconds = time.perf_counter() - since
    found = {"seconds": seconds, "timings": result.timings, "peak_memory": memory()}
    found["losses"] = [entry["loss"] for entry in result.history]
    print(f"  whole frame {PAPER_SHAPE}: {seconds:.0f} s, peak memory {(peak_memory() or 0) / 1e9:.2f} GB")
    return found


def print_row(label: str, seconds: dict[str, float]) -> None:
    """Milliseconds of every side, and their ratio to ours."""
    cells = (f"{name} {1e3 * value:8.1f} ({value / seconds['ours']:.1f}×)" for name, value in seconds.items())
    print(f"  {label:44s} {'   '.join(cells)}", flush=True)


def draw_scaling(path: Path, found: dict[str, list[dict[str, float]]]) -> None:
    """Seconds over size, both logarithmic."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 3), layout="constrained")
    for axes, (name, rows) in zip(figure.subplots(1, len(found)), found.items(), strict=True):
        axes.loglog([row[name] for row in rows], [row["seconds"] for row in rows], marker="o")
        axes.set(xlabel=name, ylabel="seconds")
        axes.grid(which="both", alpha=0.3)
    with written_whole(path) as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))


def chosen(only: str) -> Iterator[str]:
    """The requested sections."""
    for name in only.split(","):
        if name not in SECTIONS:
            raise SystemExit(f"--only {name!r}: expected some of {', '.join(SECTIONS)}")
        yield name


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=128, help="cells along x; H is 3/2 of it (default 128)")
    parser.add_argument("--repeat", type=int, default=7, help="timed calls of each part (default 7)")
    parser.add_argument("--weights", help="GoogLeNet weights (default: searched for)")
    parser.add_argument("--only", default=",".join(SECTIONS[:-1]), help="default: all but frame")
    parser.add_argument("--out", type=Path, help="folder for benchmark.json and scaling.png")
    arguments = parser.parse_args()
    variant = tnst_mi.activate()
    torch.set_num_threads(dr.thread_count())
    results: dict[str, Any] = {"versions": versions(), "device": device(variant), "size": arguments.size}
    print(f"{variant}, {dr.thread_count()} threads, H = {arguments.size * 3 // 2}: milliseconds (times ours)")
    for name in chosen(arguments.only):
        results[name] = {
            "parts": lambda: parts(arguments.size, arguments.repeat),
            "iteration": lambda: iteration(arguments.size, arguments.weights, max(1, arguments.repeat // 3)),
            "flow": lambda: flow(arguments.size, arguments.weights, arguments.repeat),
            "cameras": lambda: cameras(arguments.size, arguments.repeat),
            "scaling": lambda: scaling(arguments.weights, arguments.repeat),
            "sequence": lambda: sequence(arguments.weights),
            "floor": lambda: floor(arguments.size, arguments.weights, arguments.repeat),
            "frame": lambda: frame(arguments.weights),
        }[name]()
    results["peak_memory"] = memory()
    if arguments.out is not None:
        with written_whole(arguments.out / "benchmark.json") as temporary:
            temporary.write_text(json.dumps(results, indent=1) + "\n", "utf-8")
        if "scaling" in results:
            draw_scaling(arguments.out / "scaling.png", results["scaling"])


if __name__ == "__main__":
    main()
