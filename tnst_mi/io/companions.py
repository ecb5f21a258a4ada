"""Frames of formats that hold one grid in a file (.vol and .uni): the others are in files beside it.

The density of a frame is in `NAME_0012.uni`, its velocity in `NAME_velocity_0012.uni` (or `NAME_vel_0012.uni`), its
obstacle in `NAME_obstacle_0012.uni` (or `NAME_flags_0012.uni`). Where the first name has the word `density` in it, as
Blender's do, the other word takes its place: `density_0012.uni`, `vel_0012.uni`, `flags_0012.uni`.
"""

from __future__ import annotations

import re
from pathlib import Path

VELOCITY, OBSTACLE = ("velocity", "vel"), ("obstacle", "flags")

_DENSITY = re.compile(r"(?<![A-Za-z])density(?![A-Za-z])")
_COMPANION = re.compile(rf"(?<![A-Za-z])({'|'.join(VELOCITY + OBSTACLE)})(?![A-Za-z])")


def companion(file: Path, word: str) -> Path:
    """The file beside that of a density which holds the grid called `word`."""
    if _DENSITY.search(file.stem):
        return file.with_stem(_DENSITY.sub(word, file.stem, count=1))
    number = re.search(r"\d*$", file.stem)[0]
    name = file.stem.removesuffix(number)
    if number:
        return file.with_stem(f"{name}{'' if name.endswith(('_', '.', '-')) or not name else '_'}{word}_{number}")
    return file.with_stem(f"{name}_{word}")


def found_companion(file: Path, words: tuple[str, ...]) -> Path | None:
    """The first of the companions called one of the words that exists, or None."""
    return next((path for path in (companion(file, word) for word in words) if path.is_file()), None)


def densities(files: list[Path]) -> list[Path]:
    """Those of the files of a folder that hold densities: those called so, or all that are no companions."""
    named = [file for file in files if _DENSITY.search(file.stem)]
    return named or [file for file in files if not _COMPANION.search(file.stem)] or files
