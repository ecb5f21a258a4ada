"""Atomic writes: a file appears complete or not at all, and stays once it has appeared.

Everything that the package writes passes through here: a process that is killed leaves whole files and unfinished ones
of hidden names, and a machine that loses its power has what was written before it.
"""

from __future__ import annotations

import errno
import glob
import os
import platform
import shutil
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

#: How the names of what is unfinished begin, which nobody else's do.
UNFINISHED = ".tnst_mi-"

#: Tells this machine from others, which may write to the same folder from a process of the same number.
_MACHINE = f"{zlib.crc32(platform.node().encode('utf-8')) & 0xFFFF:04x}"

#: Bytes written to find out why a library could not write.
_PROBE = 1 << 20


@contextmanager
def written_whole(path: Path, durable: bool = True) -> Iterator[Path]:
    """Yield the path of a temporary file beside `path`, renamed to `path` if the block ends without an exception.

    The temporary file keeps the extension, from which some writers infer the format. Missing folders are created.

    Args:
        path: the file.
        durable: whether it has to be on the disk, and not only on its way there, when the block ends. A file that is
            not is safe against a killed process, but not against a loss of power, after which it may be empty.

    Raises:
        OSError: it cannot be written.
    """
    make_folder(path.parent)
    here = f"{_MACHINE}.{os.getpid():x}.{threading.get_native_id():x}"
    temporary = path.with_name(f"{UNFINISHED}{path.stem}.{here}{path.suffix}")
    try:
        yield temporary
        _publish(temporary, path, durable)
    except OSError as error:
        # Who reads of it looks for the file, not for the unfinished one.
        if error.filename in (None, str(temporary)):
            error.filename, error.filename2 = str(path), None
        raise
    finally:
        # Where even that fails, the failure to write is what to tell.
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def append(path: Path, text: str) -> None:
    """Add a text to the end of a file, which `sync` makes durable; of a text that does not fit, a part may be added.

    Raises:
        OSError: it cannot be written.
    """
    make_folder(path.parent)
    _add(path, text)


def make_folder(folder: Path) -> None:
    """Create a folder and those above it, durably, unless they exist.

    Raises:
        OSError: it cannot be created.
    """
    if folder.is_dir():
        return
    make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    sync(folder.parent)


def remove_folder(folder: Path) -> None:
    """Remove a folder with everything in it, if it is there, in one step: no killed process leaves a part of it.

    A file or a link that has its name is removed too.

    Raises:
        OSError: it cannot be removed.
    """
    removed = folder.with_name(f"{UNFINISHED}{folder.name}.{os.getpid()}.removed")
    try:
        os.replace(folder, removed)
    except FileNotFoundError:
        return
    sync(folder.parent)
    if removed.is_dir() and not removed.is_symlink():
        shutil.rmtree(removed)
    else:
        removed.unlink()


def remove_unfinished(folder: Path) -> None:
    """Remove the temporary files, and the folders being removed, that a killed process left in a folder.

    What is behind a link is not ours: it is left alone, whether the folder is a link or something in it.
    """
    if folder.is_symlink() or not folder.is_dir():
        return
    for path in folder.glob(f"{glob.escape(UNFINISHED)}*"):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk.

    Raises:
        OSError: the disk failed.
    """
    folder = path.is_dir()
    if folder and os.name != "posix":
        return  # Windows has no such thing for folders
    descriptor = os.open(path, os.O_RDONLY if folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    except OSError as error:
        # Some network file systems refuse it for folders, whose names they keep by themselves.
        if not (folder and error.errno in (errno.EINVAL, errno.ENOTSUP)):
            raise
    finally:
        os.close(descriptor)


def write_failure(path: Path, reason: str) -> OSError:
    """The error for a library that reports only that it could not write a file: what the system says to another try.

    That is a full disk, a quota that is used up, a folder that cannot be written to; or EIO if the try succeeds.
    """
    probe = path.with_name(f"{UNFINISHED}probe.{os.getpid()}.tmp")
    try:
        with probe.open("wb") as file:
            file.write(bytes(_PROBE))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return OSError(error.errno, f"{reason} ({error.strerror})", str(path))
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
    return OSError(errno.EIO, reason, str(path))


def _publish(temporary: Path, path: Path, durable: bool) -> None:
    """Give a finished file its name; its contents must be on the disk before its name is."""
    if durable:
        sync(temporary)
    os.replace(temporary, path)
    if durable:
        sync(path.parent)


def _add(path: Path, text: str) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(text)
