"""Reading files that may be missing or damaged, or that claim more data than they hold."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedIOBase
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError

#: Longest plausible edge of a grid, in cells.
LARGEST_EXTENT = 1 << 14

#: Largest array that is read, in bytes.
LARGEST_ARRAY = 1 << 34

#: Deflate compresses by at most this factor: a claim beyond it is false.
LARGEST_RATIO = 1032

_CHUNK = 1 << 24


@contextmanager
def opening(path: Path, kind: str, damage: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Turn errors in opening and reading a file into one line that names the file.

    Args:
        path: the file.
        kind: what was expected, with its article, such as "an npz file".
        damage: exceptions by which readers report a file of another kind, truncated or damaged.

    Raises:
        InputError: the path is a folder, or the file is missing, empty, damaged, or lacks read permission.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected {kind}")
    try:
        if path.stat().st_size == 0:
            raise InputError(f"{path}: is empty (0 bytes), expected {kind}")
        yield
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except PermissionError:
        raise InputError(f"{path}: cannot be read (no permission)") from None
    except damage as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: not {kind}, truncated, or damaged ({reason})") from None


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
