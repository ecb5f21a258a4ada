"""Removing tries and renders: first they get a hidden name, then they go, so that no crash leaves a part of one.

Numbers are not given again: what has begun from one that is gone must not go on from another.
"""

from __future__ import annotations

import os
import re
import shutil
from contextlib import suppress
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import UNFINISHED, sync, written_whole
from tnst_mi.machine.lock import LOCK
from tnst_mi.machine.terminal import one_line
from tnst_mi.run.folder import WORK
from tnst_mi.studio.plain import excerpt

#: How folders of what is being removed are called; what follows is the number.
_REMOVED = f"{UNFINISHED}removed-"
_REMOVED_NAME = re.compile(re.escape(_REMOVED) + r"\d{4,6}")

#: The files of one, beside its folder: the record first, without which it counts as gone; the recipe, whose name keeps
#: its number taken, last.
_SUFFIXES = (".json", "", ".log", ".toml")

#: File with the highest number that has been given in a folder.
_HIGHEST = "highest_number"

#: The last number that can be given.
_LAST = 999_999

#: What tells the folder of a run, begun or finished, from others.
_OF_RUNS = ("run.json", "metrics.jsonl", LOCK, WORK)


def remove(folder: Path) -> None:
    """Remove a try or a render with its recipe, its log and its record; what links lead to stays.

    A folder of its name that is not that of a run was made by others, and stays too.

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
    names.append(excerpt(above / _HIGHEST, 64).strip())
    return max((int(name) for name in names if re.fullmatch(r"\d{1,6}", name)), default=0)


def claimed_number(above: Path) -> int:
    """Take the next number in a folder, whose recipe file is made at once, so that nobody else gets it.

    Numbers of which something is there already, whoever has made it, are passed over.

    Raises:
        InputError: there is none left.
        OSError: the file cannot be made.
    """
    for number in range(highest_number(above) + 1, _LAST + 1):
        folder = above / f"{number:04d}"
        if any(os.path.lexists(folder.with_name(f"{folder.name}{suffix}")) for suffix in _SUFFIXES):
            continue
        with suppress(FileExistsError):
            folder.with_suffix(".toml").open("x").close()
            return number
    raise InputError(one_line(f"studio: {above}: {_LAST} was the last number; give another --out"))


def _hide(folder: Path, hidden: Path) -> None:
    """Move all that is left of one into a folder."""
    for suffix in _SUFFIXES:
        if suffix == "" and not _is_of_run(folder):
            continue
        with suppress(FileNotFoundError):
            folder.with_name(f"{folder.name}{suffix}").replace(hidden / f"{folder.name}{suffix}")
    sync(folder.parent)


def _is_of_run(folder: Path) -> bool:
    """Whether a folder is that of a run, which may have been stopped before it has written anything, or a link."""
    if folder.is_symlink():
        return True
    names = os.listdir(folder) if folder.is_dir() else ["a file"]
    return not names or any(name in _OF_RUNS for name in names)
