"""Who writes in the folder of a run, by the lock file that tnst-mi keeps there. Only looks; tnst-mi itself decides."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import platform
from contextlib import suppress
from pathlib import Path
from typing import Any

#: The lock file of tnst-mi: JSON with "host" and "pid", and a lock of the system while that process holds it.
LOCK = ".lock"

#: No link is followed, and no pipe is waited for.
_PLAIN = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

#: Windows has none, and no such locks: there, tnst-mi says it when it begins.
_fcntl: Any = importlib.import_module("fcntl") if importlib.util.find_spec("fcntl") else None


def writer_of(run: Path) -> str | None:
    """Who writes in the folder of a run, such as "process 123 on render7"; None where nobody is known to.

    Args:
        run: the folder, which need not exist.
    """
    if _fcntl is None:
        return None
    try:
        descriptor = os.open(run / LOCK, os.O_RDONLY | _PLAIN)
    except OSError:
        return None
    try:
        host, pid = _holder(descriptor)
        # The locks of another machine do not reach here from every disk.
        if _is_held(descriptor) or host not in ("", platform.node()):
            return f"process {pid} on {host}" if pid else "another process"
    finally:
        os.close(descriptor)
    return None


def _is_held(descriptor: int) -> bool:
    try:
        _fcntl.flock(descriptor, _fcntl.LOCK_SH | _fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    _fcntl.flock(descriptor, _fcntl.LOCK_UN)
    return False


def _holder(descriptor: int) -> tuple[str, int]:
    """The machine and the process that a lock file names; nothing is trusted of it."""
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        said = json.loads(os.read(descriptor, 4096))
        host, pid = said["host"], said["pid"]
        if isinstance(host, str) and host.isprintable() and isinstance(pid, int):
            return host[:100], pid
    return "", 0
