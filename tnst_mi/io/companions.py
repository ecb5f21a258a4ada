"""Frames of formats that hold one grid in a file (.vol and .uni): the others are in files beside it.

The density of a frame is in `NAME_0012.uni`, its velocity in `NAME_velocity_0012.uni` (or `NAME_vel_0012.uni`), its
obstacle in `NAME_obstacle_0012.uni` (or `NAME_flags_0012.uni`). Where the first name has the word `density` in it, as
Blender's do, the other word takes its place: `density_0012.uni`, `vel_0012.uni`, `flags_0012.uni`. Words and endings
may also be in capitals, or begin with one.
"""

from __future__ import annotations

import re
from pathlib import Path

VELOCITY, OBSTACLE = ("velocity", "vel"), ("obstacle", "flags")

_DENSITY = re.compile(r"(?<![A-Za-z])density(?![A-Za-z])", re.IGNORECASE)
_COMPANION = re.compile(rf"(?<![A-Za-z])({'|'.join(VELOCITY + OBSTACLE)})(?![A-Za-z])", re.IGNORECASE)


def companion(file: Path, word: str) -> Path:
    """The file beside that of a density which holds the grid called `word`."""
    before, after = _around_the_word(file.stem)
    return file.with_stem(f"{before}{word}{after}")


def possible_companions(file: Path, words: tuple[str, ...] = VELOCITY + OBSTACLE) -> list[Path]:
    """All names of files that are read as the companions of a density's called one of the words, best ones first."""
    spellings = [spelling for word in words for spelling in (word, word.capitalize(), word.upper())]
    endings = dict.fromkeys((file.suffix, file.suffix.lower(), file.suffix.upper()))
    before, after = _around_the_word(file.stem)
    return [file.with_name(f"{before}{spelling}{after}{ending}") for spelling in spellings for ending in endings]


def found_companion(file: Path, words: tuple[str, ...]) -> Path | None:
    """The first of the companions called one of the words that exists, or None."""
    return next((path for path in possible_companions(file, words) if path.is_file()), None)


def densities(files: list[Path]) -> list[Path]:
    """Those of the files of a folder that hold densities.

    They are those called so, or those with no word of a companion in their names; where all have one, as in a sequence
    called "obstacle", those that are beside no other.
    """
    beside = {path for file in files for path in possible_companions(file)}
    alone = [file for file in files if file not in beside]
    named = [file for file in alone if _DENSITY.search(file.stem)]
    return named or [file for file in alone if not _COMPANION.search(file.stem)] or alone


def _around_the_word(stem: str) -> tuple[str, str]:
    """What the names of a density's companions have before and after the word."""
    match = _DENSITY.search(stem)
    if match:
        return stem[: match.start()], stem[match.end() :]
    name = re.sub(r"\d+$", "", stem)
    number = stem.removeprefix(name)
    if number:
        return name if name.endswith(("_", ".", "-")) or not name else f"{name}_", f"_{number}"
    return f"{name}_", ""
