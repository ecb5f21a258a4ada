"""Frames as they stand at the end of an octave: their states, and cheap pictures, on its grid, of what will come."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.kernels import opaque
from tnst_mi.optimisation.items.state import Current, Items
from tnst_mi.optimisation.start import State
from tnst_mi.rendering.driving import driving_renderer


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

    def of(self, indices: Collection[int]) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Name and main views, before and after, with the rows and columns of the octave's images and values in [0, 1].

        Args:
            indices: of the frames; those that stay unchanged are left out.
        """
        for now in self._items.current(frame for frame in self._items.plan.alive if frame.index in indices):
            before, after = (self._main_view(now, density) for density in (now.inputs.density, self._stylized(now)))
            yield now.frame.name, before, after

    def _stylized(self, now: Current) -> mi.TensorXf:
        recipe, density = now.frame.recipe, now.inputs.density
        with dr.suspend_grad():
            fields = now.fields.times(recipe.strength)
            stylized = now.frame.parameterisation.density(fields, density, self._items.octave.cell_size)
            share = opaque(recipe.blend)
            return mi.TensorXf((1 - share) * density.array + share * stylized.array, tuple(density.shape))

    def _main_view(self, now: Current, density: mi.TensorXf) -> np.ndarray:
        octave, recipe = self._items.octave, now.frame.recipe
        renderer = driving_renderer(recipe, octave.shape, octave.cell_size, size=octave.size, pixel=octave.pixel)
        with dr.suspend_grad():
            images = renderer.render(density, [recipe.main_view], now.frame.seed(self._items.level, 0))
            return np.clip((images * opaque(now.frame.exposure)).numpy()[0], 0.0, 1.0)
