"""Python's garbage collector waits while Dr.Jit traces what Mitsuba renders.

A loaded scene is part of reference cycles: one that nobody needs any more is freed when the collector runs, at any
allocation. If that is while the kernel of another scene is traced, calls of one method before and after it are of
different numbers of objects. Dr.Jit 1.5 then defines a function twice ("invalid redefinition of function") and ends the
whole process. Derivatives by `prbvolpath` are such kernels: they trace all methods for the image, and again for it.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collection_paused() -> Iterator[None]:
    """Within the block, nothing in a reference cycle is freed; explicit calls of `gc.collect` still do so.

    Example:
        >>> with collection_paused():
        ...     gc.isenabled()
        False
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
