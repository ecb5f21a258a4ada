"""Files of the studio's folder, read and written only if they are plain ones: neither links nor pipes.

Other programs may put anything there. What a link leads to must not be shown on the page, nor be written to, and nobody
writes to a pipe for which the page would wait.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

from tnst_mi.errors import InputError, StoppedError
from tnst_mi.machine.lock import FolderLock
from tnst_mi.machine.terminal import one_line
from tnst_mi.recipe.recipe import Recipe

#: Windows has neither.
_PLAIN = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

#: Bytes of a file that is read as a whole, at most.
_LARGEST = 64 << 20


def require_own(out: Path, lock: FolderLock | None) -> None:
    """Check that the folder of a studio is the one that it has locked, since another may have it by now.

    Args:
        out: the folder.
        lock: of it; None for a folder that nobody else can have.

    Raises:
        InputError: it has been moved, removed or replaced.
    """
    try:
        if lock is not None:
            lock.require_held()
    except StoppedError:
        raise InputError(
            one_line(
                f"studio: {out} has been moved, removed or replaced, so nothing is written there any more; end this "
                "studio and start it again"
            )
        ) from None


def is_plain(file: Path, above: Path | None = None) -> bool:
    """Whether a name is that of a plain file, or of none yet.

    Args:
        file: the file.
        above: a folder above it, between which and the file no folder may be a link; None for that of the file.
    """
    try:
        between = [] if above is None else [above, *(above / part for part in file.relative_to(above).parents)]
        return stat.S_ISREG(file.lstat().st_mode) and not any(folder.is_symlink() for folder in between)
    except FileNotFoundError:
        return True
    except OSError:
        return False


def opened_plain(file: Path, mode: str = "rb", above: Path | None = None) -> BinaryIO:
    """Open a plain file; see `is_plain`.

    Args:
        file: the file.
        mode: "rb", "ab" to add to it, or "wb" to write it anew.
        above: see `is_plain`.

    Raises:
        OSError: there is none, or what has its name is not plain.
    """
    if not is_plain(file, above):
        raise OSError(errno.ELOOP, "is a link, or no plain file", str(file))
    opened = open(file, mode, opener=lambda name, flags: os.open(name, flags | _PLAIN, 0o666))
    if not stat.S_ISREG(os.fstat(opened.fileno()).st_mode):
        opened.close()
        raise OSError(errno.ELOOP, "is no plain file", str(file))
    return opened  # pyright: ignore[reportReturnType]


def plain_bytes(file: Path, above: Path | None = None) -> bytes:
    """What a plain file holds.

    Raises:
        OSError: there is none, it is too large, or what has its name is not plain.
    """
    with opened_plain(file, above=above) as opened:
        found = opened.read(_LARGEST + 1)
    if len(found) > _LARGEST:
        raise OSError(errno.EFBIG, "is too large", str(file))
    return found


def plain_json(file: Path) -> Any:
    """The values in a JSON file.

    Raises:
        OSError: see `plain_bytes`.
        ValueError, RecursionError: it is none.
    """
    return json.loads(plain_bytes(file))


def plain_recipe(file: Path) -> Recipe:
    """The recipe in a plain file.

    Raises:
        InputError: there is none, or what has its name is not plain.
    """
    if not is_plain(file):
        raise InputError(one_line(f"{file}: is a link, or no plain file, as the recipe of a try is; remove it"))
    return Recipe.from_toml(file)


def excerpt(file: Path, most: int, begin: int = 0, last: bool = False) -> str:
    """Some bytes of a text file; nothing if there is none.

    Args:
        file: the file; what is no plain one counts as none.
        most: how many bytes, at most.
        begin: those before are left out.
        last: whether to take the last ones rather than the first.
    """
    try:
        with opened_plain(file) as opened:
            size = os.fstat(opened.fileno()).st_size
            opened.seek(max(begin, size - most) if last else begin)
            return opened.read(most).decode("utf-8", "replace")
    except OSError:
        return ""
