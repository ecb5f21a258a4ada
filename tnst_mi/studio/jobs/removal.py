"""Removing tries and renders: first they get a hidden name, then they go, so that no crash leaves a part of one.

Numbers are not given again: what has begun from one that is gone must not go on from another.
"""

from __future__ import annotations

import re
import shutil
from contextlib import suppress
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import UNFINISHED, sync, written_whole
from tnst_mi.machine.terminal import one_line

#: How folders of what is being removed are called; what follows is the number.
_REMOVED = f"{UNFINISHED}removed-"
_REMOVED_NAME = re.compile(re.escape(_REMOVED) + r"\d{4,6}")

#: The files of one, beside its folder: the record first, without which it counts as gone; the recipe, whose name keeps
#: its number taken, last.
_SUFFIXES = (".json", "", ".log", ".toml")

#: File with the highest number that has been given in a folder.
_HIGHEST = "highest_number"


def remove(folder: Path) -> None:
    """Remove a try or a render with its recipe, its log and its record; what links lead to stays.

    Args:
        folder: such as OUT/tries/0003, whose run has ended.

    Raises:
        InputError: the folder above it is a link, so that it may be anywhere; or it cannot be removed.
    """
    above, hidden = folder.parent, folder.with_name(f"{_REMOVED}{folder.name}")
    if above.is_symlink() or hidden.is_symlink():
        raise InputError(one_line(f"studio: {above if above.is_symlink() else hidden} is a link; nothing is removed"))
    try:
        with written_whole(above / _HIGHEST) as temporary:
            temporary.write_text(f"{highest_number(above)}\n", "ascii")
        hidden.mkdir(exist_ok=True)
        _hide(folder, hidden)
        shutil.rmtree(hidden)
    except OSError as error:
        raise InputError(one_line(f"studio: {folder} cannot be removed ({error.strerror}); mend that")) from None


def finish_removals(above: Path) -> None:
    """Remove the rest of what a studio that was killed meanwhile has begun to remove; what cannot go stays hidden.

    Args:
        above: the folder of all tries, or of all renders, which need not exist.
    """
    if above.is_symlink():
        return
    for hidden in above.glob(f"{_REMOVED}*"):
        if _REMOVED_NAME.fullmatch(hidden.name) and hidden.is_dir() and not hidden.is_symlink():
            with suppress(OSError):
                _hide(above / hidden.name.removeprefix(_REMOVED), hidden)
            shutil.rmtree(hidden, ignore_errors=True)


def highest_number(above: Path) -> int:
    """The highest number that has been given to tries, or to renders, in a folder; 0 if there were none."""
    names = [path.stem for path in above.glob("*.toml")]
    with suppress(OSError, UnicodeError):
        names.append((above / _HIGHEST).read_text("ascii").strip())
    return max((int(name) for name in names if re.fullmatch(r"\d{1,6}", name)), default=0)


def _hide(folder: Path, hidden: Path) -> None:
    """Move all that is left of one into a folder."""
    for suffix in _SUFFIXES:
        with suppress(FileNotFoundError):
            folder.with_name(f"{folder.name}{suffix}").replace(hidden / f"{folder.name}{suffix}")
    sync(folder.parent)
