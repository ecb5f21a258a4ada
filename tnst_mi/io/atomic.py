"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: With fewer free bytes a disk counts as full.
_ROOM = 1 << 20


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give the path of a temporary file beside `path`, which takes its place once the block ends well.

    The temporary file keeps the suffix, since some writers go by it. Missing folders are made. It is safe against the
    end of the process, not of the machine: the file system may write the new name before the contents.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def remove_unfinished(folder: Path) -> None:
    """Remove what a killed process was writing in a folder when it was killed."""
    for path in folder.iterdir() if folder.is_dir() else ():
        if re.fullmatch(r"\..+\.\d+\.\w+", path.name) and path.is_file():
            path.unlink(missing_ok=True)


def write_failure(path: Path, reason: str) -> OSError:
    """The error of a library that tells but that it could not write: that of a full disk where there is no room."""
    full = shutil.disk_usage(path.parent).free < _ROOM
    return OSError(errno.ENOSPC if full else errno.EIO, reason, str(path))
