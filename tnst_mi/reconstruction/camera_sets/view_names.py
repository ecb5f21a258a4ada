"""Names of views: results have them as parts of the names of files, so not every text can be one."""

from __future__ import annotations

import reprlib
import unicodedata
from collections.abc import Iterable
from pathlib import Path

from tnst_mi.errors import InputError

#: Longest name in bytes: those of files have 255 on most systems, with the number of the frame and an extension.
_LONGEST = 128

#: What the pictures of each frame have in place of a view's name already.
_RESERVED = ("sides",)


def require_usable_names(file: Path, names: Iterable[str]) -> None:
    """Check that the names of views can be parts of those of files, each of its own.

    Args:
        file: of the cameras, for messages.
        names: of its views.

    Raises:
        InputError: one cannot, or two would be the same file where capitals do not matter.
    """
    known: dict[str, str] = {}
    for name in names:
        if wrong := _wrong(name):
            raise InputError(f"{file}: view {reprlib.repr(name)}: its name {wrong}; results are named so, rename it")
        if (other := known.setdefault(name.casefold(), name)) != name:
            raise InputError(
                f"{file}: views {other!r} and {name!r}: differ in capitals alone, as names of files may not; rename one"
            )


def _wrong(name: str) -> str | None:
    """What a name has that none of a file can have."""
    # Of categories, Cc are control characters and Cs halves of characters, which JSON can hold.
    if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in name):
        return "has a control character"
    if not name or name in (".", "..") or set(name) & set("/\\"):
        return "is part of a path, expected one without / and \\"
    if (size := len(name.encode())) > _LONGEST:
        return f"has {size} bytes, expected at most {_LONGEST}"
    return "is that of the picture of three sides" if name.casefold() in _RESERVED else None
