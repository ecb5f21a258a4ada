"""Frames in formats with one grid per file (.vol and .uni): the other grids are in companion files beside it.

The density of a frame is in `NAME_0012.uni`, its velocity in `NAME_velocity_0012.uni` (or `NAME_vel_0012.uni`), its
obstacle in `NAME_obstacle_0012.uni` (or `NAME_flags_0012.uni`). If the density's name contains the word `density`,
as Blender's do, the other word replaces it: `density_0012.uni`, `vel_0012.uni`, `flags_0012.uni`. Words may also be
capitalised or in upper case, extensions in upper case.
"""

from __future__ import annotations

import re
from pathlib import Path

VELOCITY, OBSTACLE = ("velocity", "vel"), ("obstacle", "flags")

_DENSITY = re.compile(r"(?<![A-Za-z])density(?![A-Za-z])", re.IGNORECASE)
_COMPANION = re.compile(rf"(?<![A-Za-z])({'|'.join(VELOCITY + OBSTACLE)})(?![A-Za-z])", re.IGNORECASE)


def companion(file: Path, word: str) -> Path:
    """The companion of a density file that holds the grid called `word`."""
    before, after = _around_the_word(file.stem)
    return file.with_stem(f"{before}{word}{after}")


def possible_companions(file: Path, words: tuple[str, ...] = VELOCITY + OBSTACLE) -> list[Path]:
    """All paths at which companions of a density file are looked for, for each of the words, in order of preference."""
    spellings = [spelling for word in words for spelling in (word, word.capitalize(), word.upper())]
    endings = dict.fromkeys((file.suffix, file.suffix.lower(), file.suffix.upper()))
    before, after = _around_the_word(file.stem)
    return [file.with_name(f"{before}{spelling}{after}{ending}") for spelling in spellings for ending in endings]


def found_companion(file: Path, words: tuple[str, ...]) -> Path | None:
    """The first existing companion for any of the words, or None."""
    return next((path for path in possible_companions(file, words) if path.is_file()), None)


def densities(files: list[Path]) -> list[Path]:
    """The files of a folder that hold densities.

    Of the files that are not companions of another, these are the ones with `density` in their names; failing that,
    those without a companion word; failing that, as in a sequence called "obstacle", all of them.
    """
    beside = {path for file in files for path in possible_companions(file)}
    alone = [file for file in files if file not in beside]
    named = [file for file in alone if _DENSITY.search(file.stem)]
    return named or [file for file in alone if not _COMPANION.search(file.stem)] or alone


def _around_the_word(stem: str) -> tuple[str, str]:
    """The parts of a companion's name before and after the word."""
    match = _DENSITY.search(stem)
    if match:
        return stem[: match.start()], stem[match.end() :]
    name = re.sub(r"\d+$", "", stem)
    number = stem.removeprefix(name)
    if number:
        return name if name.endswith(("_", ".", "-")) or not name else f"{name}_", f"_{number}"
    return f"{name}_", ""
