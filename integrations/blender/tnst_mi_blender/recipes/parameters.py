"""The keys of a recipe as a panel shows them, from parameters.json, which is made of the recipe's own documentation."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

#: Written by scripts/build_blender_addon.py from `tnst_mi.recipe.parameters`.
FILE = Path(__file__).with_name("parameters.json")


@dataclass(frozen=True)
class Parameter:
    """A key of a recipe: a row of `tnst_mi.recipe.parameters`, which says more of each.

    Attributes:
        key: as in a recipe file.
        section: "Goals", "Method", "Colouring", "Resources" or "Reading".
        kind: "number", "integer", "switch", "choice", "text", "texts", "range", "layers", "point", "length", "names" or
            "other".
        default: the value without a recipe, as JSON has it; None for "not set".
        low: least value of a number; None if there is none.
        high: largest value of a number; None if there is none.
        above: what a number has to exceed; None if nothing.
        odd: whether an integer must be odd.
        words: texts that may stand in place of a number, such as "auto".
        choices: those of a choice.
        placeholder: the value in short, as the command line has it, such as "NUMBER|auto".
        expected: what a value has to be, in words.
        help: what it does.
        keyable: whether it may change over the frames.
    """

    key: str
    section: str
    kind: str
    default: Any
    low: float | None
    high: float | None
    above: float | None
    odd: bool
    words: tuple[str, ...]
    choices: tuple[str, ...]
    placeholder: str
    expected: str
    help: str
    keyable: bool


@functools.cache
def parameters() -> dict[str, Parameter]:
    """All keys of a recipe by their names, in their order."""
    rows = json.loads(FILE.read_text("utf-8"))
    return {
        row["key"]: Parameter(**row | {"words": tuple(row["words"]), "choices": tuple(row["choices"])}) for row in rows
    }
