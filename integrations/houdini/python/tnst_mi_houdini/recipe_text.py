"""Recipes as text: TOML with the keys that are given, for tnst-mi to read."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any


class Literal(str):
    """A text that is TOML already."""


def recipe_text(values: Mapping[str, Any], heading: str = "") -> str:
    """A recipe as a TOML file.

    Args:
        values: by key: numbers, texts, lists, tables, or `Literal` for what is TOML already.
        heading: a comment of one line above them.

    Example:
        >>> print(recipe_text({"style": ["fire.png"], "gamma": {"12": 0.1, "30": 0.5}}), end="")
        style = ["fire.png"]
        gamma = {"12" = 0.1, "30" = 0.5}
    """
    lines = [f"# {' '.join(heading.split())}"] if heading else []
    lines += [f"{key} = {_written(value)}" for key, value in values.items()]
    return "".join(f"{line}\n" for line in lines)


def _written(value: Any) -> str:
    if isinstance(value, Literal):
        return " ".join(value.split())
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(float(f"{value:.9g}"))  # what was typed, rather than the nearest double
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_quoted(str(key))} = {_written(each)}" for key, each in value.items()) + "}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(_written(each) for each in value) + "]"
    return str(value)


def _quoted(text: str) -> str:
    # JSON's strings are TOML's, but for this character.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
