"""One run at a time in a folder: a lock file that names the process that writes there.

The system's own lock on the file (flock) ends with the process that holds it, however that ends. So the lock of a dead
run is not believed, whichever process has its number now. Where a file system has no such locks, the process that the
file names is looked up, by its number and the time when it started. A process on another machine cannot be looked up,
and its system's locks do not reach every network file system: it is believed until the file is removed.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

from tnst_mi.errors import InputError, StoppedError

#: The lock file of a folder.
LOCK = ".lock"

#: Seconds by which two readings of a process's starting time may differ.
_SAME_START = 1.0

#: Windows has none.
_fcntl: Any = importlib.import_module("fcntl") if importlib.util.find_spec("fcntl") else None


class FolderLock:
    """The lock of a folder, held.

    Args:
        folder: the locked folder.
        descriptor: of the open lock file.
    """

    def __init__(self, folder: Path, descriptor: int) -> None:
        self._folder, self._descriptor = folder, descriptor

    def require_held(self) -> None:
        """Check that what is about to be written goes into the folder that was locked.

        Raises:
            StoppedError: the folder has been moved, removed or replaced.
        """
        if not _is_open_as(self._descriptor, self._folder / LOCK):
            raise StoppedError(
                f"{self._folder}: has been moved, removed or replaced during its run, so nothing more is written; "
                "bring it back and go on with --resume, or begin anew"
            )


@contextmanager
def locked(folder: Path) -> Iterator[FolderLock]:
    """Hold the lock of an existing folder; the lock file is removed in the end.

    Raises:
        InputError: another process holds it.
        OSError: the lock file cannot be written.
    """
    path = folder / LOCK
    descriptor = _taken(folder)
    try:
        _write_holder(descriptor)
        yield FolderLock(folder, descriptor)
    finally:
        # Removed while it is still locked: nobody can lock a file that is about to go. In a folder that has been
        # replaced it is another's, and in one that has become read-only it stays, as that of a dead process.
        with suppress(OSError):
            if _is_open_as(descriptor, path):
                path.unlink()
        os.close(descriptor)


def require_unlocked(folder: Path) -> None:
    """Check that no other process holds the lock of a folder, which need not exist; nothing is written.

    Raises:
        InputError: one does.
    """
    try:
        descriptor = os.open(folder / LOCK, os.O_RDWR)
    except OSError:
        return  # there is none, or the folder cannot be written to, which others report
    try:
        _require_unheld(folder, descriptor)
    finally:
        os.close(descriptor)


def _taken(folder: Path) -> int:
    """The descriptor of the folder's lock file, locked."""
    path = folder / LOCK
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _require_unheld(folder, descriptor)
        except InputError:
            os.close(descriptor)
            raise
        # The one that held it until now may have removed it in between.
        if _is_open_as(descriptor, path):
            return descriptor
        os.close(descriptor)


def _require_unheld(folder: Path, descriptor: int) -> None:
    """Lock an open lock file, or refuse."""
    known = _system_lock(descriptor)
    holder = _holder(descriptor)
    where = f"process {holder.get('pid', 'unknown')} on {holder.get('host', 'an unknown host')}"
    if known is False:
        raise InputError(f"{folder}: another run is writing there ({where}); wait for its end, or give another folder")
    if holder and holder.get("host") != platform.node():
        raise InputError(
            f"{folder}: another run was writing there ({where}), which cannot be asked from here; if it has ended, "
            f"remove {folder / LOCK}"
        )
    if known is None and _lives(holder):
        raise InputError(f"{folder}: another run is writing there ({where}); wait for its end, or give another folder")


def _system_lock(descriptor: int) -> bool | None:
    """Whether the system's lock could be taken; None if it has none for this file."""
    if _fcntl is None:
        return None
    try:
        _fcntl.flock(descriptor, _fcntl.LOCK_EX | _fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _holder(descriptor: int) -> dict[str, Any]:
    """Who wrote a lock file; empty if nobody has, or if a loss of power left it incomplete."""
    try:
        os.lseek(descriptor, 0, os.SEEK_SET)
        holder = json.loads(os.read(descriptor, 4096))
    except ValueError:
        return {}
    return holder if isinstance(holder, dict) else {}


def _write_holder(descriptor: int) -> None:
    process = psutil.Process()
    holder = {"host": platform.node(), "pid": process.pid, "started": process.create_time()}
    os.ftruncate(descriptor, 0)
    os.lseek(descriptor, 0, os.SEEK_SET)
    os.write(descriptor, json.dumps(holder).encode("utf-8"))


def _lives(holder: dict[str, Any]) -> bool:
    """Whether the process that a lock file names is still there; another one may have its number."""
    try:
        return abs(psutil.Process(holder["pid"]).create_time() - holder["started"]) < _SAME_START
    except (psutil.Error, KeyError, TypeError, ValueError):
        return False


def _is_open_as(descriptor: int, path: Path) -> bool:
    """Whether an open file is the one of this name."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except OSError:
        return False
