"""Frame numbers: which digits in the names of files are their numbers in a sequence.

One name alone cannot tell (`shot2_v003.1001`), so the names of a folder are looked at together. Names that differ in
digits alone are compared, and of their groups of digits the number is the one that takes the most values, the last of
these if there are several. Except:

- a version, digits after a separator and a `v` (`_v003`, `.v2`), is no number;
- in `smoke.0001.50`, the last digits are the fraction of frame 1.5, a sub-frame, if there also are whole frames
  (`smoke.0001`), if both groups vary and the last has fewer digits, or if the names count evenly as fractions (1.25,
  1.5, 1.75) and not better as whole numbers. Where one of the groups is the same in all names, either reading may be
  meant, and the other one is told;
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

#: Its digits at most, as many as the name of a file can have.
DIGITS = 255

_SEPARATORS = "._- "
_VERSION = re.compile(rf"[{re.escape(_SEPARATORS)}][vV]$")

# Names without whole frames beside them are sub-frames only if there may be so many in a frame, in so many digits.
_MOST_IN_A_FRAME, _MOST_DIGITS = 25, 3

# Fractions that decimals cut short: parts of a frame, and from how many digits on they are recognised.
_ENDLESS = ((3, 2), (6, 3))


@dataclass(frozen=True)
class NumberedName:
    """A name without extension, and its number.

    Attributes:
        number: of the frame; None if the name has none.
        before, after: the name around the digits and the sign of the number. Names that agree in both are of one
            series.
        digits: how many digits the whole part of the number has.
        otherwise: where the digits may as well mean another number, a pattern by which they do, and that number.
    """

    number: Number | None
    before: str
    after: str = ""
    digits: int = 0
    otherwise: tuple[str, Number] | None = None

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
    fractions = {texts: _are_sub_frames(group, alike) for texts, group in alike.items()}
    places = {texts: _place_of_number(group) for texts, group in alike.items()}
    found = []
    for part in parts:
        are, doubtful = fractions[part.texts]
        whole = _numbered_at(part, places[part.texts])
        if are:
            found.append(_sub_frame(part, whole if doubtful else None))
        else:
            found.append(replace(whole, otherwise=_as_pattern(_sub_frame(part))) if doubtful else whole)
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
    """A number as it is meant in a name: floats of sub-frames are not exact, and decimals cut thirds short."""
    exact = Fraction(str(number))
    size, digits = abs(exact), len(str(number).partition(".")[2])
    for parts, least in _ENDLESS:
        nearest = Fraction(round(size * parts), parts)
        # Rounded, or cut off.
        if digits >= least and nearest.denominator == parts and -5 <= (nearest - size) * 10 ** (digits + 1) < 10:
            return nearest if exact > 0 else -nearest
    return exact


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


def _are_sub_frames(group: Sequence[_Name], alike: dict[tuple[str, ...], list[_Name]]) -> tuple[bool, bool]:
    """Whether the last digits of names with the same texts are fractions of the digits before them; and whether they
    may as well be the opposite."""
    texts = group[0].texts
    if len(texts) < 3 or texts[-2:] != (".", "") or _VERSION.search(texts[-3]) or any(n.negative[-1] for n in group):
        return False, False
    if (*texts[:-2], "") in alike:
        return True, False
    shorter = all(len(name.runs[-1]) < len(name.runs[-2]) for name in group)
    if len(group) == 1:
        return shorter, False
    even = _count_evenly(group)
    befores, lasts = ({name.runs[place] for name in group} for place in (-2, -1))
    if len(befores) > 1 and len(lasts) > 1:
        return shorter or even, False
    one_after_another = len(lasts) > 1 and step_of(sorted(map(int, lasts))) == 1
    return even and (shorter or (len(lasts) > 1 and not one_after_another)), even


def _count_evenly(group: Sequence[_Name]) -> bool:
    """Whether names count as sub-frames without gaps, in steps that sub-frames have; those of each series by itself."""
    series: dict[str, list[Number]] = defaultdict(list)
    for name in group:
        found = _sub_frame(name)
        series[found.before].append(found.number or 0)
    for numbers in series.values():
        parts = math.lcm(*(_exact(number).denominator for number in numbers))
        if len(set(numbers)) < len(numbers) or parts > _MOST_IN_A_FRAME or missing(sorted(numbers)):
            return False
    return all(len(name.runs[-1]) <= _MOST_DIGITS for name in group)


def _sub_frame(name: _Name, whole: NumberedName | None = None) -> NumberedName:
    """A name as that of a sub-frame; `whole` is its other reading, if it may be meant."""
    number = Fraction(f"{name.runs[-2]}.{name.runs[-1]}")
    last = len(name.runs) - 2
    before, digits = name.joined(0, last), len(name.runs[last])
    otherwise = None if whole is None else _as_pattern(whole)
    return NumberedName(plain_number(-number if name.negative[last] else number), before, "", digits, otherwise)


def _as_pattern(name: NumberedName) -> tuple[str, Number] | None:
    """A pattern by which a name has its number, and this number; None if it has none."""
    return None if name.number is None else (f"{name.before}#{name.after}", name.number)


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


def frame_step(numbers: Sequence[int | float | None]) -> int | float:
    """How far frames with these numbers are apart, such as 2 for every second one; 1 if they have none or no order.

    Velocities in cells per frame lead from each to the next once they are multiplied by it.
    """
    counted = [number for number in numbers if number is not None]
    ascending = all(before < after for before, after in itertools.pairwise(counted))
    return step_of(counted) if ascending and len(counted) == len(numbers) else 1


def first_gap(numbers: Sequence[int | float | None]) -> tuple[int | float, int | float, int | float] | None:
    """The first two numbers that follow each other and are not as far apart as others, and the one expected between."""
    step = frame_step(numbers)
    for number, following in itertools.pairwise(numbers):
        if number is not None and following is not None and not is_next(number, following, step):
            return number, following, number + step
    return None
