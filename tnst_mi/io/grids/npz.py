"""npz files, read without pickle and without trusting the sizes they claim, and written atomically."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import cast

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.grids.npy import ArrayHeader, parsed_header, read_array
from tnst_mi.io.untrusted import LARGEST_RATIO
from tnst_mi.machine.gate import opening
from tnst_mi.machine.terminal import quoted

# What numpy writes; other methods unfold to any size.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def read_headers(path: Path) -> dict[str, ArrayHeader]:
    """Read the shape and type of every array in an npz file.

    Raises:
        InputError: the file is missing or damaged, or an array claims an impossible shape.
    """
    with _opened(path) as archive:
        return {name: _read_header(path, archive, name) for name in _names(archive)}


def read_arrays(path: Path, keys: Sequence[str]) -> dict[str, np.ndarray]:
    """Read the arrays named in `keys`, as far as an npz file contains them.

    Raises:
        InputError: as `read_headers`; or the data are pickled, truncated, damaged, not numeric, or too large.
    """
    with _opened(path) as archive:
        return {key: _read_array(path, archive, key) for key in keys if key in _names(archive)}


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray], others: Mapping[str, np.ndarray] | None = None) -> None:
    """Write a compressed npz file as numpy does, but one array after the other, each asked for when it is its turn.

    Args:
        path: the file.
        arrays: by name.
        others: more of them, of other names.
    """
    with written_whole(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for source in (arrays, others or {}):
            for name in source:
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asanyarray(source[name]), allow_pickle=False)


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    with opening(path, "an npz file"), zipfile.ZipFile(path) as archive:
        yield archive


def _names(archive: zipfile.ZipFile) -> list[str]:
    return [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]


def _member(path: Path, archive: zipfile.ZipFile, name: str) -> zipfile.ZipExtFile:
    """Open an array's archive member for reading; `ZipFile.open` is annotated as returning plain `IO`."""
    if archive.getinfo(f"{name}.npy").compress_type not in _METHODS:
        raise InputError(
            f"{path}: array {quoted(name)} is compressed in another way than numpy does; save it with numpy"
        )
    return cast("zipfile.ZipExtFile", archive.open(f"{name}.npy"))


def _read_header(path: Path, archive: zipfile.ZipFile, name: str) -> ArrayHeader:
    with _member(path, archive, name) as stream:
        return parsed_header(path, f"array {quoted(name)}", stream)


def _read_array(path: Path, archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Read one array, rejecting a claimed size that its archive member cannot hold."""
    member, what = archive.getinfo(f"{name}.npy"), f"array {quoted(name)}"
    with _member(path, archive, name) as stream:
        most = min(LARGEST_RATIO * member.compress_size, member.file_size)
        return read_array(path, what, parsed_header(path, what, stream), stream, most)
