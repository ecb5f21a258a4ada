"""What a comparison of two sides is told."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tnst_mi.compare.bench.renderers.sides import Side

#: Independent estimates into which the paths of a noisy side are divided.
BATCHES = 32


#: Paths of an image and per pixel, up to which there are more than by default where pixels are few.
_PATHS, _DEEPEST = 1 << 20, 1 << 18

#: Each derivative takes five times as many images.
_GRADIENT_SHARE = 4


@dataclass(frozen=True)
class BenchSettings:
    """What to compare, and how precisely.

    Attributes:
        left, right: the sides.
        gammas: extinctions γ per unit of density and cell; empty for a scene file, which has its own.
        spp: paths per pixel for images, a multiple of `BATCHES`.
        gradient_spp: the same for each derivative and image of it.
        parameters: with respect to which derivatives are compared, of `PARAMETERS`.
        tolerance: difference that does not count, relative to the RMS of a view.
        seed: of all paths; the sides share none.
    """

    left: Side
    right: Side
    gammas: tuple[float, ...]
    spp: int
    gradient_spp: int
    parameters: tuple[str, ...]
    tolerance: float
    seed: int

    def with_paths(self, spp: int) -> BenchSettings:
        """With at least so many paths per pixel, and a quarter of them for derivatives, in whole batches."""
        images, gradients = (max(1, -(-paths // BATCHES)) * BATCHES for paths in (spp, spp // _GRADIENT_SHARE))
        return replace(self, spp=images, gradient_spp=gradients)

    def with_more_where_pixels_are_few(self, shape: tuple[int, int, int, int]) -> BenchSettings:
        """With at least 2²⁰ paths of all pixels (V, H, W) together, but no more than 2¹⁸ of one: a single pixel of 256
        paths would tell little."""
        return self.with_paths(max(self.spp, min(_DEEPEST, _PATHS // math.prod(shape[:3]))))
