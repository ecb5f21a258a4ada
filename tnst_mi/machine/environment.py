"""What a run depends on besides its input: versions, device, memory."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys

_PACKAGES = ("mitsuba", "drjit", "torch", "numpy")


def versions() -> dict[str, str]:
    """Versions of this package, Python and the packages that decide the numbers."""
    import tnst_mi

    found = {"tnst_mi": tnst_mi.__version__, "python": platform.python_version()}
    return found | {name: importlib.metadata.version(name) for name in _PACKAGES}


def gpus() -> list[dict[str, str]]:
    """The NVIDIA GPUs that the driver reports, empty without a driver."""
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
    import drjit as dr

    from tnst_mi.machine.backend import llvm_library

    if variant.startswith("cuda"):
        return {"variant": variant, "gpus": gpus()}
    llvm = llvm_library()
    return {
        "variant": variant,
        "processor": platform.processor() or platform.machine(),
        "threads": dr.thread_count(),
        "llvm": None if llvm is None else {"path": str(llvm.path), "version": llvm.version},
    }


def peak_memory() -> int | None:
    """The most memory that this process has held so far, in bytes; None where the system does not tell."""
    if sys.platform == "win32":
        return None
    import resource

    # Linux counts in KiB, macOS in bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def resident_memory() -> int | None:
    """The memory that this process holds now, in bytes; None where the system does not tell."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None


def free_memory() -> int | None:
    """The memory that is still to be had, in bytes; None where the system does not tell."""
    try:
        with open("/proc/meminfo") as file:
            fields = dict(line.split(":", 1) for line in file)
        return int(fields["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError):
        names = getattr(os, "sysconf_names", {})
        if "SC_AVPHYS_PAGES" not in names:
            return None
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
