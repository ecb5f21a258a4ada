"""Choosing where the computation runs: Mitsuba variant, threads, torch device.

Everything that depends on the machine is decided here, so that no other module asks which backend is active.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from tnst_mi.errors import InputError
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.loaded_llvm import check_llvm
from tnst_mi.machine.turns import turn

if TYPE_CHECKING:
    import torch
else:
    torch = LazyModule("torch")

#: Variants that the package supports, in order of preference.
VARIANTS = ("cuda_ad_rgb", "llvm_ad_rgb")


def activate(variant: str | None = None) -> str:
    """Select the Mitsuba variant and prepare Dr.Jit for it; calling it again changes nothing.

    Args:
        variant: `cuda_ad_rgb` or `llvm_ad_rgb`. None keeps a variant that is already active and supported,
            else picks `cuda_ad_rgb` if both Dr.Jit and torch can use a GPU, and `llvm_ad_rgb` otherwise.

    The variant is that of the whole process, of all its threads.

    Returns:
        The name of the active variant.

    Raises:
        InputError: the variant is unknown, no usable GPU or LLVM library is found, or Dr.Jit was used before this
            process was forked.
    """
    with turn():
        return _activated(variant)


@contextmanager
def own_variant() -> Iterator[None]:
    """Within the block, a variant of ours is active; the one that another package has chosen is put back afterwards.

    It is this thread's turn.

    Raises:
        InputError: as for `activate`.
    """
    with turn():
        before = mi.variant()
        if before not in VARIANTS:
            _activated(None)
        try:
            yield
        finally:
            if before is not None and mi.variant() != before:
                mi.set_variant(before)


def _activated(variant: str | None) -> str:
    """See `activate`."""
    active = mi.variant()
    if variant is None:
        variant = active if active in VARIANTS else _preferred_variant()
    if variant not in VARIANTS:
        raise InputError(f"variant {variant!r} is not supported, expected one of {', '.join(VARIANTS)}")
    if variant.startswith("llvm"):
        check_llvm()
    if variant != active:
        if variant.startswith("cuda") and not dr.has_backend(dr.JitBackend.CUDA):
            raise InputError(
                f"variant {variant} needs an NVIDIA GPU (compute capability 7.5 or newer, driver R535 or newer) "
                "and none answers: use llvm_ad_rgb"
            )
        mi.set_variant(variant)
    _share_threads()
    return variant


def _preferred_variant() -> str:
    """The GPU variant if both Dr.Jit and torch can use a GPU, else the CPU variant."""
    if not dr.has_backend(dr.JitBackend.CUDA):
        return VARIANTS[1]
    if torch.cuda.is_available():
        return VARIANTS[0]
    _announce_idle_gpu()
    return VARIANTS[1]


@functools.cache
def _announce_idle_gpu() -> None:
    """Report on stderr, once per process, that torch cannot use the GPU that Dr.Jit finds."""
    print(
        f"warning: there is a GPU, but torch {torch.__version__} cannot use it: the CPU computes. Install a CUDA build "
        "of torch (https://pytorch.org/get-started/locally), or choose the variant llvm_ad_rgb",
        file=sys.stderr,
    )


def _share_threads() -> None:
    """Give Dr.Jit and torch one thread per core this process may use; neither respects the CPU affinity on its own."""
    if not hasattr(os, "sched_getaffinity"):
        return
    threads = len(os.sched_getaffinity(0))
    kernel_threads(threads)
    if "torch" in sys.modules:
        torch.set_num_threads(threads)
    else:
        os.environ.setdefault("OMP_NUM_THREADS", str(threads))


def kernel_threads(count: int) -> None:
    """Give Dr.Jit so many CPU threads, on which its results do not depend; two at least.

    Where there is one, Dr.Jit computes in the thread that calls it, which does not flush denormal numbers to 0 as its
    own threads do: last bits would differ.
    """
    if dr.thread_count() != max(2, count):
        dr.set_thread_count(max(2, count))


def network_threads(count: int | None = None) -> int:
    """The number of CPU threads of torch, once it is set to a count; it is set anew whenever a variant is activated.

    Dr.Jit's results do not depend on its threads; the last bits of torch's convolutions do.
    """
    if count is not None:
        torch.set_num_threads(count)
    return torch.get_num_threads()


def on_gpu() -> bool:
    """Whether the active variant computes on a GPU."""
    return (mi.variant() or "").startswith("cuda")


def release_memory() -> None:
    """Give back the device memory that Dr.Jit and torch hold for reuse, when other sizes are needed from now on."""
    dr.flush_malloc_cache()
    if on_gpu():
        torch.cuda.empty_cache()


def torch_device() -> torch.device:
    """The torch device that shares memory with the active variant, set up for repeatable float32 results.

    Raises:
        InputError: the variant runs on a GPU and torch cannot use one.
    """
    if not on_gpu():
        return torch.device("cpu")
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
