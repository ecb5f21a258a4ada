"""Values of the recipe's keys as they are typed into the panel."""

from __future__ import annotations

import json
from typing import Any

import bpy

from ..problems import CannotStylizeError
from .parameters import Parameter, parameters

#: Kinds of keys whose value is a text as it stands.
_TEXTS = ("text", "names", "length")


def fill_in(override: bpy.types.PropertyGroup, key: str) -> None:
    """Make an override one of a key, with the key's default."""
    default, kind = parameters()[key].default, parameters()[key].kind
    override.key, override.name = key, key
    if kind == "switch":
        override.switch = bool(default)
    elif kind == "choice":
        override.choice = default or parameters()[key].choices[0]
    else:
        override.text = default if isinstance(default, str) else "" if default is None else json.dumps(default)


def keys_of(overrides: bpy.types.bpy_prop_collection) -> dict[str, Any]:
    """The keys that overrides set, with their values.

    Raises:
        CannotStylizeError: there is no such key, or a value is none that the key can have.
    """
    known = parameters()
    for each in overrides:
        if each.key not in known:
            raise CannotStylizeError(f"Advanced, {each.key}: no such key in this version; remove it from the list")
    return {each.key: _value(each, known[each.key]) for each in overrides}


def _value(override: bpy.types.PropertyGroup, parameter: Parameter) -> Any:
    if parameter.kind == "switch":
        return override.switch
    if parameter.kind == "choice":
        return override.choice
    text = override.text.strip()
    value = text if parameter.kind in _TEXTS or text in (*parameter.words, *parameter.choices) else _parsed(text)
    if value in ("", None) or not _allowed(value, parameter):
        raise CannotStylizeError(f"Advanced, {override.key} = {text or 'nothing'}: expected {parameter.expected}")
    return value


def _parsed(text: str) -> Any:
    """What JSON makes of a text: a number, a list, a table; None if it is none of these."""
    try:
        return json.loads(text)
    except ValueError:
        return None


def _allowed(value: Any, parameter: Parameter) -> bool:
    """Whether a number is one that a key can have; of other values, tnst-mi is the judge."""
    named = (*parameter.words, *parameter.choices)
    if parameter.kind not in ("number", "integer") or isinstance(value, dict) or value in named:
        return True
    if isinstance(value, bool) or not isinstance(value, int if parameter.kind == "integer" else (int, float)):
        return False
    low, high, above = parameter.low, parameter.high, parameter.above
    return (low is None or value >= low) and (high is None or value <= high) and (above is None or value > above)
