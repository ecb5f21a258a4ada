"""The values of recipe flags, from their texts: as the kind of the key reads them, or a table of keyframes.

A table is written as in a recipe file, or with colons: `{49 = 0.1, 72 = 1.0}` or `{49: 0.1, 72: 1.0}`. What
stands in it is TOML: numbers, "texts", [lists].
"""

from __future__ import annotations

import re
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.io.bounded_toml import toml_values
from tnst_mi.recipe.expectation import expectation
from tnst_mi.recipe.sections import KINDS

_KEY = re.compile(r"([{,]\s*)(-?[0-9]+)\s*:")


def value_of_flag(name: str, text: str | tuple[str, ...]) -> Any:
    """The value of a key whose flag has a text, or several if it is repeatable.

    Raises:
        InputError: the text is no such value, nor a table.
    """
    flag, shown = "--" + name.replace("_", "-"), text if isinstance(text, str) else " ".join(text)
    if shown.lstrip().startswith("{"):
        return _table(name, flag, shown)
    try:
        return KINDS[name].check(KINDS[name].read(text))
    except (ValueError, OverflowError):
        raise InputError(f"{flag} {shown}: {expectation(KINDS[name], text, name)}") from None


def _table(name: str, flag: str, text: str) -> dict[str, Any]:
    try:
        return toml_values("table = " + _KEY.sub(r"\1\2 =", text))["table"]
    except ValueError:
        # TOML that is none, a number of more digits than Python reads, or tables that are too deep.
        mask = "a table as in a recipe file, such as '{height = [0.5, 2.0]}'"
        expected = mask if name == "mask" else "a value for each frame, such as '{49: 0.1, 72: 1.0}'"
        raise InputError(f"{flag} {text}: expected {expected}") from None
