"""All that is to be known of a GPU, in one run: does it agree with the CPU, how fast is it, what memory does it take.

    python scripts/measure_gpu.py --out FOLDER [--variant cuda_ad_rgb] [--weights FILE] [--dry-run]

1. The first iteration of a semantic recipe on the bundled frame, on the CPU and on the GPU, TF32 off: relative L2
   differences of images, loss, derivative with respect to the stylized density, and potentials after the step.
2. A frame of the paper's size (200×300×200, 3 octaves × 20 iterations × 9 views), after one to warm up, and one of
   400×600×400 with a single iteration in each octave: seconds by octave and the device's memory at its fullest.

Each part is a process of its own, for what a process has held is only told at its end. `--dry-run` takes small grids
and the CPU for both sides: it shows that the script works, and that it finds no differences between equals. Writes
gpu.json; exit code 1 where the two do not agree.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmark import GAMMA, PAPER, PAPER_SHAPE, bundled_density

LARGE_SHAPE = (400, 600, 400)

#: How far the GPU may be from the CPU: potentials differ where a limiter decides otherwise.
LIMITS = {"images": 1e-3, "loss": 1e-3, "gradient": 1e-3, "potential": 1e-2}


def first_iteration(variant: str, weights: str | None, size: int, path: Path) -> None:
    """Write the images, loss, derivative and potential of a first iteration, with Φ not 0 so that transport counts."""
    import tnst_mi

    tnst_mi.activate(variant)
    import drjit as dr
    import mitsuba as mi
    import torch

    from tnst_mi.backend import torch_device
    from tnst_mi.goals import objective_of
    from tnst_mi.googlenet import GoogLeNet
    from tnst_mi.grid import Octave
    from tnst_mi.parameterisation import Transport
    from tnst_mi.scene import GridScene

    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = False
    density = bundled_density(size)
    network = GoogLeNet.load(weights).to(torch_device())
    loss_of = objective_of(tnst_mi.Recipe.from_dict(PAPER)).bind(network, *density.shape[1:])
    parameters = Transport(1.0)
    wave = np.sin(np.arange(density.shape[2]) / 3)
    parameters.restore({"phi": np.broadcast_to(np.float32(wave), density.shape)}, Octave(density.shape, 1.0))
    parameters.attach()
    stylized = parameters.density(mi.TensorXf(density))
    seen = dr.detach(stylized)
    dr.enable_grad(seen)
    views = tnst_mi.sample_views(PAPER["views"])
    images = GridScene(density.shape, GAMMA, "paper", 1.0, len(views)).render(seen, views) * mi.Float(0.1)
    loss = dr.wrap(source="drjit", target="torch")(loss_of)(images)
    dr.backward(loss)
    gradient = dr.grad(seen)
    dr.set_grad(stylized, gradient)
    dr.enqueue(dr.ADMode.Backward, stylized)
    dr.traverse(dr.ADMode.Backward)
    parameters.find_steps(mi.TensorXf(density), 0.002, density.shape[1], 3)
    parameters.descend()
    arrays = {"images": images, "loss": loss, "gradient": gradient, "potential": parameters.fields["phi"]}
    np.savez(path, **{name: array.numpy() for name, array in arrays.items()})


def whole_frame(
    variant: str, weights: str | None, shape: tuple[int, int, int], iterations: int, warm: bool, path: Path
) -> None:
    """Write the seconds and the memory of stylizing one frame, after one iteration of each octave to warm up."""
    import tnst_mi

    tnst_mi.activate(variant)
    from tnst_mi.environment import peak_memory
    from tnst_mi.googlenet import GoogLeNet
    from tnst_mi.optimise import optimise

    frame, network = tnst_mi.Frame(bundled_density(shape)), GoogLeNet.load(weights)
    if warm:
        optimise(frame, tnst_mi.Recipe.from_dict(PAPER | {"iterations": 1}), network)
    since = time.perf_counter()
    result = optimise(frame, tnst_mi.Recipe.from_dict(PAPER | {"iterations": iterations}), network)
    found: dict[str, Any] = {"seconds": time.perf_counter() - since, "timings": result.timings}
    found |= {"shape": shape, "iterations": iterations, "host_memory_bytes": peak_memory()}
    path.write_text(json.dumps(found))


def in_process(arguments: list[str], gpu: bool) -> int:
    """Run this script as a worker; the most memory, in MiB, that the GPU held meanwhile (0 on a CPU)."""
    process = subprocess.Popen([sys.executable, __file__, *arguments])
    fullest = 0

    def watch() -> None:
        nonlocal fullest
        command = ["nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader,nounits"]
        while process.poll() is None:
            answer = subprocess.run(command, capture_output=True, text=True, check=False).stdout.split()
            fullest = max([fullest, *map(int, answer[:1])])
            time.sleep(0.1)

    watcher = threading.Thread(target=watch, daemon=True)
    if gpu:
        watcher.start()
    if process.wait():
        raise SystemExit(f"{' '.join(arguments)}: failed")
    return fullest


def relative_differences(first: Path, second: Path) -> dict[str, float]:
    """‖a − b‖ / ‖a‖ of every array."""
    with np.load(first) as a, np.load(second) as b:
        return {name: float(np.linalg.norm(a[name] - b[name]) / np.linalg.norm(a[name])) for name in a.files}


def main() -> None:
    """Measure, judge, write; or do a worker's part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--variant", default="cuda_ad_rgb")
    parser.add_argument("--weights")
    parser.add_argument("--dry-run", action="store_true")
    parser.add_argument("--worker", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        kind, variant, path, *rest = options.worker
        if kind == "iteration":
            first_iteration(variant, options.weights, int(rest[0]), Path(path))
        else:
            shape = tuple(map(int, rest[0].split(",")))
            whole_frame(variant, options.weights, shape, int(rest[1]), rest[2] == "warm", Path(path))
        return

    variant = "llvm_ad_rgb" if options.dry_run else options.variant
    gpu = variant.startswith("cuda")
    common = ["--weights", options.weights] if options.weights else []
    found: dict[str, Any] = {"variant": variant}
    with tempfile.TemporaryDirectory() as folder:
        files = {}
        for side, of_side in (("cpu", "llvm_ad_rgb"), ("gpu", variant)):
            files[side] = Path(folder) / f"{side}.npz"
            size = "24" if options.dry_run else "64"
            in_process([*common, "--worker", "iteration", of_side, str(files[side]), size], False)
        found["relative_differences"] = relative_differences(files["cpu"], files["gpu"])
        paper, large = ((24, 36, 24), (32, 48, 32)) if options.dry_run else (PAPER_SHAPE, LARGE_SHAPE)
        for name, shape, iterations, warm in (("paper", paper, 20, "warm"), ("large", large, 1, "cold")):
            path = Path(folder) / f"{name}.json"
            size = ",".join(map(str, shape))
            worker = ["--worker", "frame", variant, str(path), size, str(iterations), warm]
            fullest = in_process([*common, *worker], gpu)
            found[name] = json.loads(path.read_text()) | {"device_memory_mib": fullest}
    found["agrees"] = all(found["relative_differences"][name] <= limit for name, limit in LIMITS.items())
    print(json.dumps(found, indent=1))
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "gpu.json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    sys.exit(not found["agrees"])


if __name__ == "__main__":
    main()
