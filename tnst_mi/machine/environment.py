"""What a run depends on besides its input: versions, device, memory."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import drjit as dr
import psutil

from tnst_mi.machine import address_space
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.llvm import llvm_library
from tnst_mi.resources import VERSION

if TYPE_CHECKING:
    import torch
else:
    torch = LazyModule("torch")

if sys.platform != "win32":
    import resource

#: The environment variable that tells CUDA, and so both Dr.Jit and torch, which GPUs there are.
VISIBLE = "CUDA_VISIBLE_DEVICES"

_PACKAGES = ("mitsuba", "drjit", "torch", "numpy")


def versions() -> dict[str, str]:
    """Versions of Python, this package, and the packages that determine the results."""
    found = {"tnst_mi": VERSION, "python": platform.python_version()}
    return found | {name: _version(name) for name in _PACKAGES}


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def gpus() -> list[dict[str, str]]:
    """The NVIDIA GPUs that the driver reports; empty without a driver."""
    keys = {
        "name": "name",
        "driver": "driver_version",
        "compute_capability": "compute_cap",
        "memory": "memory.total",
        "free_memory": "memory.free",
    }
    command = ["nvidia-smi", f"--query-gpu={','.join(keys.values())}", "--format=csv,noheader"]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return []
    rows = [[cell.strip() for cell in line.split(",")] for line in answer.splitlines() if line]
    return [dict(zip(keys, row, strict=True)) for row in rows if len(row) == len(keys)]


def device(variant: str) -> dict[str, object]:
    """The device that a variant computes on, for the run's record."""
    if variant.startswith("cuda"):
        used, visible = torch.cuda.get_device_name(), os.environ.get(VISIBLE)
        # Records of the same run are equal; what is free is not.
        cards = [{name: value for name, value in card.items() if name != "free_memory"} for card in gpus()]
        return {"variant": variant, "gpu": used, VISIBLE: visible, "gpus": cards}
    llvm = llvm_library()
    return {
        "variant": variant,
        VISIBLE: os.environ.get(VISIBLE),
        "processor": platform.processor() or platform.machine(),
        "threads": dr.thread_count(),
        "llvm": None if llvm is None else {"path": str(llvm.path), "version": llvm.version},
    }


def device_line(variant: str) -> str:
    """The same in one line, for people; the variable may be why a GPU is used or none is."""
    name = torch.cuda.get_device_name() if variant.startswith("cuda") else f"CPU, {dr.thread_count()} threads"
    visible = os.environ.get(VISIBLE)
    chosen = "" if visible is None else f", {VISIBLE}={visible}"
    return f"{name} ({variant}{chosen})"


def peak_memory() -> int | None:
    """The peak resident memory of this process so far, in bytes; None on Windows."""
    if sys.platform == "win32":
        return None
    try:
        # What getrusage tells on Linux counts the process that this one was forked from, too.
        status = Path("/proc/self/status").read_text("utf-8")
        return int(status.partition("VmHWM:")[2].split()[0]) * 1024
    except (OSError, IndexError, ValueError):
        # Linux counts in KiB, macOS in bytes.
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def resident_memory() -> int:
    """The resident memory of this process, in bytes."""
    return psutil.Process().memory_info().rss


def free_memory() -> int:
    """The memory that this process can still use without swapping, in bytes; it or its container may have a limit."""
    left = [psutil.virtual_memory().available, *_left_by_limits(Path("/"))]
    if (most := address_space.limit()) is not None:
        left.append(max(0, most - psutil.Process().memory_info().vms))
    return min(left)


def _left_by_limits(root: Path) -> list[int]:
    """What the limits of the control groups that the process is in leave (Linux); pages of files can be given up."""
    left = []
    try:
        entries = [line.split(":", 2) for line in (root / "proc/self/cgroup").read_text("utf-8").splitlines()]
    except OSError:
        return []
    for _, controllers, group in entries:
        if controllers == "":
            base, limit, usage, files = root / "sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"
        elif "memory" in controllers.split(","):
            base, limit, usage = root / "sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
            files = "total_inactive_file"
        else:
            continue
        inner = base / group.lstrip("/")
        # A container sees its own group as the root, whatever the name says.
        for folder in (inner, *inner.parents):
            if not folder.is_relative_to(base):
                break
            try:
                most, used = ((folder / name).read_text("utf-8").strip() for name in (limit, usage))
                statistics = dict(line.split() for line in (folder / "memory.stat").read_text("utf-8").splitlines())
            except (OSError, ValueError):
                continue
            if most != "max":
                left.append(max(0, int(most) - int(used) + int(statistics.get(files, 0))))
    return left
