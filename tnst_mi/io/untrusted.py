"""Arrays in files that may claim more data than they hold: memory is taken for what can be there, and is there.

Pictures, networks and trees of voxels have bounds of their own.
"""

from __future__ import annotations

from io import BufferedIOBase

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.machine.environment import free_memory
from tnst_mi.machine.terminal import amount

#: Longest plausible edge of a grid, in cells.
LARGEST_EXTENT = 1 << 14

#: Largest array that is read, in bytes.
LARGEST_ARRAY = 1 << 34

#: Deflate compresses by at most this factor: a claim beyond it is false.
LARGEST_RATIO = 1032

#: Memory that it takes to make a frame of an array, relative to the array.
_COPIES = 3

_CHUNK = 1 << 24


def require_plausible(what: str, size: int, most: int) -> None:
    """Check the claimed size of an array before memory is taken for it.

    Args:
        what: the file, and the array in it, for messages.
        size: bytes that it claims.
        most: bytes that it can hold.

    Raises:
        InputError: it claims more than that, than any array is read of, or than there is memory.
    """
    if size > LARGEST_ARRAY:
        raise InputError(f"{what} has {size} bytes, expected at most {LARGEST_ARRAY}")
    if size > most:
        raise InputError(f"{what} claims {size} bytes, more than it holds")
    if _COPIES * size > (free := free_memory()):
        raise InputError(f"{what} takes {amount(_COPIES * size)}, and {amount(free)} of memory are free")


def read_numbers(stream: BufferedIOBase, count: int, dtype: np.dtype) -> tuple[np.ndarray, int]:
    """Read numbers, touching memory only as data actually arrive from the stream.

    Returns:
        The numbers (count), and how many bytes of them were read: fewer than all if the stream ends early.
    """
    numbers = np.empty(count, dtype)
    buffer = numbers.view(np.uint8).data
    filled = 0
    while filled < len(buffer) and (read := stream.readinto(buffer[filled : filled + _CHUNK])):
        filled += read
    return numbers, filled
