"""Cells in which there can be smoke: those that no view sees as empty (the visual hull, Laurentini 1994).

A path tracer's derivatives are noisy, and where extinction cannot become negative, noise does not average out: it
leaves haze in all of the box. Cells outside of the outline are 0 from the beginning, and stay so.
"""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from tnst_mi.fields.grid import Octave
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

#: Pixels that differ from the background by no more than this many deviations of the noise are empty, and at most by
#: this part of the peak: smoke that is noisy itself may pass for noise.
_DEVIATIONS, _MOST = 4.0, 0.05


def outline(photographs: Sequence[Photograph], octave: Octave, background: float, noise: float) -> np.ndarray:
    """Which cells of a grid may have smoke in them, (D, H, W) bool.

    A view sees a cell as empty if it is in the picture and every ray through it ends in an empty pixel; pixels that are
    masked tell nothing.

    Args:
        photographs: in units of the peak, averaged for the grid.
        octave: the grid.
        background: what is seen without smoke where there is no picture of that.
        noise: the standard deviation of the noise of pixels.
    """
    possible, tolerance = np.ones(octave.shape, bool), min(_DEVIATIONS * noise, _MOST)
    nothing = mi.TensorXf(np.zeros(octave.shape, np.float32))
    for photograph in photographs:
        behind = background if photograph.background is None else photograph.background
        filled = (np.abs(photograph.values - behind) > tolerance) | (photograph.weights == 0)
        renderer = EmissionAbsorptionRenderer(octave.shape, 1.0, "exact", octave.cell_size, size=filled.shape)
        images = np.stack([filled, np.ones_like(filled)]).astype(np.float32)
        empty = mi.TensorXf(np.zeros((1, *filled.shape), np.float32))
        # Through nothing, the derivative of a sum of pixels is how far their rays go in a cell's surroundings.
        within, there = (
            renderer.gradient(nothing, [photograph.camera], (0,), empty, mi.TensorXf(image[None])).numpy()
            for image in images
        )
        possible &= (within > 0) | (there <= 0)
    return possible
