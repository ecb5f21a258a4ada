"""What a comparison of two sides is told."""

from __future__ import annotations

from dataclasses import dataclass

from tnst_mi.compare.bench.sides import Side

#: Independent estimates into which the paths of a noisy side are divided.
BATCHES = 32


@dataclass(frozen=True)
class BenchSettings:
    """What to compare, and how precisely.

    Attributes:
        left, right: the sides.
        gammas: extinctions γ per unit of density and cell; empty for a scene file, which has its own.
        spp: paths per pixel for images.
        gradient_spp: the same for each derivative.
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
