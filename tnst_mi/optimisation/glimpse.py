"""Frames as they stand at the end of an octave: their states, and cheap pictures, on its grid, of what will come."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.kernels import opaque
from tnst_mi.optimisation.colouring import COLOUR, final_colour, on_octave
from tnst_mi.optimisation.items.state import Current, Items
from tnst_mi.optimisation.parameterisation import Fields, Transport
from tnst_mi.optimisation.start import State
from tnst_mi.rendering.driving import colour_renderer, driving_renderer


class SmokeColour(NamedTuple):
    """The colours that the smoke of a frame is shown in before it is stylized.

    Attributes:
        values: (D, H, W, 3), display values of the full grid, 0 or more.
        moves: whether they are the smoke's own, and move with it.
    """

    values: np.ndarray
    moves: bool


def grey(_: int) -> None:
    """Smoke of no frame has colours."""


class Glimpses:
    """The frames of a run as they stand; what is asked for is read or rendered then.

    Args:
        items: of the octave, all of whose iterations are done.
        scales: of the terms of its loss, by name.
    """

    def __init__(self, items: Items, scales: Mapping[str, float]) -> None:
        self._items, self._scales = items, dict(scales)

    @property
    def octave(self) -> int:
        """Which octave, from 0."""
        return self._items.level

    def states(self) -> Iterator[tuple[str, State]]:
        """Name and state of each frame that is changed."""
        for now in self._items.current(self._items.plan.alive):
            fields = {name: field.numpy() for name, field in now.fields.items()}
            yield now.frame.name, State(self.octave, now.done, fields, self._scales)

    def of(
        self, indices: Collection[int], colours: Callable[[int], SmokeColour | None] = grey
    ) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Name and main views, before and after, with the rows and columns of the octave's images and values in [0, 1].

        Args:
            indices: of the frames; those that stay unchanged are left out.
            colours: those of a frame by its index, before; None for a grey one.

        Raises:
            InputError: the colours of a frame cannot be read again.
        """
        for now in self._items.current(frame for frame in self._items.plan.alive if frame.index in indices):
            before = now.inputs.density
            after = self._changed(now, before, now.frame.parameterisation.density)
            given = colours(now.frame.index)
            tints = (None, None) if given is None else self._tints(now, given)
            views = [self._main_view(now, *smoke) for smoke in zip((before, after), tints, strict=True)]
            yield now.frame.name, views[0], views[1]

    def _changed(
        self, now: Current, values: mi.TensorXf, change: Callable[[Fields, mi.TensorXf, float], mi.TensorXf]
    ) -> mi.TensorXf:
        """A grid of the frame, changed by its fields, with the strength and the blend of the frame."""
        recipe = now.frame.recipe
        with dr.suspend_grad():
            changed = change(now.fields.times(recipe.strength), values, self._items.octave.cell_size)
            share = opaque(recipe.blend)
            return mi.TensorXf((1 - share) * values.array + share * changed.array, tuple(values.shape))

    def _tints(self, now: Current, given: SmokeColour) -> tuple[mi.TensorXf, mi.TensorXf]:
        """The colours of the frame on the octave's grid, (D, H, W, 3), before and after."""
        before = on_octave(given.values, self._items.octave)
        moved, of_density = before, now.frame.parameterisation.of_density
        if given.moves and isinstance(of_density, Transport):
            moved = self._changed(now, before, of_density.colour)
        if now.inputs.colour is None:
            return before, moved
        recipe, unstylized = now.frame.recipe, moved.numpy()
        start = unstylized if given.moves else now.inputs.colour.numpy()
        change, share = now.fields.times(recipe.strength)[COLOUR], recipe.strength * recipe.blend
        return before, mi.TensorXf(final_colour(unstylized, start, change, share, recipe.blend, None))

    def _main_view(self, now: Current, density: mi.TensorXf, tint: mi.TensorXf | None) -> np.ndarray:
        octave, recipe = self._items.octave, now.frame.recipe
        with dr.suspend_grad():
            if tint is None:
                renderer = driving_renderer(
                    recipe, octave.shape, octave.cell_size, size=octave.size, pixel=octave.pixel
                )
                images = renderer.render(density, [recipe.main_view], now.frame.seed(self._items.level, 0))
            else:
                coloured = colour_renderer(recipe, octave.shape, octave.cell_size, size=octave.size, pixel=octave.pixel)
                images = coloured.render_colour(density, tint, [recipe.main_view])
            return np.clip((images * opaque(now.frame.exposure)).numpy()[0], 0.0, 1.0)
