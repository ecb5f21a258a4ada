"""Values as TOML, for recipes: text, numbers, switches, lists and tables, each key on one line."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def assignment(key: str, value: Any) -> str:
    """A line that gives a key a value.

    Raises:
        ValueError: TOML has no such value.

    Example:
        >>> assignment("gamma", {49: 0.1, 72: 1.0})
        'gamma = {49 = 0.1, 72 = 1.0}'
    """
    return f"{key if _BARE.fullmatch(key) else _text(key)} = {_value(value)}"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, int):
        return str(int(value))
    if isinstance(value, float) and math.isfinite(value):
        return repr(float(value))  # also of numpy's, which are shown with their type
    if isinstance(value, Mapping):
        return "{" + ", ".join(assignment(str(key), entry) for key, entry in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    raise ValueError(f"{value!r}: expected text, a number that is finite, a switch, a list or a table")


def _text(text: str) -> str:
    """Text in quotes: TOML's escapes are those of JSON, except that it has DEL escaped too, and no lone surrogates."""
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise ValueError(f"{text!r}: is no Unicode text; rename what it names")
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")
