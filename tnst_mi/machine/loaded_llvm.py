"""The LLVM library that Dr.Jit has loaded: check it, and replace it if it is unusable."""

from __future__ import annotations

import ctypes
from pathlib import Path

import drjit as dr
import mitsuba as mi

from tnst_mi.errors import InputError
from tnst_mi.machine.llvm import OLDEST_LLVM, USER_CHOICE, llvm_library


def loaded_version() -> int:
    """Major version of the LLVM library that Dr.Jit has loaded, 0 for none."""
    return dr.detail.llvm_version()[0] if dr.has_backend(dr.JitBackend.LLVM) else 0


def replace_unusable_llvm() -> None:
    """Make Dr.Jit load the chosen LLVM library if it was imported before the choice and loaded an unusable one.

    Its backends are shut down and restarted, which an active variant would not survive.
    """
    if llvm_library() is not None and loaded_version() < OLDEST_LLVM and mi.variant() is None:
        _restart_drjit()


def _restart_drjit() -> None:
    """Shut down Dr.Jit's backends and restart them (`jit_shutdown`, `jit_init_async` of its C interface)."""
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
    loaded = loaded_version()
    if loaded >= OLDEST_LLVM:
        return
    usable = llvm_library()
    if usable is None:
        raise InputError(
            f"no LLVM library {OLDEST_LLVM} or newer was found, and the llvm_ad_rgb variant needs one: "
            "pip install karellen-llvm-core (Linux x86-64), or install libllvm19 and set DRJIT_LIBLLVM_PATH"
        )
    found = f"has loaded LLVM {loaded}" if loaded else "found no LLVM"
    if usable.reason == USER_CHOICE:
        raise InputError(
            f"Dr.Jit {found}, expected {OLDEST_LLVM} or newer (older ones abort the process): DRJIT_LIBLLVM_PATH names "
            f"{usable.path}; unset it, or name a library that is {OLDEST_LLVM} or newer"
        )
    raise InputError(
        f"Dr.Jit {found}, expected {OLDEST_LLVM} or newer (older ones abort the process): "
        f"import tnst_mi before a variant is set, or set DRJIT_LIBLLVM_PATH={usable.path}"
    )
