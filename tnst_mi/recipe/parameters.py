"""The keys of a recipe as other programs need them to show controls: what each may be, as values that JSON can hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tnst_mi.recipe.keyframes import KEYABLE
from tnst_mi.recipe.keys import Choice, Integer, Kind, LayerWeights, Number, Range, Switch, Text, Texts
from tnst_mi.recipe.lengths import OFF, Length
from tnst_mi.recipe.name_lists import Names
from tnst_mi.recipe.optional_keys import Point, Unset
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.sections import KINDS, SECTIONS, documentation

#: The kinds of values that programs have controls for; what is none of them is written as text in TOML.
_NAMES: dict[type, str] = {
    Number: "number",
    Integer: "integer",
    Switch: "switch",
    Choice: "choice",
    Text: "text",
    Texts: "texts",
    Range: "range",
    LayerWeights: "layers",
    Point: "point",
    Length: "length",
    Names: "names",
}


def parameters() -> list[dict[str, Any]]:
    """All keys of a recipe, in the order of its file.

    Returns:
        For each key a dictionary of
        `key`;
        `section`: "Goals", "Method", "Colouring", "Resources" or "Reading";
        `kind`: "number", "integer", "switch", "choice", "text", "texts" (a list), "range" (of two numbers), "layers"
        (a table from layers to weights), "point" (three numbers), "length" (cells, or a share such as "5%"), "names"
        (one text, separated by commas), or "other" (tables of their own);
        `default`: the value without a recipe, null for what is not set;
        `low`, `high`: bounds, both allowed, or null; `above`: a bound that is not allowed itself, or null;
        `odd`: whether an integer must be odd;
        `words`: texts that may stand in place of a number; `choices`: those of a choice;
        `placeholder`, `expected`, `help`: in words, as the command line has them;
        `keyable`: whether it may change over the frames.

    Example:
        >>> from tnst_mi.recipe.parameters import parameters
        >>> gamma = next(each for each in parameters() if each["key"] == "gamma")
        >>> gamma["kind"], gamma["default"], gamma["above"], gamma["high"], gamma["words"], gamma["keyable"]
        ('number', 0.1, 0.0, 10000.0, ['auto'], True)
    """
    recipe, texts = Recipe(), documentation()
    return [
        _described(key, section.__name__, KINDS[key], getattr(recipe, key), texts[key])
        for section in SECTIONS
        for key in section.__annotations__
    ]


def _described(key: str, section: str, kind: Kind, default: Any, text: str) -> dict[str, Any]:
    """A key in words and numbers."""
    kind = kind.kind if isinstance(kind, Unset) else kind
    return {
        "key": key,
        "section": section,
        "kind": _NAMES.get(type(kind), "other"),
        "default": list(default) if isinstance(default, tuple) else default,
        **{bound: getattr(kind, bound, None) for bound in ("low", "high", "above")},
        "odd": getattr(kind, "odd", False),
        "words": list(_words(kind)),
        "choices": list(kind.options) if isinstance(kind, Choice) else [],
        "placeholder": kind.placeholder,
        "expected": kind.expected,
        "help": text,
        "keyable": key in KEYABLE,
    }


def _words(kind: Kind) -> Sequence[str]:
    """The texts that are allowed where a number is."""
    if isinstance(kind, Number):
        return kind.words
    if isinstance(kind, Integer):
        return () if kind.word is None else (kind.word,)
    return (OFF,) if isinstance(kind, Length) else ()
