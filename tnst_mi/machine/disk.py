"""Checks, made before any work is done, that results can be written to a folder."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import amount

#: What is put around the name of a frame in that of a file, at most: what it shows, the machine, process and thread
#: that write it, the extension.
_AROUND = 52

#: A folder in that of the results, with its separators.
_FOLDER = 12

#: The most bytes of a name and of a path on Linux; elsewhere the system says so when it is reached.
_LONGEST = 255, 4095


def require_writable(out: Path, source: Path | None = None, remedy: str | None = "give an empty or new one") -> None:
    """Check, before any work is done, that results can be written to a folder.

    Args:
        out: the folder; it need not exist.
        source: where the input is; it must not lie inside `out`.
        remedy: what to do if the folder is not empty; None if it may contain files.

    Raises:
        InputError: `out` is a file or a link to nothing, cannot be written to, is not empty, contains the input, or has
            a name that is not UTF-8, which the writer of OpenEXR pictures cannot have.
    """
    try:
        str(out.absolute()).encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(f"{out}: the path is not UTF-8, expected one that is; give another folder") from None
    try:
        if out.exists() and not out.is_dir():
            raise InputError(f"{out}: is a file, expected a folder for the results")
        # Path.resolve() fails on links that lead to each other.
        if source is not None and Path(os.path.realpath(source)).is_relative_to(os.path.realpath(out)):
            raise InputError(f"{out}: contains the input {source}; give another folder for the results")
        existing = _existing(out)
        for folder in (out, *out.parents):
            if folder.is_symlink() and not folder.exists():
                raise InputError(f"{folder}: is a link to what is not there; give another folder")
        with tempfile.TemporaryDirectory(prefix=".tnst_mi-", dir=existing):
            pass
        occupied = out.exists() and any(out.iterdir())
    except OSError as error:
        raise InputError(f"{out}: cannot be written to ({error.strerror}); give another folder") from None
    if occupied and remedy is not None:
        raise InputError(f"{out}: is not empty; {remedy}")


def require_names(out: Path, names: Iterable[str]) -> None:
    """Check, before any work is done, that files named after frames can be written to a folder.

    Args:
        out: the folder of the results.
        names: of the frames.

    Raises:
        InputError: the name or the path of a file would be longer than the system allows.
    """
    longest = max(names, key=lambda name: len(os.fsencode(name)))
    size, folder = len(os.fsencode(longest)), len(os.fsencode(out.absolute()))
    longest_name, longest_path = _LONGEST
    if size > longest_name - _AROUND:
        raise InputError(
            f"{longest}: the name has {size} bytes, expected at most {longest_name - _AROUND}, since results are named "
            "after it; rename the file"
        )
    if folder + size > longest_path - _AROUND - _FOLDER:
        raise InputError(
            f"{out}: the path has {folder} bytes, expected at most {longest_path - _AROUND - _FOLDER - size}, since "
            "the results are in it; give a folder with a shorter path"
        )


def require_space(out: Path, needed: int) -> None:
    """Check, before any work is done, that a disk has enough free space.

    Args:
        out: the folder of the results.
        needed: upper bound on the bytes that the run writes.

    Raises:
        InputError: less is free.
    """
    free = shutil.disk_usage(_existing(out)).free
    if needed > free:
        raise InputError(
            f"{out}: {amount(free)} are free on its disk and the run needs up to {amount(needed)}, most of "
            "them until it is done; free some space, give another folder, or stylize fewer --frames at a time"
        )


def _existing(out: Path) -> Path:
    """The nearest existing folder: the given one, or its closest existing parent."""
    return next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.exists())
