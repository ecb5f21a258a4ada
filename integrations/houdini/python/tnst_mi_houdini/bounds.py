"""Whether values are what a recipe may have, as far as the table of its keys tells; of the rest, tnst-mi is the judge.

Asked before the input is written, which may take an hour.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

try:
    import tomllib
except ImportError:  # before Python 3.11: tnst-mi will say it
    tomllib = None

#: The keys of which a recipe needs one.
_GOALS = ("style", "tag", "semantic", "content", "match", "target")


class BadValue(ValueError):
    """A parameter holds what no recipe can; the message is one line with the remedy."""


def require_goal(values: Mapping[str, Any]) -> None:
    """Check that there is something to stylize towards.

    Raises:
        BadValue: there is not.
    """
    if not any(values.get(key) for key in _GOALS):
        raise BadValue("nothing to stylize towards; add a style picture, or a motif by its name, in the folder Goals")


def require_allowed(about: Mapping[str, Any], value: Any) -> None:
    """Check the numbers of a key.

    Args:
        about: what the table says of the key.
        value: a number, several, a word, or one of these by frame.

    Raises:
        BadValue: one is out of its bounds.
    """
    for each in value.values() if isinstance(value, Mapping) else [value]:
        numbers = each if isinstance(each, list) else [each]
        if about["kind"] not in ("number", "integer", "range") or isinstance(numbers[0], str):
            continue
        ordered = about["kind"] != "range" or numbers == sorted(numbers)
        if not ordered or not all(_is_within(about, number) for number in numbers):
            shown = ", ".join(f"{number:g}" for number in numbers)
            raise BadValue(f"{about['key']} = {shown}: expected {about['expected']}")


def require_toml(key: str, text: str) -> None:
    """Check that a text is one value of TOML.

    Raises:
        BadValue: it is not.
    """
    if tomllib is None:
        return
    try:
        keys = list(tomllib.loads(f"{key} = {text}\n"))
    except tomllib.TOMLDecodeError as error:
        raise BadValue(f"{key}: is no value of TOML ({error}); docs/regions.md has examples") from None
    if keys != [key]:
        raise BadValue(f"{key}: has also {', '.join(keys[1:])}, expected one value of TOML")


def _is_within(about: Mapping[str, Any], number: float) -> bool:
    low, high, above = about["low"], about["high"], about["above"]
    return (
        (low is None or number >= low)
        and (high is None or number <= high)
        and (above is None or number > above)
        and (not about["odd"] or number % 2 == 1)
    )
