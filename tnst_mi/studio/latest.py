"""The latest recipe of a studio, which another one with the same folder begins with."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import make_folder, written_whole
from tnst_mi.machine.terminal import one_line
from tnst_mi.recipe.recipe import KINDS, Recipe
from tnst_mi.studio.plain import plain_recipe

#: Its name in the folder of the studio.
LATEST = "latest.toml"


class LatestRecipe:
    """Keeps a recipe in a file.

    Args:
        out: the folder of the studio, which need not exist.
        require_own: checks that the folder is still the studio's; see `require_own`.

    Attributes:
        recipe: the latest one; the defaults if there is none that can be used.
        trouble: why there is none that can be used, in a line; None if there is, or none at all.
    """

    def __init__(self, out: Path, require_own: Callable[[], None] = lambda: None) -> None:
        self._file, self._require_own, self._complained = out / LATEST, require_own, False
        self.recipe, self.trouble = Recipe(), None
        if os.path.lexists(self._file):
            try:
                self.recipe = plain_recipe(self._file)
            except InputError as error:
                self.trouble = one_line(f"begins with the defaults, since the latest recipe cannot be used: {error}")
                self._say(f"note: {self.trouble}")

    @property
    def values(self) -> dict[str, Any]:
        """The keys of the recipe that are not as by default, nor follow from the others."""
        values = {name: _value(self.recipe, name) for name in KINDS}
        values = {name: value for name, value in values.items() if value != _value(Recipe(), name)}
        for name in list(values):
            others = {other: value for other, value in values.items() if other != name}
            if Recipe(**others) == self.recipe:
                values = others
        return values

    def keep(self, recipe: Recipe) -> None:
        """Keep a recipe, unless it is the one that is kept; which frames it is of depends on the input, and is not."""
        recipe = replace(recipe, frames=None)
        if recipe == self.recipe:
            return
        self.recipe = recipe
        try:
            self._require_own()
            make_folder(self._file.parent)
            with written_whole(self._file) as temporary:
                temporary.write_text(recipe.to_toml(), "utf-8")
        except (InputError, OSError) as error:  # what is asked for is done all the same
            if not self._complained:
                self._say(f"note: the latest recipe is not kept: {error}")
            self._complained = True

    @staticmethod
    def _say(text: str) -> None:
        print(one_line(f"tnst-mi: studio: {text}"), file=sys.stderr)


def _value(recipe: Recipe, name: str) -> Any:
    """The value of a key, or its table of keyframes."""
    return dict(recipe.keyframes[name]) if name in recipe.keyframes else getattr(recipe, name)
