"""The renderers of a reconstruction: emission and absorption, whose images are opacities, or scattering."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import mitsuba as mi
import numpy as np
from torch import Tensor

from tnst_mi.fields.grid import Octave
from tnst_mi.recipe.paths import LIGHTS, shipped_lights
from tnst_mi.reconstruction.fitting.image_model import ImageModel
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.reconstruction.settings import ReconstructionSettings
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer, Renderer
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer

#: Paths per pixel where path-traced images are judged.
_STILL_SPP = 256


class OpacityRenderer(EmissionAbsorptionRenderer):
    """Emission and absorption of an extinction: with γ = 1, images are opacities.

    Coarse grids have views of few pixels, which take the CPU longer to launch than to compute: several go together.
    """

    samples_of_cpu = 1 << 22


class RendererChoice:
    """Renders extinctions, so with γ = 1, on any grid and in any size; renderers are kept.

    Args:
        settings: which renderer, and its light.
        peak: the value of pictures that counts as 1.
    """

    def __init__(self, settings: ReconstructionSettings, peak: float) -> None:
        self._settings, self._peak = settings, peak
        self._renderers: dict[tuple[Octave, tuple[int, int], bool], Renderer] = {}

    @property
    def noisy(self) -> bool:
        """Whether images and derivatives are those of random paths."""
        return self._settings.integrator == "prbvolpath"

    def of(self, octave: Octave, size: tuple[int, int], still: bool = False) -> Renderer:
        """The renderer of a grid for pictures of (rows, columns) pixels; `still` takes more paths.

        Raises:
            InputError: the light's file cannot be used.
        """
        key = octave, size, still
        if key not in self._renderers:
            self._renderers[key] = self._made(octave, size, still)
        return self._renderers[key]

    def pixels(self, image: Tensor, background: Tensor | None, model: ImageModel) -> Tensor:
        """The pixels of an image that was rendered, in units of the peak."""
        if self.noisy:
            return image / self._peak
        return model.pixels(image, background)

    def noise(self, extinction: np.ndarray, octave: Octave, photographs: Sequence[Photograph]) -> float:
        """The standard deviation of pixels, in parts of the peak, by two renderings of an extinction (D, H, W)."""
        squares, pixels = 0.0, 0
        for number, photograph in enumerate(photographs):
            renderer = self.of(octave, photograph.values.shape)
            first, second = (
                renderer.render(mi.TensorXf(extinction), [photograph.camera], (number, again)).numpy()
                for again in range(2)
            )
            squares += float(((first - second) ** 2).sum(dtype=np.float64)) / 2
            pixels += first.size
        return math.sqrt(squares / pixels) / self._peak

    def _made(self, octave: Octave, size: tuple[int, int], still: bool) -> Renderer:
        s = self._settings
        if s.integrator == "emission_absorption":
            step = sample_distance(s.quadrature)
            return OpacityRenderer(octave.shape, 1.0, s.quadrature, octave.cell_size, step, size)
        light = LIGHTS / f"{s.light}.xml" if s.light in shipped_lights() else Path(s.light)
        lighting = Lighting(s.albedo, s.anisotropy, light, _STILL_SPP if still else s.spp)
        return ScatteringRenderer(octave.shape, 1.0, octave.cell_size, lighting, size)


def sample_distance(quadrature: str) -> float | None:
    """The distance between samples of a ray on any grid, in full-resolution cells; None for that of the grid's cells.

    The paper's sum depends on it, and pictures of that have the one of the full grid.
    """
    return 1.0 if quadrature == "paper" else None
