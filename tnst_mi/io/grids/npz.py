"""npz files, read without pickle and without trusting the sizes they claim, and written atomically."""

from __future__ import annotations

import math
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.untrusted import LARGEST_ARRAY, LARGEST_RATIO, opening, read_numbers

_LARGEST_HEADER = 10_000
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    tokenize.TokenError,
    SyntaxError,
    EOFError,
    OSError,
    RuntimeError,
    ValueError,
)


@dataclass(frozen=True)
class ArrayHeader:
    """Shape and type of an array, as its header declares them."""

    shape: tuple[int, ...]
    dtype: np.dtype
    fortran_order: bool


def read_headers(path: Path) -> dict[str, ArrayHeader]:
    """Read the shape and type of every array in an npz file.

    Raises:
        InputError: the file is missing or damaged, or an array is pickled or claims an impossible size.
    """
    with _opened(path) as archive:
        return {name: _read_header(path, archive, name) for name in _names(archive)}


def read_arrays(path: Path, keys: Sequence[str]) -> dict[str, np.ndarray]:
    """Read the arrays named in `keys`, as far as an npz file contains them.

    Raises:
        InputError: as `read_headers`; or the data are truncated, damaged, not numeric, or too large.
    """
    with _opened(path) as archive:
        return {key: _read_array(path, archive, key) for key in keys if key in _names(archive)}


def write_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write a compressed npz file."""
    with written_whole(path) as temporary, temporary.open("wb") as file:
        # The type stub also matches the arrays against the flag allow_pickle.
        np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    with opening(path, "an npz file", _DAMAGE), zipfile.ZipFile(path) as archive:
        yield archive


def _names(archive: zipfile.ZipFile) -> list[str]:
    return [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]


def _member(archive: zipfile.ZipFile, name: str) -> zipfile.ZipExtFile:
    """Open an array's archive member for reading; `ZipFile.open` is annotated as returning plain `IO`."""
    return cast("zipfile.ZipExtFile", archive.open(f"{name}.npy"))


def _parse_header(path: Path, name: str, stream: zipfile.ZipExtFile) -> ArrayHeader:
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(np.lib.format.read_magic(stream))
    if read is None:
        raise InputError(f"{path}: array {name!r} has an unknown npy version, expected 1.0 or 2.0")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # headers written by Python 2 are fine
        shape, fortran_order, dtype = read(stream, max_header_size=_LARGEST_HEADER)
    if dtype.hasobject:
        raise InputError(f"{path}: array {name!r} holds pickled objects, expected numbers (they are never unpickled)")
    if any(extent < 0 for extent in shape):
        raise InputError(f"{path}: array {name!r} claims the shape {shape}")
    return ArrayHeader(shape, dtype, fortran_order)


def _read_header(path: Path, archive: zipfile.ZipFile, name: str) -> ArrayHeader:
    with _member(archive, name) as stream:
        return _parse_header(path, name, stream)


def _read_array(path: Path, archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Read one array, rejecting a claimed size that its archive member cannot hold."""
    member = archive.getinfo(f"{name}.npy")
    with _member(archive, name) as stream:
        header = _parse_header(path, name, stream)
        if header.dtype.kind not in "fiub":
            raise InputError(f"{path}: array {name!r} has type {header.dtype}, expected numbers")
        size = math.prod(header.shape) * header.dtype.itemsize
        if size > LARGEST_ARRAY:
            raise InputError(f"{path}: array {name!r} has {size} bytes, expected at most {LARGEST_ARRAY}")
        if size > LARGEST_RATIO * member.compress_size or size > member.file_size:
            raise InputError(f"{path}: array {name!r} claims {size} bytes for shape {header.shape}, more than it holds")
        array, filled = read_numbers(stream, math.prod(header.shape), header.dtype)
        if filled < size:
            raise InputError(f"{path}: array {name!r} is truncated: {filled} of {size} bytes")
        if stream.read(1):
            raise InputError(f"{path}: array {name!r} has more data than its shape {header.shape} needs")
    return array.reshape(header.shape[::-1]).T if header.fortran_order else array.reshape(header.shape)
