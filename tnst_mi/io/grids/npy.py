"""npy arrays, by themselves or as members of an npz file: read without pickle and without trusting their sizes."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedIOBase
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.untrusted import read_numbers, require_plausible
from tnst_mi.machine.gate import opening

_LARGEST_HEADER = 10_000


@dataclass(frozen=True)
class ArrayHeader:
    """Shape and type of an array, as its header declares them."""

    shape: tuple[int, ...]
    dtype: np.dtype
    fortran_order: bool


def read_npy_header(path: Path) -> ArrayHeader:
    """Read the shape and type of the array in an npy file.

    Raises:
        InputError: the file is missing or damaged, or the array claims an impossible shape.
    """
    with _opened(path) as stream:
        return parsed_header(path, "array", stream)


def read_npy(path: Path) -> np.ndarray:
    """Read the array of an npy file.

    Raises:
        InputError: as `read_npy_header`; or the data are pickled, truncated, not numeric, or too large.
    """
    with _opened(path) as stream:
        header = parsed_header(path, "array", stream)
        return read_array(path, "array", header, stream, path.stat().st_size)


def parsed_header(path: Path, what: str, stream: BufferedIOBase) -> ArrayHeader:
    """Read the header at the start of an array.

    Args:
        path: the file, for messages.
        what: the array, for messages.
        stream: yields the array.

    Raises:
        InputError: the array is of an unknown version, or claims an impossible shape.
    """
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(np.lib.format.read_magic(stream))
    if read is None:
        raise InputError(f"{path}: {what} has an unknown npy version, expected 1.0 or 2.0")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # headers written by Python 2 are fine
        shape, fortran_order, dtype = read(stream, max_header_size=_LARGEST_HEADER)
    if any(extent < 0 for extent in shape):
        raise InputError(f"{path}: {what} claims the shape {shape}")
    return ArrayHeader(shape, dtype, fortran_order)


def read_array(path: Path, what: str, header: ArrayHeader, stream: BufferedIOBase, most: int) -> np.ndarray:
    """Read the data that follow a header.

    Args:
        path: the file, for messages.
        what: the array, for messages.
        header: of the array.
        stream: yields the data.
        most: bytes that the stream can hold.

    Raises:
        InputError: the data are pickled, not numeric, too large, or not as many as the header claims.
    """
    if header.dtype.hasobject:
        raise InputError(f"{path}: {what} holds pickled objects, expected numbers (they are never unpickled)")
    if header.dtype.kind not in "fiub":
        raise InputError(f"{path}: {what} has type {header.dtype}, expected numbers")
    size = math.prod(header.shape) * header.dtype.itemsize
    require_plausible(f"{path}: {what} of shape {header.shape}", size, most)
    array, filled = read_numbers(stream, math.prod(header.shape), header.dtype)
    if filled < size:
        raise InputError(f"{path}: {what} is truncated: {filled} of {size} bytes")
    if stream.read(1):
        raise InputError(f"{path}: {what} has more data than its shape {header.shape} needs")
    return array.reshape(header.shape[::-1]).T if header.fortran_order else array.reshape(header.shape)


@contextmanager
def _opened(path: Path) -> Iterator[BufferedIOBase]:
    with opening(path, "an npy file"), path.open("rb") as stream:
        yield stream
