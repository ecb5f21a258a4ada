"""Reading files that may be missing or damaged, or that claim more than they hold."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedIOBase
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError

#: Longest edge of a grid that is believed, in cells.
LARGEST_EXTENT = 1 << 14

#: No array may be larger, in bytes.
LARGEST_ARRAY = 1 << 34

#: Deflate shrinks data by at most this factor: what claims more lies about its size.
LARGEST_RATIO = 1032

_CHUNK = 1 << 24


@contextmanager
def opening(path: Path, kind: str, damage: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Turn what goes wrong while a file is opened and read into one line that names it.

    Args:
        path: the file.
        kind: what was expected, with its article.
        damage: exceptions by which readers tell that it is something else, truncated or damaged.

    Raises:
        InputError: the path is a folder, the file is missing, must not be read, or is damaged.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected {kind}")
    try:
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
    """Read numbers, which come into memory only as data really come out of the stream.

    Returns:
        The numbers (count), and how many bytes of them there were: less than all where the stream ends before.
    """
    numbers = np.empty(count, dtype)
    buffer = numbers.view(np.uint8).data
    filled = 0
    while filled < len(buffer) and (read := stream.readinto(buffer[filled : filled + _CHUNK])):
        filled += read
    return numbers, filled
