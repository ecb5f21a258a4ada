"""The keys of a recipe as a panel shows them, from parameters.json, which is made of the recipe's own documentation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Parameter:
    """A key of a recipe: a row of `tnst_mi.recipe.parameters`.

    Attributes:
        key: as in a recipe file.
        section: under which it is shown.
        kind: "number", "integer", "switch", "choice", "text", "texts", "range", "layers", "point" or "other".
        default: as JSON has it; None for "not set".
        low: least value of a number; None if there is none.
        high: largest value of a number; None if there is none.
        above: what a number has to exceed; None if nothing.
        words: that may stand for a number, such as "auto".
        choices: of a choice.
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
    words: tuple[str, ...]
    choices: tuple[str, ...]
    expected: str
    help: str
    keyable: bool


def parameters() -> dict[str, Parameter]:
    """All keys of a recipe by their names, in their order."""
    raise NotImplementedError
