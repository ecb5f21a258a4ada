"""Undamaged files that tnst_mi has written itself, or finds beside others: of runs, atlases and Blender's caches."""

from __future__ import annotations

import gzip
import io
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, PngImagePlugin

from fuzzing import corpus
from tnst_mi import Recipe
from tnst_mi.io.grids.vdb import DenseGrid, write_vdb
from tnst_mi.io.grids.vdb.programs import BLENDER
from tnst_mi.optimisation.items.store import FolderStore

#: The frame of the runs.
FRAME = "smoke_0001"

#: The hash of their weights.
WEIGHTS = "0" * 64


def run_files(folder: Path) -> Iterator[bytes]:
    """The record of a run, finished or not, as run.json."""
    finished: dict[str, Any] = {
        "status": "done",
        "input": "/smoke",
        "format": "npz",
        "seed": 0,
        "weights": {"sha256": WEIGHTS, "flavour": "patterns"},
        "inputs": {FRAME: "1" * 64},
        "files": {"/smoke/style.png": "2" * 64},
        "frames": [{"name": FRAME, "complete": True, "loss_before": 1.5, "loss_after": -0.5, "history": [1.0, 0.5]}],
        "sequence": None,
    }
    yield json.dumps(finished, indent=1).encode()
    yield json.dumps(finished | {"frames": [], "status": "running"}).encode()


def run_recipe_files(folder: Path) -> Iterator[bytes]:
    """The recipe of a run, which is compared with that of the command."""
    yield Recipe().to_toml().encode()


def state_files(folder: Path) -> Iterator[bytes]:
    """Items of a run's working state."""
    rng = np.random.default_rng(0)
    phi = rng.normal(size=(3, 4, 5)).astype(np.float32)
    for arrays in ({"phi": phi, "psi": np.stack([phi] * 3, -1), "mask": phi > 0}, {"density": phi.astype(np.float16)}):
        FolderStore(folder).write("fields", 0, 1, arrays)
        yield (folder / "fields" / "000000.000001.safetensors").read_bytes()


def numbers_files(folder: Path) -> Iterator[bytes]:
    """Numbers of a run's working state."""
    store = FolderStore(folder)
    store.write_numbers("steps", {FRAME: 0.5})
    store.write_numbers("exposure", {FRAME: 1.25, "smoke_0002": 1e-9})
    yield (folder / "numbers.json").read_bytes()


def log_files(folder: Path) -> Iterator[bytes]:
    """The log of a run's working state, a line for each iteration."""
    store = FolderStore(folder)
    for n in range(5):
        store.log({"frame": "0", "octave": 0, "iteration": n, "loss": 1.5 - n, "terms": [0.1, n]})
    yield (folder / "metrics.jsonl").read_bytes()


def atlas_files(folder: Path) -> Iterator[bytes]:
    """Pictures of an atlas, with a channel's means as text."""
    for words in ({"before": "0.5", "after": "1.25"}, {"before": "nan", "after": "1e400"}, {"after": "1"}):
        text, stream = PngImagePlugin.PngInfo(), io.BytesIO()
        for name, value in words.items():
            text.add_text(name, value, zip=name == "after")
        Image.fromarray((corpus.DENSITY[0] * 255).astype(np.uint8)).save(stream, "PNG", pnginfo=text)
        yield stream.getvalue()


def configuration_files(folder: Path) -> Iterator[bytes]:
    """Configurations of Blender's fluids: an adaptive domain of 7×9×6 cells in one of 20×30×10."""
    fields = (b"\x0b\0\0\0", (7, 9, 6), struct.pack("<f", 1 / 30), bytes(40), (1, -2, 0), bytes(76))
    fields += ((20, 30, 10), (3, 4, 1), (10, 13, 7))
    data = b"".join(part if isinstance(part, bytes) else struct.pack("<3i", *part) for part in fields)
    for level in (1, 9):
        yield gzip.compress(data + bytes(20), level, mtime=0)


def adaptive_vdb(folder: Path) -> bytes:
    """A file of an adaptive domain of Blender's, whose place its configuration tells."""
    metadata = {BLENDER: ("vec3i", (7, 9, 6))}
    write_vdb(folder / "a.vdb", [DenseGrid("density", corpus.DENSITY, voxel_size=0.1, metadata=metadata)], {})
    return (folder / "a.vdb").read_bytes()


def flag_files(folder: Path) -> Iterator[bytes]:
    """Recipe flags, a line for each; tables of keyframes among them."""
    yield b"lam={49: 0.1, 72: 1.0}\neta={0 = 0.5, 30 = 1e-3}\nwindow=5"
    yield b"azimuth={1: [-10, 10], 9: [0, 5]}\nseed=3\nframes=1:20"
    yield b"density_scale=auto\ngamma={-5: 0.5, 7: 0.25}\nup=z\nlight=key"
    yield b"gamma={" + b".".join([b"a"] * 20_000) + b" = 1}"
