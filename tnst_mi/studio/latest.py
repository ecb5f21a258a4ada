"""The latest recipe of a studio, which another one with the same folder begins with."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import make_folder, written_whole
from tnst_mi.machine.terminal import one_line
from tnst_mi.recipe.recipe import Recipe

#: Its name in the folder of the studio.
LATEST = "latest.toml"


class LatestRecipe:
    """Keeps a recipe in a file.

    Args:
        out: the folder of the studio, which need not exist.

    Attributes:
        recipe: the latest one; the defaults if there is none that can be used.
    """

    def __init__(self, out: Path) -> None:
        self._file, self._complained = out / LATEST, False
        self.recipe = Recipe()
        if self._file.is_file():
            try:
                self.recipe = Recipe.from_toml(self._file)
            except InputError as error:
                self._say(f"note: begins with the defaults, since the latest recipe cannot be used: {error}")

    def keep(self, recipe: Recipe) -> None:
        """Keep a recipe, unless it is the one that is kept; which frames it is of depends on the input, and is not."""
        recipe = replace(recipe, frames=None)
        if recipe == self.recipe:
            return
        self.recipe = recipe
        try:
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
