"""The contents of the files that a reconstruction has read: it goes on with the same ones only."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.network.download import file_hash


def digest(path: Path) -> str:
    """The size of a file in bytes, and the SHA-256 of what is in it.

    Raises:
        OSError: it cannot be read.
    """
    return f"{path.stat().st_size} {file_hash(path, 'sha256')}"


def require_unchanged(known: Mapping[str, str]) -> None:
    """Check that files still are what they were.

    Args:
        known: their digests by absolute path.

    Raises:
        InputError: one is gone, or was changed.
    """
    for name, before in known.items():
        path = Path(name)
        # The size alone tells most changes, without reading anything.
        if not path.is_file():
            what = "is gone, and was read by the reconstruction that is to go on"
        elif str(path.stat().st_size) != before.partition(" ")[0] or digest(path) != before:
            what = "was changed since the reconstruction that is to go on read it"
        else:
            continue
        raise InputError(f"{path}: {what}; put the earlier file back, or begin anew with --overwrite")
