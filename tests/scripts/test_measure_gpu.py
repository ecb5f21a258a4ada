"""What is measured on a GPU, tried on a CPU: a run is cut into parts, each on disk, and equals agree."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "measure_gpu.py"


def measure(*arguments: object) -> subprocess.CompletedProcess:
    command = [sys.executable, str(SCRIPT), "--dry-run", "--weights", "patterns", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_cpu_agrees_with_itself_and_a_part_that_fails_is_told(tmp_path: Path) -> None:
    reference, out = tmp_path / "reference.npz", tmp_path / "out"
    assert measure("--record", reference).returncode == 0
    ran = measure("--out", out, "--reference", reference, "--parts", "environment,agreement")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    found = json.loads((out / "gpu.json").read_text("utf-8"))
    assert list(found) == ["environment", "agreement"]
    assert found["agreement"]["agrees"] and set(found["agreement"]["by_stage"].values()) == {0.0}
    assert all(found["agreement"]["same_bits_twice"].values())

    # Weights in another precision give derivatives that differ by several per cent.
    with np.load(reference) as arrays:
        np.savez(tmp_path / "other.npz", **{name: arrays[name] for name in arrays} | {"weights": np.array("0" * 64)})
    ran = measure("--out", out, "--reference", tmp_path / "other.npz", "--parts", "agreement")
    assert ran.returncode == 1
    (part,) = json.loads((out / "gpu.json").read_text("utf-8")).values()
    assert part["failed"] == 1 and "recorded with other weights" in part["log"]


def test_what_is_missing_is_said_before_anything_is_measured(tmp_path: Path) -> None:
    ran = measure("--out", tmp_path / "out", "--parts", "environment,agreement")
    assert ran.returncode == 2 and "--reference FILE: record one on a CPU with --record" in ran.stderr
    assert not (tmp_path / "out").exists()
