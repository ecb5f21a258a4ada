"""What a process keeps of the memory that it has freed."""

from __future__ import annotations

import ctypes
import sys

#: Bytes from which on a block of memory is the system's again as soon as it is freed; the name of that in C's library.
LARGE, _MMAP_THRESHOLD = 512 << 10, -3


def give_back_large_blocks() -> bool:
    """From now on, give large blocks of memory back to the system when they are freed; whether that can be done.

    GNU's C library raises the size from which on it does so with each larger block that is freed, up to 32 MB. In a
    process that lives long, and frees grids and pictures in many threads, what is freed lies between what is not, in a
    heap of each thread: it is neither used again nor given back.
    """
    if sys.platform != "linux":
        return False
    try:
        return ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, LARGE) == 1
    except (OSError, AttributeError):  # other libraries have no such thing
        return False
