"""How a stage of USD names the files that it shows."""

from __future__ import annotations

import os
from pathlib import Path


def asset_path(file: Path, stage: Path) -> str:
    """The path of a file, relative to the folder of a stage where that leads to it, so that both can be moved together.

    It is absolute where a link between the two would lead a relative one elsewhere, by whichever way the stage is
    reached, and on Windows between drives.

    Args:
        file: an existing file.
        stage: the stage, which need not exist.

    Returns:
        The path with slashes, in the form that USD takes for relative to the stage: starting with a dot.
    """
    try:
        relative = os.path.relpath(file, stage.parent)
    except ValueError:  # they are on two drives
        return _absolute(file)
    # Programs may have followed the links in the stage's own path, or not.
    reached = os.path.join(os.path.realpath(stage.parent), relative)
    if not _is_same(os.path.normpath(reached), file):
        return _absolute(file)
    relative = relative.replace(os.sep, "/")
    return relative if relative.startswith("../") else f"./{relative}"


def _absolute(file: Path) -> str:
    return os.path.abspath(file).replace(os.sep, "/")


def _is_same(path: str, file: Path) -> bool:
    try:
        return os.path.samefile(path, file)
    except OSError:
        return False
