"""The gate that everything passes which reading a missing or damaged file makes libraries raise or print.

Every reader of files stands behind it: of frames, recipes, pictures and weights.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line

_STANDARD_ERROR = 2

#: Of the process, whose stderr is one: a thread would otherwise keep what another has put in its place.
_SILENCING = threading.Lock()
if hasattr(os, "register_at_fork"):
    # No child begins its life while it is taken by a thread that the child does not have.
    os.register_at_fork(
        before=_SILENCING.acquire, after_in_parent=_SILENCING.release, after_in_child=_SILENCING.release
    )


@contextmanager
def gate(path: Path, kind: str) -> Iterator[None]:
    """Turn every exception in reading a file into one line that names the file, printable and of bounded length.

    Args:
        path: the file.
        kind: what was expected, with its article, such as "an npz file".

    Raises:
        InputError: anything is wrong.
    """
    try:
        yield
    except InputError as error:
        # Names and values in it may come from the file.
        if (line := one_line(str(error))) == str(error):
            raise
        raise InputError(line) from None
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except PermissionError:
        raise InputError(f"{path}: cannot be read (no permission)") from None
    except MemoryError as error:
        raise InputError(f"{path}: takes more memory than there is") from error
    except OSError as error:
        # The system's errors have a number; libraries raise others without one for damaged files.
        if error.errno is None:
            raise _damaged(path, kind, error) from error
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except Exception as error:
        # No list of exceptions would be complete: decoders raise many types on damaged files.
        raise _damaged(path, kind, error) from error


@contextmanager
def opening(path: Path, kind: str) -> Iterator[None]:
    """The same as `gate` for a file that is opened, whose reader need not check that there is one.

    Raises:
        InputError: anything is wrong, or the path is a folder, or the file is empty.
    """
    with gate(path, kind):
        if path.is_dir():
            raise InputError(f"{path}: is a folder, expected {kind}")
        if path.stat().st_size == 0:
            raise InputError(f"{path}: is empty (0 bytes), expected {kind}")
        yield


@contextmanager
def silenced() -> Iterator[None]:
    """Drop what libraries that are not written in Python print on stderr about a damaged file."""
    sys.stderr.flush()
    with _SILENCING:
        try:
            kept = os.dup(_STANDARD_ERROR)
        except OSError:  # there is none, as in a program without a console
            yield
            return
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, _STANDARD_ERROR)
            yield
        finally:
            os.dup2(kept, _STANDARD_ERROR)
            os.close(kept)
            os.close(nowhere)


def _damaged(path: Path, kind: str, error: Exception) -> InputError:
    reason = str(error).strip() or type(error).__name__
    return InputError(one_line(f"{path}: not {kind}, truncated, or damaged ({reason})"))
