"""What the machine tells of itself: GPUs, memory, versions."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import drjit as dr
import numpy as np
import pytest
import torch

import tnst_mi
from tnst_mi.machine import environment


def test_the_driver_is_asked_and_understood(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    answer = "echo 'NVIDIA H100 80GB HBM3, 550.54.15, 9.0, 81559 MiB, 81000 MiB'"
    (tmp_path / "nvidia-smi").write_text(f"#!/bin/sh\n{answer}\n")
    (tmp_path / "nvidia-smi").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    (gpu,) = environment.gpus()
    assert (gpu["name"], gpu["driver"], gpu["compute_capability"]) == (
        "NVIDIA H100 80GB HBM3",
        "550.54.15",
        "9.0",
    )
    (tmp_path / "nvidia-smi").unlink()
    assert environment.gpus() == []


def test_memory_is_told_in_bytes() -> None:
    free, resident, peak = environment.free_memory(), environment.resident_memory(), environment.peak_memory()
    assert 1 << 20 < free < 1 << 50
    held = bytearray(200 << 20)
    held[:: 1 << 12] = b"1" * len(held[:: 1 << 12])
    assert environment.resident_memory() >= max(resident, 200 << 20)
    assert peak is None or environment.peak_memory() >= max(peak, 200 << 20)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere it is what getrusage tells")
def test_the_peak_is_that_of_the_process_and_not_of_the_one_that_started_it() -> None:
    held = np.ones(100 << 20, np.uint8)
    program = "from tnst_mi.machine import environment as e; print(e.resident_memory(), e.peak_memory())"
    now, peak = map(int, subprocess.check_output([sys.executable, "-c", program], text=True).split())
    assert now <= peak < now + held.nbytes // 2


def test_versions_of_what_is_installed_and_what_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkout that is merely on the path is not installed, and runs all the same."""

    def version(package: str) -> str:
        if package == "tnst_mi":
            raise importlib.metadata.PackageNotFoundError
        return "1.2.3"

    found = environment.versions()
    assert set(found) == {"tnst_mi", "python", "mitsuba", "drjit", "torch", "numpy"}
    assert found["numpy"] == np.__version__ and found["drjit"] == dr.__version__
    monkeypatch.setattr(importlib.metadata, "version", version)
    assert environment.versions()["tnst_mi"] == tnst_mi.__version__
    assert f'version = "{tnst_mi.__version__}"' in (Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8")
    assert environment.versions()["torch"] == "1.2.3"


def test_the_device_is_said_with_what_chose_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "NVIDIA H100")
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert environment.device_line("llvm_ad_rgb") == f"CPU, {dr.thread_count()} threads (llvm_ad_rgb)"
    assert environment.device_line("cuda_ad_rgb") == "NVIDIA H100 (cuda_ad_rgb)"
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3")
    assert environment.device_line("cuda_ad_rgb") == "NVIDIA H100 (cuda_ad_rgb, CUDA_VISIBLE_DEVICES=3)"
    assert environment.device_line("llvm_ad_rgb").endswith(" threads (llvm_ad_rgb, CUDA_VISIBLE_DEVICES=3)")
    record = environment.device("cuda_ad_rgb")
    assert (record["gpu"], record["CUDA_VISIBLE_DEVICES"]) == ("NVIDIA H100", "3")


@pytest.mark.parametrize("version", [1, 2])
def test_limits_of_containers_and_jobs_count(version: int, tmp_path: Path) -> None:
    """A job of 8 GB in a container of 20 GB: 3 GB are used, 1 GB of these by pages of files."""
    names = {
        1: ("5:cpu,memory", "memory/", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
        2: ("0:", "", "memory.max", "memory.current", "inactive_file"),
    }
    controllers, folder, limit, usage, files = names[version]
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text(f"{controllers}:/container/job\n9:pids:/other\n")
    for group, most, used in (("container", 20, 6), ("container/job", 8, 3)):
        path = tmp_path / "sys/fs/cgroup" / folder / group
        path.mkdir(parents=True)
        (path / limit).write_text(f"{most}000000000\n")
        (path / usage).write_text(f"{used}000000000\n")
        (path / "memory.stat").write_text(f"anon 5\n{files} 1000000000\n")
    assert environment._left_by_limits(tmp_path) == [6 * 10**9, 15 * 10**9]
    if version == 2:
        (tmp_path / "sys/fs/cgroup/container/job/memory.max").write_text("max\n")
        assert environment._left_by_limits(tmp_path) == [15 * 10**9]
    (tmp_path / "proc/self/cgroup").unlink()
    assert environment._left_by_limits(tmp_path) == []
