"""Files with one grid each: beside the file of a frame's density lie those of its velocity and its obstacle.

The density of a frame is in `NAME_0012.uni`, its velocity in `NAME_velocity_0012.uni` (or `NAME_vel_0012.uni`, …), its
obstacle in `NAME_obstacle_0012.uni` (or `NAME_flags_0012.uni`, …). If the density's name contains the word `density`,
as Blender's do, the other word replaces it: `density_0012.uni`, `vel_0012.uni`, `flags_0012.uni`, and so does the name
of any other grid: `temperature_0012.uni`. For files of other
programs, other words for density are replaced too (`smoke_0012.npz` beside `velocity_0012.npz`, as PhiFlow writes), and
the word may be at the end (`NAME_0012_vel.npz`). Words may also be capitalised or in upper case, extensions in upper
case. A velocity may be in three files, one for each component: `vel_x_0012.uni` and so on, or with `u`, `v`
and `w`. The noise of Blender's caches, `noise/fluid_noise_0012.vdb`, has its velocity in `data/fluid_data_0012.vdb`.
"""

from __future__ import annotations

import glob
import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from tnst_mi.io.interpretation.grid_names import DENSITY, SMOKE

#: Words for the grids, the one that we write first.
VELOCITY, OBSTACLE = ("velocity", "vel", "v"), ("obstacle", "flags", "solid")


def _words(*words: str) -> re.Pattern[str]:
    """Any of some words that stand alone in a name, perhaps with a number that follows; single letters without."""
    spellings = "|".join(word if len(word) > 1 else rf"{word}(?!\d)" for word in words)
    return re.compile(rf"(?<![A-Za-z])({spellings})(?![A-Za-z])", re.IGNORECASE)


_DENSITY = _words("density")
_OTHER_DENSITY = _words(*(word for word in (*DENSITY, *SMOKE) if word != "density"))
_COMPANION = _words(*VELOCITY, *OBSTACLE, "(?:velocity|vel|v)[xyz]", "[uw]")
#: Grids of a simulation that neither are density nor belong to a frame.
_OTHER_WORDS = ("temperature", "temp", "heat", "fuel", "flame", "react", "pressure", "shadow", "burn", "phi", "cd")
_OTHER_GRID = _words(*_OTHER_WORDS)
#: What such a grid can be called in the name of a file.
_NAME = "[A-Za-z]+(?:_[A-Za-z]+)*"


def companion(file: Path, word: str) -> Path:
    """The companion of a density file that we write, which holds the grid called `word`."""
    before, after = _around_the_word(file.stem)
    return file.with_stem(f"{before}{word}{after}")


def possible_companions(file: Path, words: tuple[str, ...] = VELOCITY + OBSTACLE) -> list[Path]:
    """All paths at which we write companions of a density file, in any spelling, in order of preference."""
    before, after = _around_the_word(file.stem)
    return _spelled(file, [f"{before}{{}}{after}"], words)


def found_companion(file: Path, words: tuple[str, ...]) -> Path | None:
    """The first existing companion for any of the words, of whatever program, or None."""
    possible = [*_all_possible(file, words), simulation_of(file) if words == VELOCITY else None]
    return next((path for path in possible if path is not None and path.is_file()), None)


def found_velocity(file: Path, words: tuple[str, ...] = VELOCITY) -> tuple[Path, ...]:
    """The existing files of a density's velocity, of whatever program: one, or those of its three components, or none.

    Args:
        file: of the density.
        words: for the velocity.
    """
    whole, components = found_companion(file, words), _found_components(file, words)
    # What is called v is the velocity, but beside u and w it is a component.
    if components and (whole is None or whole in components):
        return components
    return () if whole is None else (whole,)


def simulation_of(noise: Path) -> Path | None:
    """The file with the simulation to which Blender has added noise, or would be; None if this is no such noise."""
    number = re.fullmatch(r"fluid_noise_(\d+)", noise.stem)
    if number is None or noise.suffix != ".vdb":
        return None
    return noise.parent.parent / "data" / f"fluid_data_{number[1]}.vdb"


def companions_of(file: Path) -> list[Path]:
    """The existing files beside that of a density from which its velocity and its obstacle may be read."""
    return [path for group in companion_groups(file) for path in group]


def companion_groups(file: Path) -> list[tuple[Path, ...]]:
    """The same, those of a velocity's components together."""
    obstacle = found_companion(file, OBSTACLE)
    return [group for group in (found_velocity(file), () if obstacle is None else (obstacle,)) if group]


def densities(files: Sequence[Path], one_grid_each: bool) -> list[Path]:
    """The files of a folder that hold densities.

    Args:
        files: all files of one format.
        one_grid_each: whether each file of this format holds one grid. Then only files with `density` in their names
            count, if there are any; files that may hold whole frames are left out only if their names are those of
            another grid.
    """
    beside = {path for file in files for path in _all_possible(file, VELOCITY + OBSTACLE)}
    if one_grid_each:
        beside |= {path for file in files for path in possible_companions(file, _OTHER_WORDS)}
    alone = [file for file in files if file not in beside]
    named = [file for file in alone if one_grid_each and _DENSITY.search(file.stem)]
    others = (_COMPANION,) if one_grid_each else (_COMPANION, _OTHER_GRID)
    smoke = [
        file for file in alone if _DENSITY.search(file.stem) or not any(other.search(file.stem) for other in others)
    ]
    return named or smoke or alone


def names_a_file(density: str, grid: str) -> bool:
    """Whether a grid beside a density, in a file of this name, is found again in one that its own name is a part of."""
    if not re.fullmatch(_NAME, grid) or _COMPANION.search(grid) or _DENSITY.search(grid):
        return False
    return _DENSITY.search(density) is not None or _OTHER_GRID.fullmatch(grid) is not None


def other_grids_of(file: Path) -> dict[str, Path]:
    """The existing files beside that of a density with grids besides its velocity and its obstacle, by their names."""
    before, after = _around_the_word(file.stem)
    form = re.compile(rf"{re.escape(before)}({_NAME}){re.escape(after)}")
    found = {}
    for path in sorted(file.parent.glob(f"{glob.escape(before)}*{glob.escape(after + file.suffix)}")):
        match = form.fullmatch(path.stem)
        if match and path != file and path.is_file() and names_a_file(file.stem, match[1]):
            found[match[1]] = path
    return found


def numberless(file: Path) -> str:
    """The name of a file with # for its digits, which is the same for all frames of a sequence."""
    return re.sub(r"\d", "#", file.name)


def all_numberless(files: Sequence[Path]) -> str:
    """The names of some files without their numbers, in one text."""
    return ", ".join(numberless(file) for file in files)


def _all_possible(file: Path, words: tuple[str, ...]) -> list[Path]:
    """All paths at which companions of a density file are looked for, in order of preference."""
    return _spelled(file, _forms(file), words)


def _forms(file: Path) -> list[str]:
    """The names that companions of a density file may have, with {} for the word."""
    before, after = _around_the_word(file.stem)
    forms = [f"{before}{{}}{after}"]
    for match in _OTHER_DENSITY.finditer(file.stem):
        forms.append(f"{file.stem[: match.start()]}{{}}{file.stem[match.end() :]}")
    return [*forms, f"{file.stem}_{{}}"]


def _found_components(file: Path, words: tuple[str, ...]) -> tuple[Path, ...]:
    """The existing files of the three components of a density's velocity, or none."""
    for names in _component_names(words):
        for form in _forms(file):
            before, _, after = form.partition("{}")
            if all(file.with_name(f"{before}{name}{after}{file.suffix}").is_file() for name in names):
                return tuple(file.with_name(f"{before}{name}{after}{file.suffix}") for name in names)
    return ()


def _component_names(words: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """What components may be called, in threes, in order of preference: `vel_x`, `velX`, `VEL.X`, `x_vel`, `u`, …"""
    for word in words:
        for spelling in dict.fromkeys((word, word.capitalize(), word.upper())):
            for axes, separator in itertools.product(("xyz", "XYZ"), ("_", "", ".")):
                yield tuple(f"{spelling}{separator}{axis}" for axis in axes)
            yield tuple(f"{axis}_{spelling}" for axis in "xyz")
    if "v" in words:
        yield from (("u", "v", "w"), ("U", "V", "W"))


def _spelled(file: Path, forms: Sequence[str], words: tuple[str, ...]) -> list[Path]:
    """The paths beside a file in whose names the {} of a form is one of some words, in any spelling."""
    spellings = [spelling for word in words for spelling in (word, word.capitalize(), word.upper())]
    endings = dict.fromkeys((file.suffix, file.suffix.lower(), file.suffix.upper()))
    parts = [form.partition("{}") for form in forms]
    return [
        file.with_name(f"{before}{spelling}{after}{ending}")
        for before, _, after in parts
        for spelling in dict.fromkeys(spellings)
        for ending in endings
    ]


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
