"""Which stages of USD are ours: those of other people are not replaced."""

from __future__ import annotations

import mmap
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.resources import VERSION

#: Tells our stages from all others. Of random digits, it is found in the bytes of text and of binary stages alike,
#: whose compression would shorten only what is repeated: no library has to open a file that may be anything.
_OURS = "b7e41f9c26d85a03"


def metadata() -> dict[str, str]:
    """What our stages hold as `customLayerData`."""
    return {"creator": f"tnst_mi {VERSION}", "tnst_mi_stage": _OURS}


def require_own(path: Path) -> None:
    """Check, before any work is done, that nothing but a stage of ours would be replaced.

    Args:
        path: the stage, which need not exist.

    Raises:
        InputError: there is a file that we did not write, or cannot read.
    """
    try:
        if not path.exists() or (path.is_file() and _is_marked(path)):
            return
    except OSError as error:
        raise InputError(f"{path}: is there, and cannot be read ({error.strerror}); give another name") from None
    raise InputError(
        f"{path}: is there, and was not written by tnst-mi convert; remove it, or give the stage another name"
    )


def _is_marked(path: Path) -> bool:
    with path.open("rb") as file:
        if not path.stat().st_size:  # nothing, which cannot be mapped
            return False
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return content.find(_OURS.encode()) >= 0
