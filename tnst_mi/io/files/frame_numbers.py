"""Frame numbers: which digits in the names of files are their numbers in a sequence.

One name alone cannot tell (`shot2_v003.1001`), so the names of a folder are looked at together. Names that differ in
digits alone are compared, and of their groups of digits the number is the one that takes the most values, the last of
these if there are several. Except:

- a version, digits after a separator and a `v` (`_v003`, `.v2`), is no number;
- in `smoke.0001.50`, the last digits are the fraction of frame 1.5 if there also are whole frames (`smoke.0001`), or if
  they are fewer than those before them, which vary: a sub-frame;
- a `-` before the number is a minus if it starts the name or follows another separator (`smoke.-003`, `smoke_-3`), or
  if other files have the same name without it (`smoke-003` beside `smoke003`); else it separates (`smoke-003` alone).
"""

from __future__ import annotations

import itertools
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

#: Number of a frame: whole, or that of a sub-frame, a float.
Number = int | float

_SEPARATORS = "._- "
_VERSION = re.compile(rf"[{re.escape(_SEPARATORS)}][vV]$")


@dataclass(frozen=True)
class NumberedName:
    """A name without extension, and its number.

    Attributes:
        number: of the frame; None if the name has none.
        before, after: the name around the digits and the sign of the number. Names that agree in both are of one
            series.
        digits: how many digits the whole part of the number has.
    """

    number: Number | None
    before: str
    after: str = ""
    digits: int = 0

    @property
    def series(self) -> tuple[str, str]:
        """What the names of one series have in common."""
        return self.before, self.after


@dataclass(frozen=True)
class _Name:
    """A name taken apart: texts[0] runs[0] texts[1] runs[1] … texts[-1], without signs that can be nothing else."""

    texts: tuple[str, ...]
    runs: tuple[str, ...]
    negative: tuple[bool, ...]

    def joined(self, first: int, last: int) -> str:
        """The part of the name from one text to another, signs included."""
        pieces = []
        for index in range(first, last + 1):
            pieces.append(self.texts[index])
            if index < last:
                pieces += ["-" if self.negative[index] else "", self.runs[index]]
        return "".join(pieces)


def numbered(names: Sequence[str]) -> list[NumberedName]:
    """Find the number of each name, given all names of a folder, without extensions.

    Example:
        >>> [found.number for found in numbered(["smoke_v003.1001", "smoke_v003.1002"])]
        [1001, 1002]
        >>> [found.number for found in numbered(["smoke.-0001", "smoke.0000", "smoke.0000.50"])]
        [-1, 0, 0.5]
    """
    parts = [_taken_apart(name) for name in names]
    alike: dict[tuple[str, ...], list[_Name]] = defaultdict(list)
    for part in parts:
        alike[part.texts].append(part)
    fractions = {texts for texts, group in alike.items() if _are_sub_frames(group, alike)}
    places = {texts: _place_of_number(group) for texts, group in alike.items() if texts not in fractions}
    found = [_sub_frame(part) if part.texts in fractions else _numbered_at(part, places[part.texts]) for part in parts]
    return _with_signs_of_words(found)


def step_of(numbers: Sequence[Number]) -> Number:
    """The largest step by which all of some ascending numbers can be counted; 1 for fewer than two.

    Example:
        >>> step_of([10, 12, 16]), step_of([1, 1.5, 2]), step_of([3])
        (2, 0.5, 1)
    """
    exact = [_exact(number) for number in numbers]
    differences = [after - before for before, after in itertools.pairwise(exact) if after > before]
    if not differences:
        return 1
    unit = math.lcm(*(difference.denominator for difference in differences))
    return plain_number(Fraction(math.gcd(*(int(difference * unit) for difference in differences)), unit))


def is_next(number: Number, following: Number, step: Number) -> bool:
    """Whether a number comes one step after another, counted exactly."""
    return _exact(number) + _exact(step) == _exact(following)


def missing(numbers: Sequence[Number], most: int = 11) -> list[Number]:
    """The numbers, at most so many, that are missing between ascending ones that are counted by `step_of` them."""
    step, there, gaps = _exact(step_of(numbers)), {_exact(number) for number in numbers}, []
    for before, after in itertools.pairwise(numbers):
        number = _exact(before) + step
        while number < _exact(after) and number not in there and len(gaps) < most:
            gaps.append(plain_number(number))
            number += step
    return gaps


def _exact(number: Number) -> Fraction:
    """A number as it is written in a name: floats of sub-frames are not exact."""
    return Fraction(str(number))


def plain_number(number: Fraction) -> Number:
    """An int where the number is whole, else a float."""
    return int(number) if number.denominator == 1 else float(number)


def pattern_of(names: Iterable[NumberedName]) -> str:
    """The names of a series as one, with a # for each digit of the number; one # where their numbers differ."""
    names = list(names)
    widths = {name.digits for name in names}
    sign = "#" * (widths.pop() if len(widths) == 1 else 1) if names[0].number is not None else ""
    return f"{names[0].before}{sign}{names[0].after}"


def _taken_apart(name: str) -> _Name:
    pieces = re.split(r"([0-9]+)", name)
    texts, runs = pieces[0::2], tuple(pieces[1::2])
    negative = []
    for index in range(len(runs)):
        text = texts[index]
        minus = text.endswith("-") and (text[-2:-1] in tuple(_SEPARATORS) or (index == 0 and text == "-"))
        negative.append(minus)
        if minus:
            texts[index] = text[:-1]
    return _Name(tuple(texts), runs, tuple(negative))


def _are_sub_frames(group: Sequence[_Name], alike: dict[tuple[str, ...], list[_Name]]) -> bool:
    """Whether the last digits of names with the same texts are fractions of the digits before them."""
    texts = group[0].texts
    if len(texts) < 3 or texts[-2:] != (".", "") or _VERSION.search(texts[-3]) or any(n.negative[-1] for n in group):
        return False
    if (*texts[:-2], "") in alike:
        return True
    shorter = all(len(name.runs[-1]) < len(name.runs[-2]) for name in group)
    return shorter and (len(group) == 1 or len({name.runs[-2] for name in group}) > 1)


def _sub_frame(name: _Name) -> NumberedName:
    number = Fraction(f"{name.runs[-2]}.{name.runs[-1]}")
    last = len(name.runs) - 2
    before = name.joined(0, last)
    return NumberedName(plain_number(-number if name.negative[last] else number), before, "", len(name.runs[last]))


def _place_of_number(group: Sequence[_Name]) -> int | None:
    """Which of the groups of digits is the number; None if there is none."""
    texts, runs = group[0].texts, range(len(group[0].runs))
    candidates = [index for index in runs if not _VERSION.search(texts[index])]
    values = {index: len({(name.negative[index], name.runs[index]) for name in group}) for index in candidates}
    return max(candidates, key=lambda index: (values[index], index), default=None)


def _numbered_at(name: _Name, place: int | None) -> NumberedName:
    if place is None:
        return NumberedName(None, name.joined(0, len(name.runs)))
    number = int(name.runs[place])
    before, after = name.joined(0, place), name.joined(place + 1, len(name.runs))
    return NumberedName(-number if name.negative[place] else number, before, after, len(name.runs[place]))


def _with_signs_of_words(names: Sequence[NumberedName]) -> list[NumberedName]:
    """Take the - of `smoke-003` for a minus where there is also a `smoke004`."""
    series = {name.series for name in names if name.number is not None}
    return [
        replace(name, number=-name.number, before=name.before[:-1])
        if name.number is not None and name.before.endswith("-") and (name.before[:-1], name.after) in series
        else name
        for name in names
    ]
