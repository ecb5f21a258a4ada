"""Measures everything of interest on a GPU in one run of a few minutes, the most important first.

    python scripts/measure_gpu.py --out FOLDER [--reference FILE] [--weights FILE] [--parts NAME,…] [--budget SECONDS]
    python scripts/measure_gpu.py --record FILE [--weights FILE]        on a CPU: the reference of the agreement

environment  versions, GPU, driver, whether OptiX is installed
tiny         `stylize` on a frame of 24×36×24 cells: does it work at all
agreement    the first iteration of a semantic recipe on the bundled frame against that of the CPU, TF32 off: relative
             L2 differences of each stage's output for the CPU's input, and end to end; whether bits repeat
paper        a frame of the paper's size (200×300×200, 3 octaves × 20 iterations × 9 views) after a warm-up: seconds
             per octave, memory of both allocators
kernels      an iteration of that size, and of its coarsest octave's: milliseconds of its phases; Dr.Jit's kernels with
             their milliseconds, instructions, loads and stores
sequence     nine frames of 64×96×64 and of 128×192×128 cells with a window of 9 and 9 views, state in a folder: seconds
             per frame and iteration, alone and as one of three processes at a time
memory       peak bytes of both allocators for each parameterisation at three sizes: what run/memory is made from
large        a frame of 400×600×400 cells with one iteration in each octave
precision    the network in float32, TF32 and bfloat16, with 1, 3 and 9 views at once: milliseconds, memory, and the
             cosine between the derivative and that of float32
flow         transport, an iteration and a frame of the paper's size along the flow, beside one step; then such a frame
             with the package's defaults
cameras      rendering with rays of perspective cameras, beside parallel ones
peer         transport, rendering and a whole style iteration against plain PyTorch on the same card
compare      `tnst-mi compare --quick`: our renderer against Mitsuba's path tracer (needs OptiX)
beauty       `tnst-mi render --look medium`, with and without OptiX's denoiser
tests        the tests of what computes on the variant, in several processes where pytest-xdist is installed

Each part runs in a separate process, which is killed when it takes too long, and its result is on disk before the next
part begins, so that a run that is cut off still leaves results. Writes FOLDER/PART.json, FOLDER/PART.log, and gpu.json
with all parts. `--dry-run` uses small grids and the CPU. Exit code 1 if a part failed or the GPU and CPU disagree.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import importlib.util
import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import tnst_mi  # before torch: it lets torch's idle threads sleep

# isort: split
import numpy as np

from tnst_mi.machine.backend import torch_device

ROOT = Path(__file__).resolve().parents[1]
FRAME = ROOT / "scenes" / "suzanne" / "frame_0010.npz"

#: How far a stage may deviate from the CPU's, given the same input. Potentials differ where a limiter switches.
LIMITS = {
    "stylized": 1e-3,
    "flow": 1e-3,
    "flow_gradient": 1e-3,
    "near": 1e-3,
    "near_gradient": 1e-3,
    "images": 1e-3,
    "loss": 1e-3,
    "image_gradient_where_smoke_is_seen": 1e-2,
    "gradient": 1e-3,
    "potential": 1e-2,
}

#: Seconds after which a part is killed.
PARTS = {
    "environment": 60,
    "tiny": 90,
    "agreement": 60,
    "paper": 150,
    "kernels": 90,
    "sequence": 90,
    "memory": 100,
    "flow": 90,
    "cameras": 40,
    "large": 90,
    "precision": 60,
    "peer": 90,
    "compare": 120,
    "beauty": 90,
    "tests": 240,
}

Result = dict[str, Any]


def environment(options: argparse.Namespace) -> Result:
    """Versions, device, and which of the driver's libraries are installed."""
    import drjit as dr
    import torch

    from tnst_mi.machine.environment import device, versions

    libraries = subprocess.run(["ldconfig", "-p"], capture_output=True, text=True, check=False).stdout
    found = sorted({word for word in libraries.split() if word.startswith(("libnvoptix", "libcuda.so"))})
    return {
        "versions": versions() | {"cuda_of_torch": torch.version.cuda},
        "device": device(options.variant),
        "backends": [str(backend) for backend in (dr.JitBackend.CUDA, dr.JitBackend.LLVM) if dr.has_backend(backend)],
        "visible": os.environ.get("CUDA_VISIBLE_DEVICES"),
        "driver_libraries": found,
    }


def tiny(options: argparse.Namespace) -> Result:
    """Stylize a small frame with the public functions."""
    from benchmark import bundled_density

    frame = tnst_mi.Frame(bundled_density(24))
    recipe = tnst_mi.Recipe(style=("spirals",), octaves=2, iterations=2, views=3, weights="patterns")
    since = time.perf_counter()
    result = tnst_mi.stylize(frame, recipe, progress=False)
    seconds = time.perf_counter() - since
    change = np.linalg.norm(result.densities[0] - frame.density) / np.linalg.norm(frame.density)
    return {"seconds": seconds, "relative_change": float(change)}


def first_iteration(
    weights: str | None, size: int, given: dict[str, np.ndarray] | None = None
) -> dict[str, np.ndarray]:
    """The output of each stage of a first iteration, with Φ not 0 so that transport counts.

    `given` are the outputs on another machine: each stage starts from these instead of the previous stage's output
    here. The reason is the network: its max-pooling and ReLUs switch, and in empty space their inputs are equal up to
    rounding, so that a change of the images by 1e-7 changes the derivative there by half.
    """
    import drjit as dr
    import mitsuba as mi
    from benchmark import GAMMA, PAPER, bundled_density

    from tnst_mi.network.googlenet import GoogLeNet
    from tnst_mi.optimisation.goals import objective_of
    from tnst_mi.optimisation.parameterisation import Fields, Transport, normalised_step
    from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

    found: dict[str, np.ndarray] = {}

    def taken_over(name: str, array: mi.TensorXf) -> mi.TensorXf:
        found[name] = np.asarray(array.numpy(), np.float32)
        return array if given is None else mi.TensorXf(given[name])

    density = bundled_density(size)
    network = GoogLeNet.load(weights).to(torch_device())
    loss_of = objective_of(tnst_mi.Recipe.from_dict(PAPER)).bind(network, *density.shape[1:])
    transport = Transport(1.0)
    wave = np.sin(np.arange(density.shape[2]) / 3)
    fields = Fields(phi=mi.TensorXf(np.broadcast_to(np.float32(wave), density.shape).copy()))
    stylized, pull_back = transport.density_with_pullback(fields, mi.TensorXf(density), 1.0)
    seen = taken_over("stylized", stylized)
    dr.enable_grad(seen)
    rendered = EmissionAbsorptionRenderer(density.shape, GAMMA, "paper", 1.0).render(
        seen, tnst_mi.sample_views(PAPER["views"])
    )
    images = taken_over("images", dr.detach(rendered) * mi.Float(0.1))
    dr.enable_grad(images)
    loss = dr.wrap(source="drjit", target="torch")(loss_of)(images)
    found["loss"] = np.asarray(loss.numpy(), np.float32)
    dr.backward(loss)
    dr.set_grad(rendered, taken_over("image_gradient", dr.grad(images)) * mi.Float(0.1))
    dr.enqueue(dr.ADMode.Backward, rendered)
    dr.traverse(dr.ADMode.Backward)
    gradient = pull_back(taken_over("gradient", dr.grad(seen)))
    gradient = Fields(phi=taken_over("potential_gradient", gradient["phi"]))
    size = 0.002 * transport.unit_step(density.shape[1], 1.0)
    taken_over("potential", (fields - normalised_step(gradient, mi.TensorXf(density), size, 3))["phi"])
    return found | alone(density, wave)


def alone(density: np.ndarray, wave: np.ndarray) -> dict[str, np.ndarray]:
    """Stages that the iteration above does not use, each from the same input: the flow, and views in perspective."""
    import drjit as dr
    import mitsuba as mi
    from benchmark import GAMMA

    from tnst_mi.optimisation.parameterisation import Fields, Transport
    from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

    potential = np.broadcast_to(np.float32(8 * wave)[:, None], (*density.shape, 3)).copy()
    moved, pull_back = Transport(0.0, trace="flow").density_with_pullback(
        Fields(psi=mi.TensorXf(potential)), mi.TensorXf(density), 1.0
    )
    views = [(*map(float, view), 1.5 * density.shape[1]) for view in tnst_mi.sample_views(3)]
    leaf = mi.TensorXf(density)
    dr.enable_grad(leaf)
    images = EmissionAbsorptionRenderer(density.shape, GAMMA, "paper", 1.0).render(leaf, views)
    dr.backward(dr.sum(dr.square(images.array)))
    found = {
        "flow": moved,
        "flow_gradient": pull_back(mi.TensorXf(density))["psi"],
        "near": dr.detach(images),
        "near_gradient": dr.grad(leaf),
    }
    return {name: np.asarray(array.numpy(), np.float32) for name, array in found.items()}


def weights_hash(weights: str | None) -> str:
    """The SHA-256 of the network's weights file. In another precision, its derivatives differ by several per cent."""
    from tnst_mi.network.googlenet import GoogLeNet

    return GoogLeNet.load(weights).sha256


def agreement(options: argparse.Namespace) -> Result:
    """Relative L2 differences from the CPU's reference, per stage and end to end; whether the bits repeat."""
    with np.load(options.reference) as arrays:
        reference = {name: arrays[name] for name in arrays.files if name != "weights"}
        weights = str(arrays["weights"])
    if weights != weights_hash(options.weights):
        raise SystemExit("--reference was recorded with other weights: record it with --weights and the same file")
    size = reference["potential"].shape[2]
    stages = first_iteration(options.weights, size, reference)
    found, again = (first_iteration(options.weights, size) for _ in range(2))

    def difference(found: np.ndarray, name: str, where: np.ndarray | bool = True) -> float:
        return float(np.linalg.norm((found - reference[name]) * where) / np.linalg.norm(reference[name] * where))

    by_stage = {name: difference(stages[name], name) for name in stages}
    smoke = reference["images"] > 1e-2 * reference["images"].max()
    by_stage["image_gradient_where_smoke_is_seen"] = difference(stages["image_gradient"], "image_gradient", smoke)
    return {
        "by_stage": by_stage,
        "end_to_end": {name: difference(found[name], name) for name in found},
        "limits": LIMITS,
        "agrees": all(by_stage[name] <= limit for name, limit in LIMITS.items())
        and difference(found["potential"], "potential") <= LIMITS["potential"],
        "same_bits_twice": {name: found[name].tobytes() == again[name].tobytes() for name in found},
        "hashes": {name: hashlib.sha256(found[name].tobytes()).hexdigest() for name in found},
    }


def paper(options: argparse.Namespace) -> Result:
    """A frame of the paper's size, after one iteration of each octave as a warm-up."""
    return whole_frame(options, paper_shape(options), 20, warm=True)


def kernels(options: argparse.Namespace) -> Result:
    """The phases and kernels of an iteration at the paper's size, and at that of its coarsest octave."""
    views = 1 if options.dry_run else 9
    fine = iteration_kernels(options, paper_shape(options), views)
    coarse = iteration_kernels(options, (24, 36, 24) if options.dry_run else (64, 92, 64), views)
    return {"fine": fine, "coarse": {name: coarse[name] for name in ("milliseconds", "launches")}}


def paper_shape(options: argparse.Namespace) -> tuple[int, int, int]:
    """(D, H, W) of the paper's grids; of small ones in a dry run."""
    return (24, 36, 24) if options.dry_run else (200, 300, 200)


def large(options: argparse.Namespace) -> Result:
    """A frame with eight times the cells of the paper's."""
    return whole_frame(options, (32, 48, 32) if options.dry_run else (400, 600, 400), 1, warm=True)


def whole_frame(
    options: argparse.Namespace,
    shape: tuple[int, int, int],
    iterations: int,
    warm: bool,
    keys: dict[str, object] | None = None,
) -> Result:
    """Seconds and memory of stylizing one frame."""
    from benchmark import PAPER, bundled_density, memory

    from tnst_mi.network.googlenet import GoogLeNet
    from tnst_mi.optimisation.single_frame import optimise

    frame, network = tnst_mi.Frame(bundled_density(shape)), GoogLeNet.load(options.weights)
    recipe = tnst_mi.Recipe.from_dict(PAPER | {"iterations": iterations} | (keys or {}))
    found: Result = {"shape": shape, "iterations": iterations}
    if warm:
        since = time.perf_counter()
        optimise(frame, recipe.updated({"iterations": 1}, "", Path.cwd()), network)
        found["first_seconds"] = time.perf_counter() - since
    with device_memory() as fullest:
        since = time.perf_counter()
        result = optimise(frame, recipe, network)
        found["seconds"] = time.perf_counter() - since
    losses = [entry["loss"] for entry in result.history]
    return found | {
        "timings": result.timings,
        "memory": memory() | {"device": fullest[0] if fullest else None},
        "losses": [losses[0], losses[-1]],
        "mass": float(result.density.sum() / frame.density.sum()),
    }


@contextlib.contextmanager
def device_memory() -> Iterator[list[int]]:
    """The peak bytes in use on the GPU, as the list's first element; all processes and contexts count."""
    import threading

    import torch

    fullest: list[int] = []
    done = threading.Event()

    def watch() -> None:
        while not done.wait(0.02):
            free, total = torch.cuda.mem_get_info()
            fullest[:] = [max([total - free, *fullest])]

    watcher = threading.Thread(target=watch, daemon=True)
    if torch.cuda.is_available():
        watcher.start()
    try:
        yield fullest
    finally:
        done.set()
        if watcher.is_alive():
            watcher.join()


def iteration_kernels(options: argparse.Namespace, shape: tuple[int, int, int], views: int) -> Result:
    """One iteration at a given size: time of each phase, and Dr.Jit's kernels with their milliseconds on the device."""
    import drjit as dr
    from benchmark import PAPER, bundled_density
    from peers.sides import Iteration, Ours

    from tnst_mi.network.googlenet import GoogLeNet

    density = bundled_density(shape)
    network = GoogLeNet.load(options.weights).to(torch_device())
    whole = Iteration(density, tnst_mi.Recipe.from_dict(PAPER | {"views": views}), network, 0.1)
    parts = Ours(density, [tuple(view) for view in tnst_mi.sample_views(views)])
    pictures = parts.render_forward().torch().clone().requires_grad_()

    def judge() -> None:
        whole.problem.losses[0](pictures).backward()
        pictures.grad = None

    phases = {
        "transport": lambda: dr.eval(parts.transport_backward()),
        "rendering": lambda: dr.eval(parts.render_backward()),
        "network": judge,
        "step": lambda: dr.eval(parts.step()),
        "whole": whole,
    }
    milliseconds = {name: median_milliseconds(task) for name, task in phases.items()}
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        whole()
        dr.sync_thread()
        history = dr.kernel_history()
    kernels: dict[str, dict[str, float]] = defaultdict(lambda: {"launches": 0, "milliseconds": 0.0, "width": 0})
    for entry in history:
        kind = str(entry.get("type", "")).rsplit(".", 1)[-1]
        name = f"{kind} {entry.get('hash', '')}".strip()[:28]
        row = kernels[name]
        row["launches"] += 1
        row["milliseconds"] += float(entry.get("execution_time", 0.0))
        row["width"] = max(row["width"], int(entry.get("size", 0)))
        if "ir" in entry:
            row |= instructions(entry["ir"].getvalue())
    longest = sorted(kernels.items(), key=lambda item: -item[1]["milliseconds"])
    return {"milliseconds": milliseconds, "launches": len(history), "longest": dict(longest[:24])}


#: In PTX and in LLVM's language, what begins an instruction that reads or writes an array.
_LOADS = ("ld.global", "ldu.global", "@llvm.masked.gather", "load <")
_STORES = ("st.global", "red.", "atom.", "@llvm.masked.scatter", "store <")


def instructions(code: str) -> dict[str, int]:
    """Number of lines of a kernel's code, and how many of them read and write arrays."""
    lines = [line for line in code.splitlines() if not line.lstrip().startswith("declare")]
    return {
        "instructions": len(lines),
        "loads": sum(any(word in line for word in _LOADS) for line in lines),
        "stores": sum(any(word in line for word in _STORES) for line in lines),
    }


def median_milliseconds(task: Callable[[], object], repeat: int = 7) -> float:
    """Median of several calls, after a warm-up, each synchronised with the device."""
    import drjit as dr
    import torch

    times = []
    for _ in range(repeat + 1):
        dr.sync_thread()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        since = time.perf_counter()
        task()
        dr.sync_thread()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        times.append(1e3 * (time.perf_counter() - since))
    return statistics.median(times[1:])


def sequence(options: argparse.Namespace) -> Result:
    """Nine frames with a window of 9: by iteration of a frame, alone, and as one of three processes at a time."""
    from benchmark import sequence as measured

    shapes, views = ([(16, 24, 16)], 1) if options.dry_run else ([(64, 96, 64), (128, 192, 128)], 9)
    if options.beside:
        return measured(options.weights, shapes[0], views)
    found: Result = {"x".join(map(str, shape)): measured(options.weights, shape, views) for shape in shapes}
    with tempfile.TemporaryDirectory() as folder:
        outs = [Path(folder) / str(i) for i in range(3)]
        for out in outs:
            out.mkdir()
        command = [sys.executable, __file__, *sys.argv[1:], "--beside", "--part", "sequence", "--out"]
        processes = [subprocess.Popen([*command, str(out)], stdout=subprocess.DEVNULL) for out in outs]
        if any([process.wait() for process in processes]):
            return found | {"failed": "one of three processes"}
        beside = [json.loads((out / "sequence.json").read_text("utf-8"))["seconds"] for out in outs]
    return found | {"three_at_a_time": beside}


def memory(options: argparse.Namespace) -> Result:
    """Peak bytes of both allocators, of a process for each parameterisation and size, beside the estimate."""
    from benchmark import GAMMA, PAPER, bundled_density, jet
    from benchmark import memory as peak

    from tnst_mi.network.googlenet import GoogLeNet
    from tnst_mi.optimisation.goals import objective_of
    from tnst_mi.optimisation.items.store import MemoryStore
    from tnst_mi.optimisation.plan import plan_of
    from tnst_mi.optimisation.runner import SequenceOptimisation
    from tnst_mi.run.memory import Need

    kinds = {"scalar": {"lam": 1.0}, "vector": {"lam": 0.0}, "both": {"lam": 0.5}}
    kinds |= {"density": {"lam": 1.0, "parameterisation": "density"}, "window": {"lam": 1.0, "window": 3}}
    shapes = [(24, 36, 24)] if options.dry_run else [(96, 144, 96), (200, 300, 200), (280, 420, 280)]
    if options.beside:
        kind, number = options.beside.split(",")
        shape = shapes[int(number)]
        recipe = tnst_mi.Recipe.from_dict(PAPER | kinds[kind] | {"iterations": 2})
        network = GoogLeNet.load(options.weights)
        saved = objective_of(recipe).bind(network, *shape[1:]).saved_bytes / (shape[1] * shape[2])
        frames = jet(shape)[:3] if kind == "window" else [tnst_mi.Frame(bundled_density(shape), name="smoke")]
        names, numbers = [frame.name for frame in frames], [frame.number for frame in frames]
        plan = plan_of(recipe, names, numbers, [1.0] * len(frames), [GAMMA] * len(frames), shape)
        for _ in SequenceOptimisation(plan, frames, network, MemoryStore(), 0).run():
            pass
        need = Need(shape, recipe, 1, saved, on_disk=True)
        return {"shape": shape, "estimate": need.total, "saved_by_pixel": saved, **peak()}
    found: Result = {}
    command = [sys.executable, __file__, *sys.argv[1:], "--part", "memory"]
    for kind in kinds:
        for number in range(len(shapes)):
            with tempfile.TemporaryDirectory() as folder:
                done = subprocess.run([*command, "--beside", f"{kind},{number}", "--out", folder], check=False)
                if done.returncode:
                    return found | {"failed": f"{kind}, {shapes[number]}"}
                found[f"{kind} {number}"] = json.loads((Path(folder) / "memory.json").read_text("utf-8"))
    return found


def precision(options: argparse.Namespace) -> Result:
    """The network with lower-precision products and fewer views at once: time, memory, cosine of the derivative."""
    import torch
    from benchmark import PAPER, STYLE, bundled_density

    from tnst_mi.losses import evaluation
    from tnst_mi.network.googlenet import GoogLeNet
    from tnst_mi.optimisation.goals import objective_of

    count = 3 if options.dry_run else 9
    density = bundled_density(24 if options.dry_run else (200, 300, 200))
    images = tnst_mi.render(density, [tuple(view) for view in tnst_mi.sample_views(count)])
    network = GoogLeNet.load(options.weights).to(torch_device())
    pictures = torch.as_tensor(images / images.max(), device=torch_device())
    on_gpu = pictures.device.type == "cuda"
    layouts = {"channels last": torch.channels_last, "contiguous": torch.contiguous_format}
    found: Result = {}
    for name, keys in (("semantic", PAPER), ("style", STYLE)):
        bound = objective_of(tnst_mi.Recipe.from_dict(keys)).bind(network, *density.shape[1:])
        exact: torch.Tensor | None = None
        for kind, layout, at_once in itertools.product(("float32", "tf32", "bfloat16"), layouts, (9, 3, 1)):
            if layout != "channels last" and at_once != 9:
                continue
            evaluation.views_at_once = lambda count, saved, at_once=at_once: min(count, at_once)
            network.to(memory_format=layouts[layout])
            torch.backends.cudnn.allow_tf32 = torch.backends.cuda.matmul.allow_tf32 = kind == "tf32"
            cast = torch.autocast(pictures.device.type, torch.bfloat16, enabled=kind == "bfloat16")

            def differentiate(bound: Any = bound, cast: Any = cast) -> torch.Tensor:
                leaf = pictures.detach().requires_grad_()
                with cast:
                    bound(leaf).backward()
                return leaf.grad

            if on_gpu:
                torch.cuda.empty_cache()
                torch.cuda.reset_peak_memory_stats()
            row = {"milliseconds": median_milliseconds(differentiate, 5)}
            derivative = differentiate().double().flatten()
            exact = derivative if exact is None else exact
            row["cosine"] = float(torch.nn.functional.cosine_similarity(derivative, exact, dim=0))
            if on_gpu:
                row["gigabytes"] = torch.cuda.max_memory_allocated() / 1e9
            found[f"{name}, {kind}, {layout}, {at_once}"] = row
            print(name, kind, layout, at_once, row, flush=True)
    return found


def peer(options: argparse.Namespace) -> Result:
    """Ours and plain PyTorch on the same device, measured alternately."""
    import benchmark

    size = 24 if options.dry_run else 128
    return {
        "size": size,
        "parts": benchmark.parts(size, 9),
        "iteration": benchmark.iteration(size, options.weights, 5),
    }


def flow(options: argparse.Namespace) -> Result:
    """The flow beside one step: parts, an iteration, and a frame of the paper's size."""
    import benchmark

    shape, size = ((24, 36, 24), 24) if options.dry_run else ((200, 300, 200), 128)
    found: Result = {"parts": benchmark.flow(size, options.weights, 7)}
    defaults = tnst_mi.Recipe()
    ways: dict[str, dict[str, object]] = {
        "step": {"transport": "step"},
        "flow": {"transport": "flow"},
        "defaults": {name: getattr(defaults, name) for name in ("transport", "lam", "motif_size")},
    }
    return found | {name: whole_frame(options, shape, 20, True, keys) for name, keys in ways.items()}


def cameras(options: argparse.Namespace) -> Result:
    """Rays that converge in an eye beside parallel ones, nine views."""
    import benchmark

    sizes = (24,) if options.dry_run else (64, 128)
    return {str(size): benchmark.cameras(size, 7) for size in sizes}


def compare(options: argparse.Namespace) -> Result:
    """Our renderer against Mitsuba's path tracer through the command, on the GPU if one is available."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "tnst_mi", "compare", str(FRAME), "--quick", "--out", folder, "--debug"]
        process = subprocess.run(command, capture_output=True, text=True, check=False)
    print(process.stdout, process.stderr)
    return {"exit_code": process.returncode, "verdict": process.stdout.strip().splitlines()[-12:]}


def beauty(options: argparse.Namespace) -> Result:
    """Lit, path-traced pictures through the command, with and without OptiX's denoiser."""
    found: Result = {}
    for name, flags in (("plain", []), ("denoised", ["--denoise"])):
        out = options.out / name
        since = time.perf_counter()
        command = [sys.executable, "-m", "tnst_mi", "render", str(FRAME), "--look", "medium", "--out", str(out)]
        process = subprocess.run(
            [*command, "--variant", options.variant, *flags], capture_output=True, text=True, check=False
        )
        print(process.stdout, process.stderr)
        found[name] = {
            "seconds": time.perf_counter() - since,
            "exit_code": process.returncode,
            "said": process.stderr.strip().splitlines()[-3:],
        }
    return found | {"exit_code": max(row["exit_code"] for row in found.values())}


def tests(options: argparse.Namespace) -> Result:
    """The part of the suite that computes on the variant, without the runs that are killed: they fork."""
    folders = ("fields", "losses", "rendering", "optimisation", "regions", "compare")
    paths = [str(ROOT / "tests" / folder) for folder in folders]
    if options.dry_run:
        paths = [str(ROOT / "tests" / "fields" / "test_grid.py")]
    command = [sys.executable, "-m", "pytest", "-q", "--no-header", "-p", "no:cacheprovider", "--tb=short", *paths]
    command += [f"--ignore={ROOT / 'tests' / 'optimisation' / 'test_kill.py'}"]
    if importlib.util.find_spec("xdist") is not None:
        command += ["-n", str(max(1, (os.cpu_count() or 1) // 2))]
    process = subprocess.run(
        command,
        cwd=ROOT,
        env=os.environ | {"TNST_MI_TEST_VARIANT": options.variant},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    print(process.stdout)
    failed = [line for line in process.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return {"exit_code": process.returncode, "closing": process.stdout.strip().splitlines()[-1:], "failed": failed}


def run_part(name: str, options: argparse.Namespace) -> None:
    """Run a part in this process; its result goes to a file."""
    try:
        tnst_mi.activate(options.variant)
        torch_device()  # switches TF32 off
    except tnst_mi.InputError as error:
        raise SystemExit(f"measure_gpu: {error}, or --dry-run") from None
    result = globals()[name](options)
    (options.out / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n", "utf-8")


def in_process(name: str, options: argparse.Namespace, limit: float) -> Result:
    """Run a part in a separate process; return its result, or why there is none."""
    command = [sys.executable, __file__, *sys.argv[1:], "--part", name]
    since = time.perf_counter()
    path, log = options.out / f"{name}.json", options.out / f"{name}.log"
    path.unlink(missing_ok=True)
    with log.open("w") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, start_new_session=True)
        try:
            code: object = process.wait(limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            code = f"ended after {limit:.0f} s"
    found = json.loads(path.read_text("utf-8")) if path.exists() else {"failed": code, "log": log.read_text()[-1500:]}
    return {"part_seconds": time.perf_counter() - since} | found


def failed(result: Result) -> bool:
    """Whether a part's result indicates a failure."""
    return bool(result.get("failed")) or result.get("agrees") is False or result.get("exit_code", 0) != 0


def main() -> None:
    """Measure and write part by part, or run one part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for the results")
    parser.add_argument("--variant", default="cuda_ad_rgb")
    parser.add_argument("--weights", help="GoogLeNet weights (default: searched for)")
    parser.add_argument("--reference", type=Path, help="what --record wrote")
    parser.add_argument("--record", type=Path, help="write the CPU's reference to this .npz and exit")
    parser.add_argument("--parts", default=",".join(PARTS), help="default: all, in order")
    parser.add_argument("--budget", type=float, default=480.0, help="seconds for everything (default 480)")
    parser.add_argument("--dry-run", action="store_true", help="small grids on llvm_ad_rgb")
    parser.add_argument("--part", help=argparse.SUPPRESS)
    parser.add_argument("--beside", nargs="?", const="yes", default="", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.dry_run:
        options.variant = "llvm_ad_rgb"
    if options.record is not None:
        tnst_mi.activate("llvm_ad_rgb")
        found = first_iteration(options.weights, 24 if options.dry_run else 64)
        np.savez_compressed(options.record, weights=np.array(weights_hash(options.weights)), **found)
        return
    if options.out is None:
        parser.error("--out FOLDER is missing")
    if "agreement" in options.parts.split(",") and options.reference is None and options.part is None:
        parser.error("agreement needs --reference FILE: record one on a CPU with --record, or give --parts without it")
    options.out.mkdir(parents=True, exist_ok=True)
    if options.part is not None:
        run_part(options.part, options)
        return

    since = time.perf_counter()
    found: dict[str, Result] = {}
    for name in options.parts.split(","):
        if name not in PARTS:
            parser.error(f"--parts {name!r}: expected some of {', '.join(PARTS)}")
        left = options.budget - (time.perf_counter() - since)
        if left < 10:
            found[name] = {"failed": "left out: the budget is used up"}
        else:
            found[name] = in_process(name, options, min(left, PARTS[name]))
        print(name, json.dumps(found[name]), flush=True)
        (options.out / "gpu.json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    sys.exit(any(map(failed, found.values())))


if __name__ == "__main__":
    main()
