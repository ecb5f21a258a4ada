"""The quadrature "paper", which drives a stylization by default, against the same sum in float64; values and gradient.

The path tracer and the closed form cannot vouch for it: they know the continuous integral, and "paper" is another
discretisation of it, whose distance is measured beside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tnst_mi.compare.closed_form import closed_form
from tnst_mi.compare.gradients import WeightedSum, weight_image
from tnst_mi.compare.inclusive_sum import (
    InclusiveSums,
    gradient_tolerance,
    inclusive_gradients,
    inclusive_sums,
    undecided,
)
from tnst_mi.compare.values import our_images, relative_rms
from tnst_mi.rendering.cameras.views import View


@dataclass(frozen=True, eq=False)
class PaperImages:
    """The images of "paper" at one γ. Arrays are (V, H, W), row 0 at the top, in density × cells.

    Attributes:
        gamma: extinction per unit of density and cell.
        views: V pairs (azimuth, elevation) in degrees.
        ours: rendered with the step of one cell that a stylization takes.
        sums: the same sum in float64, for each view.
        continuous: the integral that "paper" discretises, float64.
    """

    gamma: float
    views: tuple[View, ...]
    ours: np.ndarray
    sums: tuple[InclusiveSums, ...]
    continuous: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """Ours minus the sum in float64."""
        return np.stack([ours - np.clip(ours, s.lower, s.upper) for ours, s in zip(self.ours, self.sums, strict=True)])

    @property
    def deviations(self) -> np.ndarray:
        """The errors over their tolerance: within −1 to 1 if only rounding tells ours from the sum in float64."""
        return self.errors / np.stack([s.tolerance for s in self.sums])

    @property
    def relative_errors(self) -> tuple[float, ...]:
        """For each view, the RMS of the errors over that of the sum."""
        return tuple(relative_rms(s.upper + error, s.upper) for s, error in zip(self.sums, self.errors, strict=True))

    @property
    def departure(self) -> float:
        """RMS of ours − continuous over that of continuous, over all views: the effect of the discretisation."""
        return relative_rms(self.ours, self.continuous)


@dataclass(frozen=True, eq=False)
class PaperGradient:
    """The gradient (D, H, W) of weighted pixels of all views, rendered as "paper", at one γ.

    Attributes:
        gamma: extinction per unit of density and cell.
        ours: by our reverse mode.
        reference: the derivative of the same sum in float64.
        tolerance: by how much float32 may make them differ, in the unit of `error`.
        pixels: number of pixels of all views that have a weight: those whose ray has no sample on a wall of the grid.
    """

    gamma: float
    ours: np.ndarray
    reference: np.ndarray
    tolerance: float
    pixels: int

    @property
    def error(self) -> float:
        """RMS of ours − reference over that of reference, over all voxels; 0 if no pixel has a weight."""
        return relative_rms(self.ours, self.reference) if self.pixels else 0.0


def compare_paper_images(
    density: np.ndarray, views: Sequence[View], gammas: Sequence[float], columns: Sequence[np.ndarray]
) -> list[PaperImages]:
    """Compare the images of a density (D, H, W) at each γ; `columns` holds ∫ d of each view (H, W)."""
    sums = [inclusive_sums(density, view, gammas) for view in views]
    return [
        PaperImages(
            gamma,
            tuple(views),
            our_images(density, views, gamma, "paper"),
            tuple(of_view[i] for of_view in sums),
            closed_form(np.stack(columns), gamma),
        )
        for i, gamma in enumerate(gammas)
    ]


def compare_paper_gradients(
    density: np.ndarray, views: Sequence[View], gammas: Sequence[float], seed: Sequence[int]
) -> list[PaperGradient]:
    """Compare the gradient of a density (D, H, W) at each γ, of one sum of pixels with smooth random weights."""
    shape = density.shape
    judged = ~np.stack([undecided(shape, view) for view in views])
    weights = judged * np.stack([weight_image(shape[1:], (*seed, i)) for i in range(len(views))])
    references = [np.zeros(shape) for _ in gammas]
    for view, image in zip(views, weights, strict=True):
        for reference, gradient in zip(references, inclusive_gradients(density, view, gammas, image), strict=True):
            reference += gradient
    return [
        PaperGradient(
            gamma,
            WeightedSum(density, views, gamma, "paper", 1.0, weights).gradient(),
            reference,
            gradient_tolerance(density, gamma),
            int(judged.sum()),
        )
        for gamma, reference in zip(gammas, references, strict=True)
    ]
