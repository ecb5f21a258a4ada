"""The quadrature "paper" against its sum in float64: rounding alone tells them apart, also where it has most effect."""

from __future__ import annotations

import numpy as np
import pytest
from fields import smooth_noise

from tnst_mi.compare.closed_form import column_density
from tnst_mi.compare.paper_quadrature import (
    PaperGradient,
    PaperImages,
    compare_paper_gradients,
    compare_paper_images,
)
from tnst_mi.compare.quadrature_study import study_quadratures
from tnst_mi.compare.verdict import paper_gradient_check, paper_image_checks
from tnst_mi.rendering.cameras.views import View

GAMMAS = (0.05, 2.0, 10.0)
VIEWS = [(0.0, 0.0), (90.0, 0.0), (45.0, 0.0), (-80.0, -25.0)]


def smoke(*shape: int) -> np.ndarray:
    return np.abs(smooth_noise(np.random.default_rng(5), *shape)) + np.float32(0.05)


def zeros_and_ones(*shape: int) -> np.ndarray:
    return (np.random.default_rng(6).random(shape) > 0.7).astype(np.float32)


def images(density: np.ndarray, views: list[View]) -> list[PaperImages]:
    return compare_paper_images(density, views, GAMMAS, [column_density(density, view) for view in views])


@pytest.mark.parametrize(
    "density", [smoke(6, 9, 7), smoke(1, 9, 7), smoke(5, 1, 4), zeros_and_ones(11, 14, 12), np.full((5, 6, 8), 0.7)]
)
def test_only_rounding_tells_them_apart(density: np.ndarray) -> None:
    """Smoke that the walls cut, single layers, edges as hard as they can be, and rays with samples on the walls."""
    density = density.astype(np.float32)
    for compared in images(density, VIEWS):
        assert all(check.passed for check in paper_image_checks(compared))
        assert np.abs(compared.deviations).max() < 0.5, "with room to spare"
    for gradient in compare_paper_gradients(density, VIEWS, GAMMAS, (0, 3)):
        assert gradient.pixels > 0
        assert gradient.error < 0.5 * gradient.tolerance and paper_gradient_check(gradient).passed


def test_the_tolerance_is_far_below_what_it_must_find() -> None:
    """In units of the image: less than a half-step shift of the samples, 4% or more, by orders."""
    for compared in images(smoke(20, 30, 20), VIEWS):
        for sums in compared.sums:
            assert sums.tolerance.max() < 1e-3 * sums.upper.max()
    for gradient in compare_paper_gradients(smoke(20, 30, 20), VIEWS, GAMMAS, (0, 3)):
        assert gradient.tolerance < 1e-3


def test_one_wrong_pixel_and_one_wrong_voxel_are_found() -> None:
    density = smoke(20, 30, 20)
    compared = images(density, VIEWS)[0]
    compared.ours[2, 7, 7] *= 1.001
    assert [check.passed for check in paper_image_checks(compared)] == [True, True, False, True]
    gradient = compare_paper_gradients(density, VIEWS, GAMMAS, (0, 3))[0]
    wrong = gradient.ours.copy()
    wrong[3, 4, 5] += np.sqrt(np.mean(wrong**2))
    assert not paper_gradient_check(PaperGradient(0.05, wrong, gradient.reference, gradient.tolerance, 1)).passed


def test_where_every_ray_has_a_sample_on_a_wall_there_is_no_verdict_on_the_gradient() -> None:
    """At 90°, an even depth and an odd width."""
    (gradient,) = compare_paper_gradients(smoke(6, 9, 7), [(90.0, 0.0)], [1.0], (0, 3))
    check = paper_gradient_check(gradient)
    assert gradient.pixels == 0 and not check.passed and "other --views" in check.expected


def test_departure_from_the_continuous_integral() -> None:
    """Of uniform columns of n cells: 1 − the inclusive sum, a geometric series, over (1 − exp(−γ d n))/γ."""
    density = np.full((12, 4, 4), 0.5, np.float32)
    for compared in images(density, [(0.0, 0.0)]):
        q = np.exp(-0.5 * compared.gamma)
        ratio = 0.5 * compared.gamma * q / (1 - q)
        assert compared.departure == pytest.approx(1 - ratio, rel=1e-4)


def test_departure_is_that_of_the_quadrature_study() -> None:
    """Of the front view alone, where "exact" is the closed form."""
    density = smoke(12, 9, 8)
    (study, *_) = study_quadratures(density, [(0.0, 0.0)])
    (compared,) = compare_paper_images(density, [(0.0, 0.0)], [study.gamma], [column_density(density, (0.0, 0.0))])
    assert compared.departure == pytest.approx(study.departure, rel=1e-4)
