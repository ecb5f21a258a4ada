"""Checks, made before any work is done, that results can be written to a folder."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from tnst_mi.errors import InputError


def require_writable(out: Path, source: Path | None = None, remedy: str | None = "give an empty or new one") -> None:
    """Check, before any work is done, that results can be written to a folder.

    Args:
        out: the folder; it need not exist.
        source: where the input is; it must not lie inside `out`.
        remedy: what to do if the folder is not empty; None if it may contain files.

    Raises:
        InputError: `out` is a file, cannot be written to, is not empty, contains the input, or has a name that is not
            UTF-8, which the writer of OpenEXR pictures cannot have.
    """
    try:
        str(out.absolute()).encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(f"{out}: the path is not UTF-8, expected one that is; give another folder") from None
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file, expected a folder for the results")
    if source is not None and source.resolve().is_relative_to(out.resolve()):
        raise InputError(f"{out}: contains the input {source}; give another folder for the results")
    existing = _existing(out)
    try:
        with tempfile.TemporaryDirectory(prefix=".tnst_mi-", dir=existing):
            pass
        occupied = out.exists() and any(out.iterdir())
    except OSError as error:
        raise InputError(f"{out}: cannot be written to ({error.strerror}); give another folder") from None
    if occupied and remedy is not None:
        raise InputError(f"{out}: is not empty; {remedy}")


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
            f"{out}: {free / 1e9:.3g} GB are free on its disk and the run needs up to {needed / 1e9:.3g} GB, most of "
            "them until it is done; free some space, give another folder, or stylize fewer --frames at a time"
        )


def _existing(out: Path) -> Path:
    """The nearest existing folder: the given one, or its closest existing parent."""
    return next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.exists())
