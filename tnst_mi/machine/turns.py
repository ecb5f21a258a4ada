"""One thread at a time computes with Dr.Jit: others wait for their turn.

The variant is the whole process's, the cached media hold the density of whoever rendered last, and of two threads that
wait for Dr.Jit on a CPU, one may be told too early that its result is there. Turns cost little: Dr.Jit and torch spread
each of their operations over all cores.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr

from tnst_mi.machine.forks import require_own_process

_BACKENDS = (dr.JitBackend.CUDA, dr.JitBackend.LLVM)


class _Turn:
    """Whose turn it is, or was last. A thread may take a turn within its own."""

    lock = threading.RLock()
    thread = threading.main_thread()


@contextmanager
def turn() -> Iterator[None]:
    """Within the block, no other thread takes a turn; this one waits until it is free.

    Raises:
        InputError: Dr.Jit was used before this process was forked.
    """
    require_own_process()
    with _Turn.lock:
        if _Turn.thread is not threading.current_thread():
            _Turn.thread = threading.current_thread()
            # Dr.Jit orders what threads launch, but what they trace only if they begin a scope of their own.
            for backend in _BACKENDS:
                if dr.has_backend(backend):
                    dr.detail.new_scope(backend)
        yield
