"""Atomic writes: a file appears complete or not at all."""

from __future__ import annotations

import errno
import os
import re
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: With fewer free bytes, a disk counts as full.
_ROOM = 1 << 20


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield the path of a temporary file beside `path`, renamed to `path` if the block ends without an exception.

    The temporary file keeps the extension, from which some writers infer the format. Missing folders are created. This
    is safe against a killed process, not against a machine crash: the file system may commit the new name before the
    contents.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.{threading.get_native_id()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def remove_unfinished(folder: Path) -> None:
    """Remove the temporary files that a killed process left in a folder."""
    for path in folder.iterdir() if folder.is_dir() else ():
        if re.fullmatch(r"\..+\.\d+\.\w+", path.name) and path.is_file():
            path.unlink(missing_ok=True)


def write_failure(path: Path, reason: str) -> OSError:
    """The error for a library that reports only that writing failed: ENOSPC if the disk is full, else EIO."""
    full = shutil.disk_usage(path.parent).free < _ROOM
    return OSError(errno.ENOSPC if full else errno.EIO, reason, str(path))
