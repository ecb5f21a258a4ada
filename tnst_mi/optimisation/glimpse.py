"""Frames as they stand at the end of an octave: cheap pictures, on its grid, of what the result will be."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.kernels import opaque
from tnst_mi.optimisation.items.state import Current, Items
from tnst_mi.rendering.driving import driving_renderer


class Glimpses:
    """The main views of the frames of a run, before and as they stand; each is rendered when it is asked for.

    Args:
        items: of the octave, all of whose iterations are done.
    """

    def __init__(self, items: Items) -> None:
        self._items = items

    def of(self, indices: Collection[int]) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Name and both views, with the rows and columns of the octave's images and values in [0, 1].

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
