"""Recipes as text: TOML with the keys that are given, for tnst-mi to read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .toml import assignment


class Typed(str):
    """TOML, as somebody has typed it."""


def recipe_text(values: Mapping[str, Any], heading: str = "") -> str:
    """A recipe as a TOML file.

    Args:
        values: by key: numbers, texts, lists, tables, or `Typed`.
        heading: a comment of one line above them.

    Raises:
        ValueError: TOML has no such value.

    Example:
        >>> print(recipe_text({"style": ["fire.png"], "mask": Typed("{height = [0, 1]}  # low")}), end="")
        style = ["fire.png"]
        mask = {height = [0, 1]}  # low
    """
    lines = [f"# {' '.join(heading.split())}"] if heading else []
    lines += [
        f"{key} = {value}" if isinstance(value, Typed) else assignment(key, value) for key, value in values.items()
    ]
    return "".join(f"{line}\n" for line in lines)
