"""Patterns as INPUT: the files of a sequence by one name, with a place for the frame number or with wildcards.

`smoke.####.vdb`, `smoke_%04d.vdb`, `smoke.$F4.vdb` (Houdini), `smoke.<F4>.vdb` and `smoke.{frame}.vdb` say where the
number is; it may have any number of digits, a sign and a fraction. `*`, `?` and `[…]` stand for anything, one
character, and one of some characters. Patterns are of file names, not of folders.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.io.files.frame_numbers import NumberedName, numbered, plain_number

_PLACE = re.compile(r"#+|%0?\d*d|\$F+\d*|\$\{F+\d*\}|<(?:F\d*|frame)>|\{(?:frame|F)[^{}]*\}", re.IGNORECASE)
_WILDCARD = re.compile(r"\*|\?|\[!?[^\]]+\]")
_TILE = re.compile(r"<u(?:dim|vtile)>|%\(udim\)d", re.IGNORECASE)
_NUMBER = r"(?P<number>(?P<whole>-?[0-9]+)(?:\.[0-9]+)?)"


def is_pattern(path: Path) -> bool:
    """Whether a path that does not exist is a pattern."""
    return any(found.search(path.name) for found in (_PLACE, _WILDCARD, _TILE))


def matches(pattern: Path, suffixes: Sequence[str]) -> list[tuple[Path, NumberedName]]:
    """The files that a pattern matches, whose extensions are among some, with the numbers of their names.

    Raises:
        InputError: the pattern cannot be used, its folder does not exist, or it matches no file.
    """
    if _TILE.search(pattern.name):
        raise InputError(
            f"{pattern}: <UDIM> counts the tiles of a texture, expected a place for the frame number, such as ####"
        )
    places = _PLACE.findall(pattern.name)
    if len(places) > 1:
        raise InputError(f"{pattern}: has {len(places)} places for numbers ({', '.join(places)}), expected one")
    if not pattern.parent.is_dir():
        raise InputError(f"{pattern}: no such folder ({pattern.parent}); a pattern is of file names, not of folders")
    try:
        expression = re.compile(_NUMBER.join(_literally(part) for part in _PLACE.split(pattern.name)))
    except re.error as error:
        raise InputError(f"{pattern}: is no pattern ({error}), expected ranges such as [0-9]") from None
    files, found = [], []
    for file in sorted(pattern.parent.iterdir()):
        # A pattern may leave out the extension.
        match = expression.fullmatch(file.name) or expression.fullmatch(file.stem)
        if match and not file.name.startswith(".") and file.suffix.lower() in suffixes and file.is_file():
            files.append(file)
            found.append(match)
    if not files:
        raise InputError(f"{pattern}: matches no file {', '.join(suffixes)} in {pattern.parent}")
    names = [_name(file, match) for file, match in zip(files, found, strict=True)] if places else None
    return list(zip(files, names or numbered([file.stem for file in files]), strict=True))


def _name(file: Path, match: re.Match[str]) -> NumberedName:
    """A name with its number where the pattern has the place for it."""
    number, digits = plain_number(Fraction(match["number"])), len(match["whole"].lstrip("-"))
    end = match.end("number")
    return NumberedName(number, file.name[: match.start("number")], file.stem[end:], digits)


def _literally(part: str) -> str:
    """A regular expression for a part of a pattern, in which only wildcards have a meaning."""
    expression, position = "", 0
    for match in _WILDCARD.finditer(part):
        expression += re.escape(part[position : match.start()]) + _meaning(match[0])
        position = match.end()
    return expression + re.escape(part[position:])


def _meaning(wildcard: str) -> str:
    if wildcard in ("*", "?"):
        return {"*": ".*?", "?": "."}[wildcard]
    # Ranges such as [0-9] keep their meaning.
    inside = re.sub(r"[^\w-]", lambda character: re.escape(character[0]), wildcard[1:-1].removeprefix("!"))
    return f"[^{inside}]" if wildcard[1] == "!" else f"[{inside}]"
