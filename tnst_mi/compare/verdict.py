"""The checks behind the verdict: what was measured, what was expected, and whether they agree."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tnst_mi.compare.gradients import Directional, GradientFields
from tnst_mi.compare.paper_quadrature import PaperGradient, PaperImages
from tnst_mi.compare.quadrature_study import QuadratureStudy
from tnst_mi.compare.values import NEGLIGIBLE, Comparison, Convergence
from tnst_mi.rendering.cameras.views import text_of

#: Share of the testable pixels that must lie within three standard errors (99.7% of a normal distribution do).
_WITHIN = 0.99

#: With few testable pixels that share is coarse: this many may always lie outside.
_ALWAYS_ALLOWED = 3

#: Bound of |mean z|; with few testable pixels the mean's standard error, 1/√N, times the second number.
_MEAN_Z, _MEAN_SCATTERS = 0.1, 3.5

#: Where n T (1 − T) < 5, chance alone makes no pixel differ by more than this many paths (probability below 1e-6).
_PATHS = 20.0

#: Bound of |slope + 1/2| of the path tracer's error against the number of paths.
_CONVERGENCE = 0.1

#: Bounds of |slope − 1| and of the correlation of derivatives with the path tracer's.
_SLOPE, _CORRELATION = 0.02, 0.98

#: Relative RMS error allowed against central differences.
_CENTRAL = 1e-3

#: Minimum orders of convergence where first and second order are expected. They are checked where γ h d of the densest
#: cell is at most the last number: beyond it, the steps are too long for "paper" to have reached its asymptotic order.
_FIRST_ORDER, _SECOND_ORDER, _RESOLVED = 0.75, 1.4, 1.0


@dataclass(frozen=True)
class Check:
    """One comparison of a measured number with what was expected, about the quadrature "exact" or "paper"."""

    quadrature: str
    name: str
    measured: str
    expected: str
    passed: bool


def value_checks(values: Comparison) -> Iterator[Check]:
    """The checks of one view at one γ."""
    where = f"view {text_of(values.view)} γ {values.gamma:g}"
    count = int(values.testable.sum())
    allowed = max(_ALWAYS_ALLOWED, math.floor((1 - _WITHIN) * count))
    yield Check(
        "exact",
        f"{where}: exact within 3 standard errors of prbvolpath",
        f"{count - values.outside} of {count} testable pixels",
        f"at most {allowed} outside" if count else "some testable pixels: more --spp",
        count > 0 and values.outside <= allowed,
    )
    bound = max(_MEAN_Z, _MEAN_SCATTERS / math.sqrt(max(count, 1)))
    yield Check("exact", f"{where}: mean z", f"{values.mean_z:+.3f}", f"0 ± {bound:.3g}", abs(values.mean_z) <= bound)
    yield Check(
        "exact",
        f"{where}: other pixels (n T (1 − T) < 5)",
        f"at most {values.untestable_difference:.3g} apart, {values.untestable_paths:.1f} of {values.spp} paths",
        f"at most {_PATHS:g} paths",
        values.untestable_paths <= _PATHS,
    )
    yield Check(
        "exact",
        f"{where}: exact, refined to a step of {values.step:g}, against the closed form",
        f"at most {values.discretisation:.2g} standard errors",
        f"at most {NEGLIGIBLE:g}",
        values.discretisation <= NEGLIGIBLE,
    )


def convergence_check(convergence: Convergence) -> Check:
    """The −1/2 law at one γ."""
    return Check(
        "exact",
        f"γ {convergence.gamma:g}: slope of the error of prbvolpath against spp",
        f"{convergence.slope:.3f}",
        f"−0.5 ± {_CONVERGENCE:g}",
        abs(convergence.slope + 0.5) <= _CONVERGENCE,
    )


def directional_checks(directional: Directional) -> Iterator[Check]:
    """The checks of derivatives along random directions at one γ."""
    where = f"γ {directional.gamma:g}, {len(directional.ours)} directions"
    yield Check(
        "exact",
        f"{where}: slope of derivatives of prbvolpath against ours",
        f"{directional.slope:.4f} ± {directional.slope_interval:.4f}",
        f"1 ± {_SLOPE:g}",
        abs(directional.slope - 1) <= _SLOPE,
    )
    yield Check(
        "exact",
        f"{where}: their correlation",
        f"{directional.correlation:.5f}",
        f"at least {_CORRELATION:g}",
        directional.correlation >= _CORRELATION,
    )
    yield _against_central_differences("exact", where, directional.central_error)
    yield _against_central_differences("paper", where, directional.paper_error)


def field_checks(fields: GradientFields) -> Iterator[Check]:
    """The checks of the gradient of every voxel at one γ."""
    where = f"γ {fields.gamma:g}, every voxel"
    yield _against_central_differences("exact", where, fields.central_error)
    yield Check(
        "exact",
        f"{where}: slope of derivatives of prbvolpath against ours",
        f"{fields.slope:.4f}",
        f"1 ± {_SLOPE:g}",
        abs(fields.slope - 1) <= _SLOPE,
    )


def paper_image_checks(images: PaperImages) -> Iterator[Check]:
    """The check of each view at one γ: "paper" against its own sum, pixel by pixel."""
    for view, deviation in zip(images.views, images.deviations, strict=True):
        largest = float(np.abs(deviation).max())
        yield Check(
            "paper",
            f"view {text_of(view)} γ {images.gamma:g}: paper against the inclusive sum in float64",
            f"every pixel within {largest:.2g} of what float32 may differ by",
            "at most 1",
            largest <= 1,
        )


def paper_gradient_check(gradient: PaperGradient) -> Check:
    """The derivative of "paper" with respect to every voxel, at one γ."""
    return Check(
        "paper",
        f"γ {gradient.gamma:g}, every voxel: derivatives of paper against those of the inclusive sum in float64",
        f"{gradient.error:.2g} of the RMS, of {gradient.pixels} pixels",
        f"at most {gradient.tolerance:.2g}"
        if gradient.pixels
        else "rays without a sample on a wall of the grid: other --views",
        gradient.pixels > 0 and gradient.error <= gradient.tolerance,
    )


def quadrature_checks(study: QuadratureStudy) -> Iterator[Check]:
    """The checks of the orders of convergence at one γ; none where the steps do not resolve the smoke."""
    if study.densest > _RESOLVED:
        return
    exact = _FIRST_ORDER if study.cut else _SECOND_ORDER
    for name, order, least in (("exact", study.exact_order, exact), ("paper", study.paper_order, _FIRST_ORDER)):
        yield Check(
            name,
            f"γ {study.gamma:g}: order of convergence of {name} to the closed form",
            f"{order:.2f}",
            f"at least {least:g}",
            order >= least,
        )


def _against_central_differences(quadrature: str, where: str, error: float) -> Check:
    return Check(
        quadrature,
        f"{where}: {quadrature} against central differences",
        f"{error:.2g} of the RMS",
        f"at most {_CENTRAL:g}",
        error <= _CENTRAL,
    )
