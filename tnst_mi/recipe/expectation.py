"""What a value should have been, in words: the end of the message about one that cannot be used."""

from __future__ import annotations

import difflib
import re
from typing import Any

from tnst_mi.recipe.keyframes import KEYABLE
from tnst_mi.recipe.keys import Choice, Kind
from tnst_mi.recipe.optional_keys import Unset

# Two frame numbers with something else than a colon between them.
_SPAN = re.compile(r"\s*(-?\d[\d.]*?)\s*(?:-|–|,|;|\.{2,}|to|\s)\s*(-?\d[\d.]*)\s*")
_KEYFRAME = re.compile(r"\s*-?\d+\s*[=:]\s*\S")


def expectation(kind: Kind, value: Any, name: str = "") -> str:
    """The values that are allowed, and how to write what was probably meant, where the value shows it.

    Args:
        kind: of the value.
        value: the one that cannot be used; of a flag, its text.
        name: the key of the recipe.

    Example:
        >>> from tnst_mi.recipe.sections import KINDS
        >>> expectation(Choice(("thin", "medium", "thick")), "thcik")
        'expected thin, medium or thick; did you mean thick?'
        >>> expectation(KINDS["gamma"], "0=0.1,3=1.0", "gamma")
        "expected a number above 0, at most 10000; keyframes are written in braces: '{0=0.1,3=1.0}'"
    """
    return f"expected {kind.expected}{_meant(kind, value, name) if isinstance(value, str) else ''}"


def _meant(kind: Kind, value: str, name: str) -> str:
    choice = kind.kind if isinstance(kind, Unset) else kind
    if isinstance(choice, Choice):
        nearest = difflib.get_close_matches(value.lower(), choice.options, n=1)
        return f"; did you mean {nearest[0]}?" if nearest else ""
    if name == "frames" and (span := _SPAN.fullmatch(value)):
        return f"; write {span[1]}:{span[2]}"
    if name in KEYABLE and _KEYFRAME.match(value):
        return f"; keyframes are written in braces: '{{{value.strip()}}}'"
    return ""
