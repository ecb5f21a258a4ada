"""Step size against error for the quadratures "exact" and "paper"; where "paper" departs from the continuous formula.

A uniform, opaque column of density d has the continuous image 1/γ. The inclusive sum gives h d/(exp(γ h d) − 1),
which is less by the factor x/(eˣ − 1) with x = γ h d. Recipes for thick smoke (γ of 5 or 10) rely on this darkening of
dense smoke.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tnst_mi.compare.closed_form import closed_form, column_density
from tnst_mi.compare.values import our_images, relative_rms
from tnst_mi.rendering.cameras.views import View

#: Steps in cells.
STEPS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)

#: The study's γ: thin smoke, the threshold for density 1, and one of the paper's thick looks.
GAMMAS = (0.1, 1.0, 5.0)

#: View used if all views of the comparison look along an axis, where "exact" has no error at a step of one cell.
_OBLIQUE = (35.0, 12.0)

#: Orders are fitted over a wide range of steps, up to this one: a single halving may reduce the error by a factor of 8
#: or not at all, depending on where the samples of a regular march lie relative to the density's kinks at each cell.
_LONGEST_FITTED = 2.0


@dataclass(frozen=True, eq=False)
class QuadratureStudy:
    """Both quadratures at one γ.

    Attributes:
        gamma: extinction per unit of density and cell.
        view: (azimuth, elevation) in degrees, for the errors.
        exact: error at each of `STEPS`: RMS of image − closed form over the RMS of the closed form.
        paper: the same for "paper".
        cut: the box cuts through smoke. A march then gains or loses part of a step where a ray enters and leaves, so
            that "exact" is of first order, too.
        densest: largest γ h d of the grid, at a step of one cell.
        thickness: (H, W) γ h d of the smoke visible in each pixel of the view (0, 0), weighted by its contribution.
        front_exact: (H, W) the view (0, 0), "exact", step of one cell.
        front_paper: (H, W) the same, "paper".
    """

    gamma: float
    view: View
    exact: tuple[float, ...]
    paper: tuple[float, ...]
    cut: bool
    densest: float
    thickness: np.ndarray
    front_exact: np.ndarray
    front_paper: np.ndarray

    @property
    def exact_order(self) -> float:
        """Exponent fitted to the error of "exact" against the step."""
        return _order(self.exact)

    @property
    def paper_order(self) -> float:
        """Exponent fitted to the error of "paper" against the step."""
        return _order(self.paper)

    @property
    def departure(self) -> float:
        """RMS of paper − exact over that of exact, in the view (0, 0)."""
        return relative_rms(self.front_paper, self.front_exact)

    @property
    def thick(self) -> np.ndarray:
        """(H, W) bool: pixels whose visible smoke has γ h d ≥ 1."""
        return self.thickness >= 1

    def in_words(self) -> str:
        """What the numbers mean, in one or two sentences."""
        text = (
            f"γ = {self.gamma:g}: the densest cell has γhd = {self.densest:.3g}. In the front view “paper” differs "
            f"from the continuous formula by {self.departure:.1%} (RMS)"
        )
        if not self.thick.any():
            return f"{text}; no pixel shows smoke of γhd ≥ 1 there."
        light = self.front_paper[self.thick].sum() / self.front_exact[self.thick].sum()
        return (
            f"{text}; the {self.thick.sum()} pixels that show smoke of γhd ≥ 1 have {light:.0%} of its light. "
            "There “paper” no longer approximates it, but is a look of its own, bright at the rim, dark in the middle."
        )


def study_quadratures(density: np.ndarray, views: Sequence[View]) -> list[QuadratureStudy]:
    """Measure both quadratures at each of `GAMMAS`, in the first of the views that is oblique to the grid."""
    view = next((view for view in views if any(angle % 90 for angle in view)), _OBLIQUE)
    columns = column_density(density, view)
    return [_study(density, view, gamma, closed_form(columns, gamma)) for gamma in GAMMAS]


def _study(density: np.ndarray, view: View, gamma: float, reference: np.ndarray) -> QuadratureStudy:
    errors = {
        quadrature: tuple(
            relative_rms(our_images(density, [view], gamma, quadrature, step)[0], reference) for step in STEPS
        )
        for quadrature in ("exact", "paper")
    }
    front = {name: our_images(density, [(0.0, 0.0)], gamma, name)[0] for name in ("exact", "paper")}
    return QuadratureStudy(
        gamma,
        view,
        errors["exact"],
        errors["paper"],
        _is_cut(density),
        gamma * float(density.max()),
        _visible_thickness(density, gamma),
        front["exact"],
        front["paper"],
    )


def darkening(thickness: np.ndarray) -> np.ndarray:
    """paper / continuous for a uniform opaque column: x/(eˣ − 1) with x = γ h d > 0."""
    return thickness / np.expm1(thickness)


def _is_cut(density: np.ndarray) -> bool:
    """Whether there is smoke in the outermost cells."""
    return any(np.take(density, (0, -1), axis).any() for axis in range(3))


def _visible_thickness(density: np.ndarray, gamma: float) -> np.ndarray:
    """(H, W) mean of γ d along the rays of the view (0, 0), weighted by what each cell adds to the image."""
    seen = density[::-1, ::-1].astype(np.float64)  # away from the camera, rows from the top down
    depth = gamma * np.cumsum(seen, axis=0)
    added = np.exp(-depth) * np.expm1(gamma * seen)
    total = added.sum(0)
    return np.divide((gamma * seen * added).sum(0), total, out=np.zeros_like(total), where=total > 0)


def _order(errors: Sequence[float]) -> float:
    fitted = np.array(STEPS) <= _LONGEST_FITTED
    return float(np.polyfit(np.log(np.array(STEPS)[fitted]), np.log(np.array(errors)[fitted]), 1)[0])
