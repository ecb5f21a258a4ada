"""The grids of colour of a run: where colours come from, and where those that are optimised are written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io.formats import held
from tnst_mi.machine.terminal import quoted
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.fire import temperature_in_words
from tnst_mi.rendering.smoke_colour import colour_name, colours_of, require_colour
from tnst_mi.run.carry import chosen, with_colour, written_colour
from tnst_mi.run.measure import Measure


@dataclass(frozen=True)
class ColourGrids:
    """Names of grids of colour.

    Attributes:
        begins_with: of the input's colours, with which optimised ones begin; None if these begin with the pictures'
            mean, or none are optimised.
        written: of the grid in which optimised colours are written; None if none are.
        temperature: of the grid whose temperatures are shown as colours, and the largest of all frames; None if
            none are.
    """

    begins_with: str | None = None
    written: str | None = None
    temperature: tuple[str, float] | None = None

    @property
    def notes(self) -> list[str]:
        """What is to be said of them."""
        if self.temperature is not None:
            return [
                f"note: colour: {temperature_in_words(*self.temperature)}, in the colours of black bodies; a grid Cd "
                "would be shown in its place, and colour = 'off' shows grey smoke"
            ]
        if self.begins_with is None:
            return []
        return [
            f"note: colours begin with those of grid {quoted(self.begins_with)}; with a carry that leaves it out, they "
            "begin with the mean of the pictures"
        ]

    def carried(self, recipe: Recipe, measures: Sequence[Measure], suffix: str) -> list[str]:
        """The names of all grids that results have beside the density.

        Raises:
            InputError: files of this suffix do not hold the optimised colours.
        """
        found: dict[str, None] = {}
        for measure in measures:
            names = held(measure.name, suffix, with_colour(chosen(recipe.carry, measure.movable), self.written))
            if self.written is not None and self.written not in names:
                raise InputError(
                    f"{measure.name}: colour = 'style' writes a grid {quoted(self.written)}, which {suffix} files do "
                    "not hold; expected --format npz or vdb"
                )
            found |= dict.fromkeys(names)
        return list(found)


def shown_temperature(recipe: Recipe, measures: Sequence[Measure]) -> tuple[str, float] | None:
    """The grid whose temperatures are shown as colours, and the largest of them in all frames.

    None if the recipe does not keep colours, or a frame has some.
    """
    if recipe.colour != "keep" or any(colour_name(measure.movable) is not None for measure in measures):
        return None
    hottest = [entry for measure in measures for entry in measure.hottest.items()]
    name = next((name for name, _ in hottest), None)
    return None if name is None else (name, max(largest for other, largest in hottest if other == name))


def colour_grids(recipe: Recipe, measures: Sequence[Measure], frames: Sequence[Frame]) -> ColourGrids:
    """The grids of colour of a run.

    Raises:
        InputError: colours that are to be kept, or to begin with, are not there or cannot be used.
    """
    if recipe.colour == "off":
        return ColourGrids()
    if (temperature := shown_temperature(recipe, measures)) is not None:
        return ColourGrids(temperature=temperature)
    movable = list(dict.fromkeys(name for measure in measures for name in measure.movable))
    carried = chosen(recipe.carry, movable)
    name = require_colour(carried, movable) if recipe.colour == "keep" else colour_name(carried)
    if name is not None:
        first = next(i for i, measure in enumerate(measures) if name in measure.movable)
        colours_of(frames[first].grids, name, measures[first].name)
    if recipe.colour == "keep":
        return ColourGrids()
    return ColourGrids(name, written_colour(carried))
