"""The gate that everything passes which reading a missing or damaged file makes libraries raise or print.

Every reader of files stands behind it: of frames, recipes, pictures and weights. What a decoder raises means that its
file is damaged. What our own code raises on what was decoded may be a fault of ours, which is said, and is never passed
over as a frame that cannot be read.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from tnst_mi.errors import InputError, UnforeseenError
from tnst_mi.machine.terminal import one_line

_STANDARD_OUTPUT, _STANDARD_ERROR = 1, 2

# Streams belong to the whole process. Who has them may silence them once more, or fork.
_streams = threading.RLock()
if hasattr(os, "register_at_fork"):
    # No child begins its life while they are taken by a thread that the child does not have.
    os.register_at_fork(before=_streams.acquire, after_in_parent=_streams.release, after_in_child=_streams.release)


@contextmanager
def gate(path: Path, kind: str) -> Iterator[None]:
    """Turn every exception in using a file into one line that names the file, printable and of bounded length.

    Args:
        path: the file.
        kind: what was expected, with its article, such as "an npz file".

    Raises:
        UnforeseenError: something other than the file may be wrong.
        InputError: the file is.
    """
    with _bounded(path):
        try:
            yield
        except (InputError, MemoryError, OSError):
            raise
        except Exception as error:
            raise UnforeseenError(
                f"{path}: cannot be used as {kind} ({type(error).__name__}: {error}); if the file is sound, this is a "
                "fault of tnst_mi, which --debug shows"
            ) from error


@contextmanager
def decoding(path: Path, kind: str) -> Iterator[None]:
    """The same as `gate` for what decodes a file, whose exceptions mean that it is damaged.

    Raises:
        InputError: anything is wrong.
    """
    with _bounded(path):
        try:
            yield
        except (InputError, MemoryError):
            raise
        except Exception as error:
            # The system's errors have a number; libraries raise others without one for damaged files. No list of
            # exceptions would be complete: decoders raise many types.
            if isinstance(error, OSError) and error.errno is not None:
                raise
            reason = str(error).strip() or type(error).__name__
            raise InputError(f"{path}: not {kind}, truncated, or damaged ({reason}); save or copy it again") from error


@contextmanager
def opening(path: Path, kind: str) -> Iterator[None]:
    """The same as `decoding` for a file that is opened, whose reader need not check that there is one.

    Raises:
        InputError: anything is wrong, or the path is a folder, or the file is empty.
    """
    with decoding(path, kind):
        if path.is_dir():
            raise InputError(f"{path}: is a folder, expected {kind}")
        if path.stat().st_size == 0:
            raise InputError(f"{path}: is empty (0 bytes), expected {kind}")
        yield


@contextmanager
def silenced() -> Iterator[None]:
    """Drop what libraries print about a damaged file, also those that are not written in Python.

    Other threads that enter wait; what they print elsewhere in the meantime is lost too.
    """
    with _streams, contextlib.ExitStack() as restoring:
        flushed = [stream for stream in (sys.stdout, sys.stderr) if _flushed(stream)]
        _flush_c()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        restoring.callback(os.close, nowhere)
        for stream in (_STANDARD_OUTPUT, _STANDARD_ERROR):
            # A program without a console has none.
            with contextlib.suppress(OSError):
                kept = os.dup(stream)
                restoring.callback(os.close, kept)
                restoring.callback(os.dup2, kept, stream)
                os.dup2(nowhere, stream)
        restoring.callback(_flush_c)
        for stream in flushed:  # what is kept in the others was not printed here, and must not be lost
            restoring.callback(_flushed, stream)
        restoring.enter_context(contextlib.redirect_stdout(io.StringIO()))
        restoring.enter_context(contextlib.redirect_stderr(io.StringIO()))
        yield


def _flushed(stream: TextIO | None) -> bool:
    """Write out what Python keeps in the buffer of a stream, and return whether that could be done.

    Where it cannot, since there is no stream, it is closed, its disk is full or its reader has left, no file that is
    read is to blame: it fails again where something is written to it.
    """
    try:
        stream.flush()  # pyright: ignore[reportOptionalMemberAccess]
    except Exception:  # a host may have put anything in its place
        return False
    return True


def _flush_c() -> None:
    """The same for C's library, where it is part of the program."""
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).fflush(None)


@contextmanager
def _bounded(path: Path) -> Iterator[None]:
    """Errors of the system and those that are too long, as lines."""
    try:
        yield
    except InputError as error:
        # Names and values in it may come from the file.
        if (line := one_line(str(error))) == str(error):
            raise
        raise type(error)(line) from error.__cause__
    except FileNotFoundError as error:
        raise InputError(one_line(f"{error.filename or path}: no such file")) from error
    except PermissionError as error:
        raise InputError(one_line(f"{error.filename or path}: cannot be read (no permission)")) from error
    except MemoryError as error:
        raise InputError(one_line(f"{path}: takes more memory than there is")) from error
    except OSError as error:
        raise InputError(one_line(f"{path}: cannot be read ({error.strerror or error})")) from error
