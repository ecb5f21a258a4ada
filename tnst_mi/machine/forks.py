"""What a fork takes from a process that computes: the child has none of the threads that would do the work.

Dr.Jit makes no promise for a child of a process that has used it, and CUDA rules it out: such a child is told so, in
place of waiting for ever. Torch is put in order before the fork, so that the child can start threads of its own. A
process that has imported the package, and not used it, may fork as it likes.
"""

from __future__ import annotations

import ctypes
import os
import sys

import mitsuba as mi

from tnst_mi.errors import InputError

#: `omp_pause_soft` of OpenMP 5.
_PAUSE = 1


class _DrJit:
    """Whether Dr.Jit has been used in this process, or in one that this was forked from."""

    used = False
    used_by_parent = False


def require_own_process() -> None:
    """Note that Dr.Jit is used from now on.

    Raises:
        InputError: it was used before this process was forked.
    """
    if _DrJit.used_by_parent:
        raise InputError(
            f"process {os.getpid()} was forked after Dr.Jit had been used, and cannot use it: fork earlier, or start "
            'workers anew, as multiprocessing.get_context("spawn") does'
        )
    _DrJit.used = True


def prepare_for_forks() -> None:
    """From now on, children know what their parent used, and torch works in them. Windows has no fork."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=_end_threads_of_torch, after_in_child=_note_parent)


def _note_parent() -> None:
    # Another package may have used Dr.Jit; scalar variants do without it.
    active = mi.variant() or "scalar"
    _DrJit.used_by_parent |= _DrJit.used or not active.startswith("scalar")


def _end_threads_of_torch() -> None:
    """End the idle threads of torch's OpenMP; it starts new ones when it needs them.

    GNU's OpenMP would believe in the child that they are still there, and the first large operation would never end.
    """
    torch = sys.modules.get("torch._C")
    if torch is not None and torch.__file__ is not None:
        # Found in the library that torch was linked with; earlier OpenMP, or none, has no such function.
        pause = getattr(ctypes.CDLL(torch.__file__), "omp_pause_resource_all", None)
        if pause is not None:
            pause(_PAUSE)
