"""The grids of colour of a run: where colours come from, and where those that are optimised are written."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io.formats import held
from tnst_mi.machine.terminal import quoted, some_of
from tnst_mi.optimisation.glimpse import SmokeColour
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.fire import temperature_in_words
from tnst_mi.rendering.smoke_colour import colour_name, colours_of, require_colour, shown_colours, shown_grid
from tnst_mi.run.carry import chosen, with_colour
from tnst_mi.run.measure import Measure
from tnst_mi.run.work import Work

_SHOWN = 3


@dataclass(frozen=True)
class ColourGrids:
    """Names of grids of colour.

    Attributes:
        begins_with: for each frame, of the colours that its optimised ones begin with, None if these begin with the
            pictures' mean; none at all if none are optimised.
        written: of the grid in which optimised colours are written; None if none are.
        temperature: of the grid whose temperatures are shown as colours, and the largest of all frames; None if
            none are.
    """

    begins_with: tuple[str | None, ...] = ()
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
        own = list(dict.fromkeys(name for name in self.begins_with if name is not None))
        if not own:
            return []
        names = some_of([quoted(name) for name in own], _SHOWN)
        return [
            f"note: colours begin with those of grid {names}, which move with the smoke and are cut to [0, 1]; with a "
            "carry that leaves it out, they begin with the mean of the pictures"
        ]

    def carried(self, recipe: Recipe, measures: Sequence[Measure], suffix: str) -> list[str]:
        """The names of all grids that results have beside the density."""
        each = (
            held(measure.name, suffix, with_colour(chosen(recipe.carry, measure.movable), self.written))
            for measure in measures
        )
        return list(dict.fromkeys(itertools.chain.from_iterable(each)))


def shown_temperature(recipe: Recipe, measures: Sequence[Measure]) -> tuple[str, float] | None:
    """The grid whose temperatures are shown as colours, and the largest of them in all frames.

    None if the recipe does not keep colours, or a frame has some.
    """
    if recipe.colour != "keep" or any(colour_name(measure.movable) is not None for measure in measures):
        return None
    hottest = [entry for measure in measures for entry in measure.hottest.items()]
    name = next((name for name, _ in hottest), None)
    return None if name is None else (name, max(largest for other, largest in hottest if other == name))


def colour_before(work: Work, index: int) -> SmokeColour | None:
    """The colours in which a run shows a frame, by its index, before it is stylized; None if that is in grey.

    Raises:
        InputError: the frame cannot be read again, or is not what it was.
    """
    recipe, measure = work.recipe, work.measures[index]
    if recipe.colour == "off":
        return None
    source = work.unchanged[index]
    if work.plan.colours is not None:
        return SmokeColour(work.plan.colours.unstylized(source), work.plan.colours.grid(source) is not None)
    names = held(source.name, work.suffix, chosen(recipe.carry, measure.movable))
    name, hottest = shown_grid(names, shown_temperature(recipe, work.measures))
    colours = shown_colours(source.grids, name, source.name, source.density.shape, hottest)
    return None if colours is None else SmokeColour(colours, moves=True)


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
    each = []
    for index, measure in enumerate(measures):
        own = colour_name(chosen(recipe.carry, measure.movable))
        each.append(own)
        if own is not None and own not in measure.colours:
            try:
                # Raises: it is read again for the message alone.
                colours_of(frames[index].grids, own, measure.name)
            except InputError as error:
                raise InputError(f"{error}; leave it out with --carry NAMES, or take colour = 'off'") from None
    return ColourGrids() if recipe.colour == "keep" else ColourGrids(tuple(each), name or "Cd")
