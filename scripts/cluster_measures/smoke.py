"""Smoke in closed form, and a digest of what a run makes of it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from tnst_mi.frame import Frame
from tnst_mi.io import save_frames

#: How far the smoke turns from one frame to the next, in radians.
TURN = 0.05

#: The folders of a run in which its results are.
RESULTS = ("density", "velocity", "state", "images")


def write_smoke(folder: Path, count: int, shape: tuple[int, int, int]) -> Path:
    """Write frames of a lumpy ball that a vortex carries around the z axis, and return their folder.

    Args:
        folder: where to.
        count: number of frames.
        shape: (D, H, W), in cells.
    """
    z, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in shape), indexing="ij")
    radius = min(shape) / 3.2
    velocity = np.stack([-TURN * y, TURN * x, np.zeros(shape)], axis=-1).astype(np.float32)
    frames = []
    for number in range(count):
        # Where the smoke of a cell was in the first frame.
        cos, sin = np.cos(TURN * number), np.sin(TURN * number)
        u, v = cos * x + sin * y, cos * y - sin * x
        distance = np.sqrt((u - radius / 2) ** 2 + v**2 + z**2)
        lumps = 0.7 + 0.3 * np.sin(6 * u / radius) * np.sin(6 * v / radius) * np.sin(6 * z / radius)
        density = (np.clip(radius - distance, 0, 1) * lumps).astype(np.float32)
        frames.append(Frame(density, velocity, name=f"smoke_{number:04d}", number=number))
    save_frames(folder, frames)
    return folder


def digest(out: Path) -> str:
    """SHA-256 of the results of a run: all arrays and pictures, and the losses of all iterations.

    Videos are left out: the encoder decides their bytes.
    """
    total = hashlib.sha256()
    for path in sorted(path for kind in RESULTS for path in (out / kind).glob("*") if path.suffix != ".mp4"):
        total.update(f"{path.relative_to(out).as_posix()}\n".encode() + path.read_bytes())
    entries = [json.loads(line) for line in (out / "metrics.jsonl").read_text("utf-8").splitlines()]
    losses = sorted((entry["frame"], entry["octave"], entry["iteration"], entry["loss"]) for entry in entries)
    total.update(json.dumps(losses).encode())
    return total.hexdigest()
