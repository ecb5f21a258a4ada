"""Which files are the frames of an INPUT: a file, a folder, a folder that a program made, or a pattern."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.io.files.companions import companions_of, densities
from tnst_mi.io.files.folders import frame_files, frame_folder
from tnst_mi.io.files.frame_numbers import Number, NumberedName, missing, numbered, pattern_of
from tnst_mi.io.files.patterns import is_pattern, matches
from tnst_mi.io.formats import GRID_FORMATS, READABLE, require_format
from tnst_mi.machine.terminal import some_of
from tnst_mi.resources import expanded

#: A file with its name taken apart.
_Named = tuple[Path, NumberedName]

#: Of longer lists, so many entries are shown.
_SHOWN = 3


class SeveralSequencesError(InputError):
    """An input has several sequences, of which one has to be chosen.

    Attributes:
        patterns: one for each, by which it can be chosen.
    """

    def __init__(self, message: str, patterns: Sequence[Path]) -> None:
        super().__init__(message)
        self.patterns = tuple(patterns)


@dataclass(frozen=True)
class Listing:
    """The files of the frames of an input.

    Attributes:
        files: of the densities, in the order of their numbers.
        numbers: of these; None for a single file without one.
        sequence: the density files of the whole sequence, which `files` may be a part of, with their numbers.
        velocities: in the layout of the paper's authors, the folder of the velocities.
        notes: what was decided and what was left, to be said.
    """

    files: list[Path]
    numbers: list[Number | None]
    sequence: dict[Path, Number | None]
    velocities: Path | None
    notes: tuple[str, ...]


def list_frames(path: Path, span: tuple[Number, Number] | None = None) -> Listing:
    """List the frames of an input without reading them.

    Args:
        path: a file (one frame), a folder, or a pattern.
        span: the first and the last number to take, both included; floats take the sub-frames between them too. None
            takes all whole frames, or all sub-frames if there are no others.

    Raises:
        InputError: nothing is there, the format is unknown, there are several sequences, or numbers are missing, are
            there more than once, or are not those that `span` asks for.
    """
    path = expanded(path)
    if path.is_dir():
        folder = frame_folder(path, READABLE)
        named, left = _density_files(frame_files(folder.path, READABLE))
        return _listing(folder.path, named, left, span, folder.notes, folder.velocities)
    if path.exists():
        require_format(path, READABLE)
        return _listing(path, [_among_its_siblings(path)], [], span)
    if is_pattern(path):
        found = matches(path, READABLE)
        kept, _ = _density_files([file for file, _ in found])
        wanted = {file for file, _ in kept}
        return _listing(path, [pair for pair in found if pair[0] in wanted], [], span)
    raise InputError(f"{path}: no such file or folder")


def _density_files(files: Sequence[Path]) -> tuple[list[_Named], list[Path]]:
    """The files that hold densities, and the others."""
    kept = []
    for suffix in READABLE:
        of_format = [file for file in files if file.suffix.lower() == suffix]
        kept += _named(densities(of_format, suffix in GRID_FORMATS))
    taken = {path for file, _ in kept for path in (file, *companions_of(file))}
    return kept, [file for file in files if file not in taken]


def _named(files: Sequence[Path]) -> list[_Named]:
    return list(zip(files, numbered([file.stem for file in files]), strict=True))


def _among_its_siblings(path: Path) -> _Named:
    """A file with its number, which the names of the other files in its folder help to tell."""
    siblings = [file for file in frame_files(path.absolute().parent, (path.suffix.lower(),)) if file.name != path.name]
    return path, numbered([path.stem, *(file.stem for file in siblings)])[0]


def _listing(
    source: Path,
    named: Sequence[_Named],
    left: Sequence[Path],
    span: tuple[Number, Number] | None,
    notes: tuple[str, ...] = (),
    velocities: Path | None = None,
) -> Listing:
    """The frames among files with densities."""
    if len(named) > 1:
        unnumbered = [file for file, name in named if name.number is None]
        named = [pair for pair in named if pair[1].number is not None]
        if not named:
            raise InputError(f"{source}: no file name has a frame number (such as frame_0012.npz)")
        left = [*left, *unnumbered]
        _require_one_series(source, named)
    ordered = sorted(named, key=lambda pair: (pair[1].number or 0, pair[0].name))
    chosen = _selected(ordered, span)
    _require_complete(source, chosen)
    remarks = [*notes, *_left_alone(left), *_in_doubt(chosen)]
    if span is None and len(chosen) < len(ordered):
        remarks.append(_of_sub_frames([name.number for _, name in ordered if name.number is not None]))
    of_chosen = [name.number for _, name in chosen]
    sequence = {file: name.number for file, name in ordered}
    return Listing([file for file, _ in chosen], of_chosen, sequence, velocities, tuple(remarks))


def _require_one_series(source: Path, named: Sequence[_Named]) -> None:
    series = _by_series(named)
    if len(series) == 1:
        return
    spans = [f"{pattern} ({_span(numbers)})" for pattern, numbers in series.items()]
    folder = source if source.is_dir() else source.parent
    patterns = [folder / pattern for pattern in series]
    raise SeveralSequencesError(
        f"{source}: has {len(series)} sequences: {some_of(spans)}; give one as a pattern, such as '{patterns[0]}'",
        patterns,
    )


def _by_series(named: Iterable[_Named]) -> dict[str, list[Number]]:
    """The numbers of each series, by its pattern; a format is a series of its own if it repeats numbers of another."""
    alike: dict[tuple[str, str], list[_Named]] = defaultdict(list)
    for pair in named:
        alike[pair[1].series].append(pair)
    series: dict[str, list[Number]] = {}
    for pairs in alike.values():
        by_format: dict[str, list[_Named]] = defaultdict(list)
        for pair in pairs:
            by_format[pair[0].suffix.lower()].append(pair)
        counted = [number for group in by_format.values() for number in {name.number for _, name in group}]
        for group in by_format.values() if len(set(counted)) < len(counted) else [pairs]:
            pattern = pattern_of(name for _, name in group) + group[0][0].suffix
            series[pattern] = sorted(name.number for _, name in group if name.number is not None)
    return series


def _span(numbers: Sequence[Number]) -> str:
    return f"{numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else f"{numbers[0]}"


def _selected(named: Sequence[_Named], span: tuple[Number, Number] | None) -> list[_Named]:
    """The files, sorted by number, that a span takes; without one, whole frames if there are any."""
    if span is None:
        return [pair for pair in named if not isinstance(pair[1].number, float)] or list(named)
    first, last = span
    wanted = f"frames = '{first}:{last}'"
    numbers = [name.number for _, name in named if name.number is not None]
    if len(numbers) < len(named):
        raise InputError(f"{wanted}: the name of {named[0][0]} has no frame number; leave out the frames")
    with_sub_frames = isinstance(first, float) or isinstance(last, float)
    chosen = [
        pair
        for pair, number in zip(named, numbers, strict=True)
        if first <= number <= last and (with_sub_frames or not isinstance(number, float))
    ]
    if not chosen or (chosen[0][1].number, chosen[-1][1].number) != (first, last):
        there = f"frame {numbers[0]}" if len(numbers) == 1 else f"frames {_span(numbers)}"
        raise InputError(f"{wanted}: the input has the {there}, and both ends must be there")
    return chosen


def _require_complete(source: Path, named: Sequence[_Named]) -> None:
    """Check that no frame number is repeated and none is missing in between."""
    numbers = [name.number for _, name in named if name.number is not None]
    double = next((before for before, after in itertools.pairwise(numbers) if before == after), None)
    if double is not None:
        names = ", ".join(file.name for file, name in named if name.number == double)
        raise InputError(f"{source}: frame {double} is there more than once: {names}")
    gaps = missing(numbers)
    if gaps:
        shown = ", ".join(f"{gap}" for gap in gaps[:10]) + (", …" if len(gaps) > 10 else "")
        raise InputError(f"{source}: frames are missing between {numbers[0]} and {numbers[-1]}: {shown}")


def _left_alone(files: Sequence[Path]) -> list[str]:
    if not files:
        return []
    series: dict[str, None] = {}
    for suffix in dict.fromkeys(file.suffix for file in files):
        groups: dict[tuple[str, str], list[NumberedName]] = defaultdict(list)
        for _, name in _named([file for file in files if file.suffix == suffix]):
            groups[name.series].append(name)
        series |= dict.fromkeys(pattern_of(names) + suffix for names in groups.values())
    return [f"left alone in {files[0].parent}: {some_of(list(series))}"]


def _in_doubt(chosen: Sequence[_Named]) -> list[str]:
    """How to read numbers otherwise that may as well be others; of the first file, as an example of all."""
    for file, name in chosen:
        if name.otherwise is not None:
            pattern, number = name.otherwise
            whole = file.with_name(pattern + file.suffix)
            return [f"{file.name} is taken as frame {name.number}; if it is frame {number}, give '{whole}'"]
    return []


def _of_sub_frames(numbers: Sequence[Number]) -> str:
    left = [number for number in numbers if isinstance(number, float)]
    shown = ", ".join(map(str, left[:_SHOWN])) + (", …" if len(left) > _SHOWN else "")
    every = f"{float(numbers[0])}:{float(numbers[-1])}"
    return f"sub-frames are left out: {shown}; numbers with a decimal point take them, as in frames = '{every}'"
