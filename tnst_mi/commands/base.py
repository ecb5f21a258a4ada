"""What the arguments of the commands share: --debug, flags derived from the keys of the recipe, views."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from tnst_mi.errors import InputError
from tnst_mi.recipe.keys import Number, Texts
from tnst_mi.recipe.recipe import KINDS, Recipe, documentation

Folder = Annotated[Path, tyro.conf.arg(metavar="FOLDER")]


@dataclass(kw_only=True)
class Arguments:
    """Arguments common to all commands of `tnst-mi`."""

    debug: bool = False
    """Show Python's traceback when something fails."""


def recipe_flag(name: str) -> Any:
    """The type of the flag for a recipe key: its text or texts; None or () if the flag is not given."""
    kind = KINDS[name]
    options = tyro.conf.arg(
        metavar=kind.placeholder,
        help=documentation()[name],
        help_behavior_hint=f"(default: {kind.show(getattr(Recipe(), name))})",
    )
    if isinstance(kind, Texts):
        return Annotated[tuple[str, ...], tyro.conf.UseAppendAction, options]
    return Annotated[str | None, options]


def recipe_flags(keys: Iterable[str]) -> type:
    """A dataclass of the flags for some keys of the recipe."""
    fields = [(key, recipe_flag(key), field(default=() if isinstance(KINDS[key], Texts) else None)) for key in keys]
    return make_dataclass("RecipeFlags", fields)


def given(flags: Any) -> dict[str, Any]:
    """The texts of the recipe flags that were given, by key."""
    return {key: text for key, text in dataclasses.asdict(flags).items() if text not in (None, ())}


def view_of(text: str) -> tuple[float, float]:
    """Parse one view of `--views`: (azimuth, elevation) in degrees.

    Raises:
        InputError: it is not such a pair.
    """
    try:
        azimuth, elevation = (Number(-360.0, 360.0).check(float(part)) for part in text.split(","))
    except ValueError:
        raise InputError(f"--views {text}: expected AZIMUTH,ELEVATION in degrees, such as -10,5") from None
    return azimuth, elevation
