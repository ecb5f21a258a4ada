"""One run at a time in a folder: a lock file that names the process that writes there.

The system's own lock on the file (flock) ends with the process that holds it, however that ends. So the lock of a dead
run is not believed, whichever process has its number now. Where a file system has no such locks, the process that the
file names is looked up, by its number and the time when it started. A process on another machine cannot be looked up,
and its system's locks do not reach every network file system: it is believed until the file is removed.

What is in the folder is not trusted: a link is not followed, and a file that does not name a process names nobody.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import platform
import stat
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import psutil

from tnst_mi.errors import InputError, StoppedError
from tnst_mi.machine.terminal import one_line, printable, shortened

#: The lock file of a folder.
LOCK = ".lock"

#: In it, beside the process that holds it: what no other holding of a lock has.
_TOKEN = "token"

#: Linux's name for the time since it was started.
_BOOT = Path("/proc/sys/kernel/random/boot_id")

#: How a lock file is opened: no link is followed, and no pipe is waited for. Windows has neither.
_PLAIN = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

#: How often, and after how many seconds, the lock is tried again while others only look at it.
_TRIES, _PAUSE = 100, 0.01

#: The largest number of a process.
_LARGEST_PID = 2**31 - 1

#: Windows has none.
_fcntl: Any = importlib.import_module("fcntl") if importlib.util.find_spec("fcntl") else None

#: Descriptors of lock files. A child would keep what its parent has locked for as long as it lives, so it closes them.
_opened: set[int] = set()
_opening = threading.Lock()


@dataclass(frozen=True)
class _Process:
    """A process, so named that no other one is meant when its number is used again.

    started: on Linux in ticks since the system's start `boot`, which no change of the clock moves; elsewhere, where
        `boot` is empty, in seconds by the clock.
    """

    host: str
    pid: int
    boot: str = ""
    started: float = 0.0

    def lives(self) -> bool:
        """Whether a process of this machine is still there."""
        try:
            now = _process(self.pid)
        except (OSError, psutil.Error):
            return False
        # Two readings of the clock may differ a little.
        return now.boot == self.boot and abs(now.started - self.started) < 1.0

    def __str__(self) -> str:
        return f"process {self.pid} on {shortened(printable(self.host))}"


class FolderLock:
    """The lock of a folder, held by the process that took it; children that it forks do not hold it.

    Args:
        folder: the locked folder.
        descriptor: of the open lock file.

    Attributes:
        descriptor: likewise; closed in a child.
    """

    def __init__(self, folder: Path, descriptor: int) -> None:
        self.descriptor = descriptor
        self._folder, self._process = folder, os.getpid()

    def require_held(self) -> None:
        """Check that what is about to be written goes into the folder that was locked.

        Raises:
            StoppedError: the folder has been moved, removed or replaced, or this process was forked from the one that
                locked it.
        """
        if not self._is_own():
            raise StoppedError(
                f"{self._folder}: process {self._process} writes there, from which process {os.getpid()} was forked; "
                "go on in that one"
            )
        if not _is_open_as(self.descriptor, self._folder / LOCK):
            raise StoppedError(
                f"{self._folder}: has been moved, removed or replaced during its run, so nothing more is written; "
                "bring it back and go on with --resume, or begin anew"
            )

    def release(self) -> None:
        """Remove the lock file, unless it is another's, and end the lock; in a forked child, nothing."""
        if not self._is_own():
            return
        # Removed while it is still locked: nobody can lock a file that is about to go. In a folder that has been
        # replaced it is another's, and in one that has become read-only it stays, as that of a dead process.
        path = self._folder / LOCK
        with suppress(OSError):
            if _is_open_as(self.descriptor, path):
                path.unlink()
        _close(self.descriptor)

    def _is_own(self) -> bool:
        return os.getpid() == self._process


@contextmanager
def locked(folder: Path, by: str = "run") -> Iterator[FolderLock]:
    """Hold the lock of an existing folder; the lock file is removed in the end.

    Args:
        folder: the folder.
        by: what holds it, in messages, such as "studio".

    Raises:
        InputError: another process holds it, or what has the name of the lock file is none.
        OSError: the lock file cannot be written.
    """
    lock = FolderLock(folder, _taken(folder, by))
    try:
        _write_holder(lock.descriptor)
        yield lock
    finally:
        lock.release()


def require_unlocked(folder: Path) -> None:
    """Check that no other process holds the lock of a folder, which need not exist; nothing is written.

    Raises:
        InputError: one does, or what has the name of the lock file is none.
    """
    try:
        descriptor = _open(folder / LOCK, os.O_RDONLY)
    except OSError:
        return  # there is none, or it cannot be read, which others report
    try:
        _require_unheld(folder, descriptor, exclusive=False)
    finally:
        _close(descriptor)


def _taken(folder: Path, by: str) -> int:
    """The descriptor of the folder's lock file, locked."""
    path = folder / LOCK
    while True:
        descriptor = _open(path, os.O_RDWR | os.O_CREAT)
        try:
            _require_unheld(folder, descriptor, exclusive=True, by=by)
        except BaseException:
            _close(descriptor)
            raise
        # The one that held it until now may have removed it in between.
        if _is_open_as(descriptor, path):
            return descriptor
        _close(descriptor)


def _open(path: Path, flags: int) -> int:
    """The descriptor of a lock file; of nothing else that may have its name, in which we would write."""
    try:
        with _opening:
            descriptor = os.open(path, flags | _PLAIN, 0o666)
            _opened.add(descriptor)
    except OSError:
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise _no_lock(path) from None
        raise
    found = os.fstat(descriptor)
    # A file that its holder has just removed has no name any more.
    if path.is_symlink() or not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
        _close(descriptor)
        raise _no_lock(path)
    return descriptor


def _close(descriptor: int) -> None:
    with _opening:
        _opened.discard(descriptor)
        os.close(descriptor)


def _close_in_child() -> None:
    for descriptor in _opened:
        with suppress(OSError):
            os.close(descriptor)
    _opened.clear()
    _opening.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_opening.acquire, after_in_parent=_opening.release, after_in_child=_close_in_child)


def _no_lock(path: Path) -> InputError:
    return InputError(
        one_line(f"{path}: is a link, or no plain file, as the lock of a run is; remove it, or give another folder")
    )


def _require_unheld(folder: Path, descriptor: int, exclusive: bool, by: str = "run") -> None:
    """Lock an open lock file, so that others still may do the same unless it is exclusive, or refuse."""
    known = _system_lock(descriptor, exclusive)
    holder = _holder(descriptor)
    if known is False or (known is None and holder and holder.host == platform.node() and holder.lives()):
        where = holder or "unknown process"
        raise InputError(
            one_line(f"{folder}: another {by} is writing there ({where}); wait for its end, or give another folder")
        )
    if holder and holder.host != platform.node():
        raise InputError(
            one_line(
                f"{folder}: another {by} was writing there ({holder}), which cannot be asked from here; if it has "
                f"ended, remove {folder / LOCK}"
            )
        )


def _system_lock(descriptor: int, exclusive: bool) -> bool | None:
    """Whether the system's lock could be taken; None if it has none for this file."""
    if _fcntl is None:
        return None
    kind = _fcntl.LOCK_EX if exclusive else _fcntl.LOCK_SH
    for _ in range(_TRIES):
        try:
            _fcntl.flock(descriptor, kind | _fcntl.LOCK_NB)
        except BlockingIOError:
            pass
        except OSError:
            return None
        else:
            return True
        # With those who only look, for a moment, it can be shared.
        try:
            _fcntl.flock(descriptor, _fcntl.LOCK_SH | _fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        _fcntl.flock(descriptor, _fcntl.LOCK_UN)
        time.sleep(_PAUSE)
    return False


def _holder(descriptor: int) -> _Process | None:
    """Who wrote a lock file; None if it is incomplete after a loss of power, or says something else."""
    try:
        os.lseek(descriptor, 0, os.SEEK_SET)
        values = json.loads(os.read(descriptor, 4096))
        holder = _Process(**{name: value for name, value in values.items() if name != _TOKEN})
    except (ValueError, TypeError, AttributeError, RecursionError):
        return None
    kinds = type(holder.host), type(holder.pid), type(holder.boot), type(holder.started)
    return holder if kinds == (str, int, str, float) and 0 < holder.pid <= _LARGEST_PID else None


def _write_holder(descriptor: int) -> None:
    # Who compares its contents tells the runs of one process apart by the token.
    holder = asdict(_process(os.getpid())) | {_TOKEN: uuid.uuid4().hex}
    os.ftruncate(descriptor, 0)
    os.lseek(descriptor, 0, os.SEEK_SET)
    os.write(descriptor, json.dumps(holder).encode("utf-8"))


def _process(pid: int) -> _Process:
    """A process of this machine.

    Raises:
        OSError, psutil.Error: there is none.
    """
    if not _BOOT.exists():
        return _Process(platform.node(), pid, started=psutil.Process(pid).create_time())
    # What follows the program's name, which may have spaces and parentheses, begins with the third field; the start is
    # the 22nd.
    fields = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
    return _Process(platform.node(), pid, _BOOT.read_text("ascii").strip(), float(fields[19]))


def _is_open_as(descriptor: int, path: Path) -> bool:
    """Whether an open file is the one of this name, and not only linked there."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except OSError:
        return False
