"""Choosing where the computation runs: Mitsuba variant, LLVM library, threads, torch device.

Everything that depends on the machine is decided here, so that no other module asks which backend is active.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import os
import platform
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tnst_mi.errors import InputError

if TYPE_CHECKING:
    import torch

#: Variants that the package supports, in the order of preference.
VARIANTS = ("cuda_ad_rgb", "llvm_ad_rgb")

#: LLVM 14 and 15 abort the process on float minimum/maximum instructions that Dr.Jit emits.
OLDEST_LLVM = 16

_SYSTEM_LIBRARY_FOLDERS = (
    f"/usr/lib/{platform.machine()}-linux-gnu",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib*",
    "/usr/lib/llvm-*/lib",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm/lib",
    "/usr/local/opt/llvm/lib",
)
_USER_CHOICE = "named by DRJIT_LIBLLVM_PATH"

_LLVM_NAME = re.compile(r"libLLVM(?:-(\d+)[\d.]*)?\.(?:so|dylib)(?:\.(\d+)[\d.]*)?$")


@dataclass(frozen=True)
class LlvmLibrary:
    """The LLVM library that Dr.Jit compiles with: its path, major version (0: unknown) and why it was chosen."""

    path: Path
    version: int
    reason: str


def _version_of(path: Path) -> int:
    """Major LLVM version in a library's file name (`libLLVM-17.so.1`, `libLLVM.so.19.1`), or 0."""
    match = _LLVM_NAME.match(path.name)
    return int(match[1] or match[2] or 0) if match else 0


def _system_llvm() -> Path | None:
    """The newest usable LLVM library of the operating system."""
    found = [
        path
        for folder in _SYSTEM_LIBRARY_FOLDERS
        for path in Path("/").glob(f"{folder[1:]}/libLLVM*")
        # A development package may leave a link to a library that is not installed.
        if _version_of(path) >= OLDEST_LLVM and path.exists()
    ]
    return max(found, key=lambda path: (_version_of(path), str(path)), default=None)


def _wheel_llvm() -> Path | None:
    """The LLVM library inside the karellen-llvm-core package, where that is installed."""
    try:
        files = importlib.metadata.files("karellen-llvm-core") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in files:
        path = Path(str(file.locate())).resolve()
        if _version_of(path) >= OLDEST_LLVM and path.exists():
            return path
    return None


def llvm_library() -> LlvmLibrary | None:
    """Find the LLVM library for Dr.Jit: the user's choice, the system's newest, then the one installed by pip.

    Returns None where no usable library (version 16 or newer) is found.
    """
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    if chosen and chosen != os.environ.get("_TNST_MI_LIBLLVM_PATH"):
        return LlvmLibrary(Path(chosen), _version_of(Path(chosen).resolve()), _USER_CHOICE)
    if (path := _system_llvm()) is not None:
        return LlvmLibrary(path, _version_of(path), f"newest LLVM of the system that is {OLDEST_LLVM} or newer")
    if (path := _wheel_llvm()) is not None:
        return LlvmLibrary(
            path,
            _version_of(path),
            f"package karellen-llvm-core (the system has no LLVM {OLDEST_LLVM} or newer)",
        )
    return None


def select_llvm() -> None:
    """Have Dr.Jit use the chosen LLVM library.

    Dr.Jit loads LLVM while it is imported. Where it was imported first and took a library that it cannot work with,
    its backends are shut down and started again; no variant may be active by then.
    """
    library = llvm_library()
    if library is None:
        return
    if os.environ.get("DRJIT_LIBLLVM_PATH") != str(library.path):
        # The second variable remembers that this choice was ours, not the user's.
        os.environ["_TNST_MI_LIBLLVM_PATH"] = str(library.path)
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library.path)
    if "drjit" in sys.modules and _loaded_llvm() < OLDEST_LLVM and not _variant_is_active():
        _restart_drjit()


def _loaded_llvm() -> int:
    """Major version of the LLVM library that Dr.Jit has loaded, 0 for none."""
    import drjit as dr

    return dr.detail.llvm_version()[0] if dr.has_backend(dr.JitBackend.LLVM) else 0


def _variant_is_active() -> bool:
    return "mitsuba" in sys.modules and sys.modules["mitsuba"].variant() is not None


def _restart_drjit() -> None:
    """Shut down Dr.Jit's backends and start them again (`jit_shutdown`, `jit_init_async` of its C interface)."""
    import drjit as dr

    core = Path(dr.__file__).with_name("libdrjit-core.so")
    try:
        library = ctypes.CDLL(str(core))
        shut_down, start = library["_Z12jit_shutdowni"], library["_Z14jit_init_asyncj"]
    except (OSError, AttributeError):
        return  # check_llvm() tells the user what to do.
    shut_down(ctypes.c_int(0))
    backends = sum(1 << backend.value for backend in (dr.JitBackend.CUDA, dr.JitBackend.LLVM))
    start(ctypes.c_uint32(backends))


def check_llvm() -> None:
    """Raise InputError unless Dr.Jit has loaded an LLVM library that it can work with."""
    loaded = _loaded_llvm()
    if loaded >= OLDEST_LLVM:
        return
    usable = llvm_library()
    if usable is None:
        raise InputError(
            f"no LLVM library {OLDEST_LLVM} or newer was found, and the llvm_ad_rgb variant needs one: "
            "pip install karellen-llvm-core (Linux x86-64), or install libllvm19 and set DRJIT_LIBLLVM_PATH"
        )
    found = f"has loaded LLVM {loaded}" if loaded else "found no LLVM"
    if usable.reason == _USER_CHOICE:
        raise InputError(
            f"Dr.Jit {found}, expected {OLDEST_LLVM} or newer (older ones abort the process): DRJIT_LIBLLVM_PATH names "
            f"{usable.path}; unset it, or name a library that is {OLDEST_LLVM} or newer"
        )
    raise InputError(
        f"Dr.Jit {found}, expected {OLDEST_LLVM} or newer (older ones abort the process): "
        f"import tnst_mi before a variant is set, or set DRJIT_LIBLLVM_PATH={usable.path}"
    )


def activate(variant: str | None = None) -> str:
    """Select the Mitsuba variant and prepare Dr.Jit for it; calling it again changes nothing.

    Args:
        variant: `cuda_ad_rgb` or `llvm_ad_rgb`. None keeps a variant that is already active and supported,
            else picks `cuda_ad_rgb` if a GPU answers to Dr.Jit and to torch, and `llvm_ad_rgb` if not.

    Returns:
        The name of the active variant.

    Raises:
        InputError: the variant is unknown, no GPU answers, or no usable LLVM library is found.
    """
    select_llvm()
    import drjit as dr
    import mitsuba as mi

    if variant is not None and variant not in VARIANTS:
        raise InputError(f"variant {variant!r} is not supported, expected one of {', '.join(VARIANTS)}")
    if variant is None:
        if mi.variant() in VARIANTS:
            variant = mi.variant()
        else:
            variant = VARIANTS[0] if dr.has_backend(dr.JitBackend.CUDA) and _torch_has_cuda() else VARIANTS[1]
    if variant.startswith("llvm"):
        check_llvm()
    if variant != mi.variant():
        if variant.startswith("cuda") and not dr.has_backend(dr.JitBackend.CUDA):
            raise InputError(
                f"variant {variant} needs an NVIDIA GPU (compute capability 7.5 or newer, driver R535 or newer) "
                "and none answers: use llvm_ad_rgb"
            )
        mi.set_variant(variant)
    _share_threads(dr)
    return variant


def _torch_has_cuda() -> bool:
    import torch

    return torch.cuda.is_available()


def let_idle_threads_sleep() -> None:
    """Have torch's OpenMP threads sleep while they wait; must come before torch is imported.

    By default they spin, taking cores from Dr.Jit's threads, with which they alternate, and from other programs: on
    two shared cores the network took five times as long.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")


def _share_threads(dr: object) -> None:
    """Give Dr.Jit and torch the cores that this process may use; neither looks at the CPU affinity itself."""
    if not hasattr(os, "sched_getaffinity"):
        return
    threads = len(os.sched_getaffinity(0))
    if dr.thread_count() != threads:
        dr.set_thread_count(threads)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(threads)
    else:
        os.environ.setdefault("OMP_NUM_THREADS", str(threads))


def torch_device() -> torch.device:
    """The torch device that shares memory with the active variant, set up for repeatable float32 results.

    Raises:
        InputError: the variant is a GPU one and torch cannot use a GPU.
    """
    import mitsuba as mi
    import torch

    if mi.variant().startswith("cuda"):
        if not torch.cuda.is_available():
            raise InputError(
                f"variant {mi.variant()}: torch {torch.__version__} finds no GPU; install a CUDA build of torch, "
                "or use llvm_ad_rgb"
            )
        torch.backends.cudnn.deterministic = True
        torch.backends.cudnn.benchmark = False
        torch.backends.cudnn.allow_tf32 = False
        torch.backends.cuda.matmul.allow_tf32 = False
        return torch.device("cuda")
    return torch.device("cpu")
