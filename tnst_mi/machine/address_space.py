"""A limit of the address space (`ulimit -v`) under which libraries fail to load, or end the process without a word."""

from __future__ import annotations

import sys

from tnst_mi.errors import InputError

if sys.platform != "win32":
    import resource

#: Bytes of address space below which a small frame cannot be read, or be rendered and shown to the network. Mitsuba,
#: LLVM and torch map about a gigabyte of libraries.
_READING, _COMPUTING = 450_000_000, 2_000_000_000


def limit() -> int | None:
    """The largest size of the address space of this process in bytes; None without a limit."""
    if sys.platform == "win32":
        return None
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if most == resource.RLIM_INFINITY else most


def allows_reading() -> bool:
    """Whether Mitsuba and numpy fit into the address space; where they do not, importing them may end the process."""
    return (most := limit()) is None or most >= _READING


def require_address_space(reading_only: bool) -> None:
    """Check that the libraries of a command fit into the address space.

    Args:
        reading_only: whether it only reads and writes frames.

    Raises:
        InputError: they do not.
    """
    needed, most = _READING if reading_only else _COMPUTING, limit()
    if most is not None and most < needed:
        raise InputError(
            f"memory: this process may use {most / 1e9:.2g} GB of address space, and the libraries alone need "
            f"{needed / 1e9:.2g} GB; raise the limit (ulimit -v, or that of the batch job)"
        )
