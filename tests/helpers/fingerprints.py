"""Eight small stylizations and what they gave when they were recorded, to tell whether a change of the code moves them.

    python tests/helpers/fingerprints.py             # hold what they give now against the record
    python tests/helpers/fingerprints.py --record    # record what they give now

Together they cover every goal, both parameterisations, both renderers, λ = 0, ½ and 1, keyframes, an obstacle, and
sequences with and without a window. They use public names of the package alone, so that its modules may move.

Bits repeat on one machine only: other vector units, thread counts and versions add in another order. There the record
can be held to a tolerance, but not to a fine one. A stylization has kinks (max-pooling and ReLUs of the network, the
limiter of the transport), and rounding that pushes a value over one of them moves these small results by up to some
1e-4 of what the stylization changes; larger steps η, by far more. The runs here are such that it stays below
`TOLERANCE`, with 1 to 4 threads and with inputs changed by ±1e-7 of their values.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import json
import platform
import re
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import tnst_mi

DATA = Path(__file__).parents[1] / "data" / "fingerprints.npz"

TOLERANCE = 1e-3
"""Of the norm of what a stylization changes: how far another machine may come from the record."""

SHAPE = (22, 34, 30)
"""Cells (D, H, W); the coarse octave's images have 19×17 pixels, below 18×16 torch does not repeat to the bit."""

FIRST = 7
"""Number of the first frame."""

SHARED = {"weights": "patterns", "octaves": 2, "iterations": 2, "views": 3, "gamma": 0.2, "eta": 0.002}
"""Keys of all recipes."""


@dataclass(frozen=True)
class Run:
    """One stylization.

    Attributes:
        keys: of its recipe, besides those that all share.
        frames: how many there are.
        solid: whether they have an obstacle.
        haze: whether there is some smoke everywhere.
        rounding: how far a repetition may come from the record on the machine that made it, of the norm of what
            changes; 0 asks for the same bits.
    """

    keys: dict[str, Any] = field(default_factory=dict)
    frames: int = 1
    solid: bool = False
    haze: bool = False
    rounding: float = 0.0


RUNS = {
    "style": Run({"style": ["spirals"], "lam": 1.0}),
    "style_window": Run(
        {"style": ["flames"], "lam": 0.5, "window": 3, "window_weights": "gaussian", "coherence": 1.0}, frames=4
    ),
    "semantic": Run({"semantic": ["inception_3b/output:5,9"], "lam": 0.0, "damping": 0.1, "steps": "auto"}, solid=True),
    "semantic_window": Run(
        {"semantic": ["inception_4b/pool_proj:16"], "lam": 0.0, "transport": "step", "window": 3}, frames=4
    ),
    "tag": Run(
        {"tag": ["spiral"], "lam": {7: 0.0, 9: 1.0}, "gamma": {7: 0.1, 9: 0.4}, "quadrature": "exact"}, frames=3
    ),
    "content": Run({"content": ["cells"], "style": ["net"], "lam": 0.5, "blend": 0.75}),
    # Where an image is black, rounding decides to which of the equal pixels max-pooling sends a gradient. Transport
    # has no use for the gradient there, but an offset of the density has.
    "density": Run({"style": ["cells"], "parameterisation": "density", "window": 3, "eta": 0.01}, frames=4, haze=True),
    "path_traced": Run(
        {"semantic": ["inception_3b/output:5"], "lam": 1.0, "integrator": "prbvolpath", "spp": 8, "gamma": 0.5},
        rounding=1e-5,
    ),
}


@dataclass(frozen=True)
class Outcome:
    """What a run gave.

    Attributes:
        hashes: SHA-256 of the bytes of every density and velocity, by what it is of.
        change: what the stylization changed of the middle frame's density, d* − d, in means of 2×2×2 cells.
        velocity: the middle frame's velocity v*, likewise.
    """

    hashes: dict[str, str]
    change: np.ndarray
    velocity: np.ndarray

    def unlike(self, other: Outcome) -> list[str]:
        """The arrays whose bits are others."""
        return [name for name in self.hashes | other.hashes if self.hashes.get(name) != other.hashes.get(name)]

    def distance(self, recorded: Outcome) -> float:
        """The norm of the difference relative to that of what was recorded: of density or velocity, the larger one."""
        pairs = [(self.change, recorded.change), (self.velocity, recorded.velocity)]
        return max(float(np.linalg.norm(a - b) / max(np.linalg.norm(b), 1e-30)) for a, b in pairs)


def outcome(name: str, **changes: object) -> Outcome:
    """Do a run, with some keys of its recipe changed."""
    run = RUNS[name]
    frames = smoke(run.frames, run.solid, run.haze)
    recipe = tnst_mi.Recipe(**SHARED | run.keys | changes)
    result = tnst_mi.stylize(frames, recipe, progress=False)
    hashes = {}
    for frame, density, velocity in zip(frames, result.densities, result.velocities, strict=True):
        for what, array in (("density", density), ("velocity", velocity)):
            assert array.dtype == np.float32
            hashes[f"{what} of {frame.name}"] = hashlib.sha256(np.ascontiguousarray(array)).hexdigest()
    middle = run.frames // 2
    change = result.densities[middle] - frames[middle].density
    return Outcome(hashes, _coarse(change), _coarse(result.velocities[middle]))


def smoke(count: int, solid: bool = False, haze: bool = False) -> list[tnst_mi.Frame]:
    """Frames of a lumpy cloud that a shear flow (a (y − Y), b, c) carries along.

    No number is round and nothing symmetric: equal values, whose order rounding decides, would be kinks.
    """
    z, y, x = np.indices(SHAPE, dtype=np.float64)
    middle_z, middle_y, middle_x = 10.37, 14.61, 14.83
    a, b, c = 0.0613, 0.4271, -0.2339
    velocity = np.stack([a * (y - middle_y), np.full(SHAPE, b), np.full(SHAPE, c)], axis=-1)
    obstacle = (x - 20) ** 2 + (y - 12) ** 2 + (z - 11) ** 2 < 16 if solid else None
    frames = []
    for t in range(count):
        # Where the flow has brought the smoke of these cells from.
        x0, y0, z0 = x - a * (y - middle_y) * t + a * b * t * t / 2, y - b * t, z - c * t
        square = ((x0 - middle_x) / 12) ** 2 + ((y0 - middle_y) / 13) ** 2 + ((z0 - middle_z) / 9) ** 2
        lumps = _wave((x0 + 0.3 * y0 - 0.2 * z0) / 8.7) * _wave((y0 - 0.4 * x0 + 0.3 * z0) / 7.9 + 0.3)
        finer = _wave((z0 + 0.35 * x0) / 6.7 + 0.1) * _wave((y0 + 0.5 * z0) / 9.3)
        density = np.maximum(1 - square, 0) * (1 + 0.45 * (lumps + finer)) / 2
        if haze:
            density += 0.02 + 0.01 * _wave((x + 0.3 * y) / 61.3 + 0.11) * _wave((y - 0.2 * z) / 73.1 + 0.07)
        if solid:
            density[obstacle] = 0
        frames.append(tnst_mi.Frame(density, velocity, obstacle, f"frame_{FIRST + t:04d}", FIRST + t))
    return frames


def _wave(t: np.ndarray) -> np.ndarray:
    """A wave of period 1 between −1 and 1, of parabolas: unlike a sine's, its bits are the same on all machines."""
    t = 2 * (t - np.floor(t)) - 1
    return 4 * t * (1 - np.abs(t))


def _coarse(field: np.ndarray) -> np.ndarray:
    """Means of 2×2×2 cells: an eighth of the numbers, to which all of them contribute."""
    depth, height, width = (n // 2 for n in SHAPE)
    return field.reshape(depth, 2, height, 2, width, 2, -1).mean(axis=(1, 3, 5), dtype=np.float64).astype(np.float32)


def machine() -> dict[str, str]:
    """All that decides how sums are rounded: variant, processor, threads, and the versions that compute."""
    variant = tnst_mi.activate()
    # Before the package is imported, torch's threads would spin, and a busy machine take ten times as long.
    import drjit as dr
    import torch

    return {
        "variant": variant,
        "processor": _processor(),
        "threads": str(dr.thread_count()),
        "llvm": ".".join(map(str, dr.detail.llvm_version())) if dr.has_backend(dr.JitBackend.LLVM) else "",
        "torch": f"{torch.__version__} {torch.backends.cpu.get_cpu_capability()}",
        **{name: importlib.metadata.version(name) for name in ("drjit", "mitsuba", "numpy")},
    }


def _processor() -> str:
    """Family and vector units, from which LLVM and torch choose their instructions."""
    try:
        first = Path("/proc/cpuinfo").read_text("utf-8").split("\n\n")[0]
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    entries = dict(re.findall(r"^(.*?)\s*:\s*(.*)$", first, re.MULTILINE))
    names = ("vendor_id", "cpu family", "model", "CPU implementer", "CPU part")
    flags = entries.get("flags", entries.get("Features", "")).split()
    units = sorted(flag for flag in flags if re.match(r"sse4|avx|fma|amx|asimd|sve", flag))
    return " ".join([platform.machine(), *(entries[name] for name in names if name in entries), *units])


def record(outcomes: dict[str, Outcome]) -> None:
    """Write the record, of this machine."""
    arrays = {"machine": np.array(json.dumps(machine()))}
    for name, found in outcomes.items():
        arrays[f"{name}/hashes"] = np.array(json.dumps(found.hashes))
        arrays[f"{name}/change"], arrays[f"{name}/velocity"] = found.change, found.velocity
    np.savez_compressed(DATA, **arrays)


def recorded() -> tuple[dict[str, str], dict[str, Outcome]]:
    """The machine of the record, and the outcomes of its runs."""
    with np.load(DATA, allow_pickle=False) as arrays:
        outcomes = {
            name: Outcome(
                json.loads(str(arrays[f"{name}/hashes"])), arrays[f"{name}/change"], arrays[f"{name}/velocity"]
            )
            for name in {key.partition("/")[0] for key in arrays} - {"machine"}
        }
        return json.loads(str(arrays["machine"])), outcomes


def main() -> None:
    """Do all runs, and record them or hold them against the record."""
    parser = argparse.ArgumentParser(description="Fingerprints of small stylizations.")
    parser.add_argument("--record", action="store_true", help=f"write {DATA.name} in place of comparing with it")
    recording = parser.parse_args().record
    tnst_mi.activate("llvm_ad_rgb")
    print(f"package: {Path(tnst_mi.__file__).parent}\nmachine: {machine()}")
    known, expected = ({}, {}) if recording else recorded()
    if not recording:
        print(f"record:  {'this machine' if known == machine() else known}")
    outcomes = {}
    for name in RUNS:
        started = time.perf_counter()
        found = outcomes[name] = outcome(name)
        line = f"{name:16} {time.perf_counter() - started:5.1f} s"
        if not recording:
            line += f"  {len(found.unlike(expected[name]))} of {len(found.hashes)} arrays are others"
            line += f", {found.distance(expected[name]):.1e} of the change"
        print(line)
    if recording:
        record(outcomes)
        print(f"{DATA}: {DATA.stat().st_size} bytes")


if __name__ == "__main__":
    main()
