"""The float64 reference of the quadrature "paper" against closed forms, another march, and central differences."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
import ray_march
from fields import smooth_noise

from tnst_mi import compare
from tnst_mi.compare import inclusive_sum
from tnst_mi.compare.inclusive_sum import inclusive_gradients, inclusive_sums, undecided
from tnst_mi.compare.rays import Interpolation, rays

SHAPE = (6, 9, 8)
VIEWS = [(0.0, 0.0), (90.0, 0.0), (-9.0, 4.0), (37.0, -12.0), (123.0, 48.0)]


def smoke(*shape: int) -> np.ndarray:
    """A density that does not vanish at the walls, float64."""
    return np.abs(smooth_noise(np.random.default_rng(1), *shape)).astype(np.float64) + 0.05


def uniform_column(density: float, gamma: float, n: int) -> float:
    """Σ_{k=1}^n d exp(−γ k d), a geometric series."""
    q = np.exp(-gamma * density)
    return density * q * (1 - q**n) / (1 - q)


def test_nothing_of_the_renderer_is_in_the_references() -> None:
    for name in ("rays", "closed_form", "inclusive_sum"):
        tree = ast.parse((Path(compare.__file__).parent / f"{name}.py").read_text("utf-8"))
        imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        imported |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        assert imported <= {"__future__", "collections.abc", "dataclasses", "numpy", "tnst_mi.compare.rays"}


# --------------------------------------------------------------------
# Images
# --------------------------------------------------------------------


@pytest.mark.parametrize(("shape", "view", "n"), [(SHAPE, (0, 0), 6), (SHAPE, (90, 0), 8), ((5, 9, 8), (180, 0), 5)])
def test_uniform_columns_are_geometric_series(shape: tuple[int, int, int], view: tuple[float, float], n: int) -> None:
    """In these views rays run along an axis through all n cell centres; at 90° they miss the box right and left."""
    gammas = (0.1, 1.0, 5.0)
    for gamma, sums in zip(gammas, inclusive_sums(np.full(shape, 0.7), view, gammas), strict=True):
        columns = slice(None) if view[0] != 90 else slice(1, 7)
        expected = np.zeros(shape[1:])
        expected[:, columns] = uniform_column(0.7, gamma, n)
        np.testing.assert_allclose(sums.upper, expected, rtol=1e-12)
        np.testing.assert_array_equal(sums.lower, sums.upper)


def test_samples_on_walls_may_be_in_or_out() -> None:
    """At 90° through 7 cells, with the phase of an even depth, samples lie on the cells' faces, two of them walls."""
    (sums,) = inclusive_sums(np.full((6, 5, 7), 0.7), (90, 0), [2.0])
    middle = slice(1, 6)  # the outermost rays run along a wall
    np.testing.assert_allclose(sums.upper[:, middle], uniform_column(0.7, 2.0, 8), rtol=1e-12)
    np.testing.assert_allclose(sums.lower[:, middle], uniform_column(0.7, 2.0, 6), rtol=1e-12)
    assert undecided((6, 5, 7), (90, 0)).all() and not undecided((6, 5, 7), (0, 0)).any()


def test_the_samples_on_either_wall_may_be_in_or_out() -> None:
    """Opaque at the near wall, bright at the far one: least without the far sample, largest without the near one."""
    density = np.full((6, 1, 7), 0.2)
    density[..., 0], density[..., 6] = 0.9, 3.0
    (sums,) = inclusive_sums(density, (90, 0), [2.0])
    between = np.interp(np.arange(0.5, 6), range(7), density[0, 0])
    far, near = density[0, 0, 0], density[0, 0, 6]  # the camera is at +x
    images = []
    for samples in ([near, *between[::-1]], [*between[::-1], far]):
        images.append(sum(d * np.exp(-2 * sum(samples[: k + 1])) for k, d in enumerate(samples)))
    np.testing.assert_allclose(sums.lower[0, 1:6], images[0], rtol=1e-12)
    np.testing.assert_allclose(sums.upper[0, 1:6], images[1], rtol=1e-12)


@pytest.mark.parametrize("view", VIEWS)
def test_oblique_views_are_those_of_another_march(view: tuple[float, float]) -> None:
    density = smoke(*SHAPE)
    for gamma, sums in zip((0.2, 3.0), inclusive_sums(density, view, (0.2, 3.0)), strict=True):
        np.testing.assert_allclose(sums.upper, ray_march.render(density, view, gamma, "paper"), rtol=0, atol=1e-9)
        np.testing.assert_array_equal(sums.lower, sums.upper)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("gamma", [0.3, 6.0])
def test_moved_samples_stay_within_the_tolerance(
    view: tuple[float, float], gamma: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of smoke of 0 and 1, at γ 6, where the image is small. The tolerance is at most 20 times what they change:
    it adds up all samples and axes, and takes slopes from the cells around."""
    density = np.zeros(SHAPE)
    density[1:-1, 1:-1, 1:-1] = np.random.default_rng(2).random((4, 7, 6)) > 0.7
    (sums,) = inclusive_sums(density, view, [gamma])
    error = inclusive_sum._POSITION * np.linalg.norm(SHAPE)
    largest = 0.0
    for signs in np.ndindex(2, 2, 2):
        shift = (2 * np.array(signs) - 1) * error
        monkeypatch.setattr(
            inclusive_sum, "rays", lambda *which, shift=shift: ((o + shift, v) for o, v in rays(*which))
        )
        (moved,) = inclusive_sums(density, view, [gamma])
        deviations = np.abs(moved.upper - sums.upper) / sums.tolerance
        assert deviations.max() <= 1
        largest = max(largest, deviations.max())
    assert largest > 0.05


# --------------------------------------------------------------------
# Gradients
# --------------------------------------------------------------------


def test_derivatives_of_a_column_of_two_cells() -> None:
    """d = (b, a) along z, a in front: I = a exp(−γ a) + b exp(−γ (a + b)), differentiated by hand."""
    a, b, gamma = 0.6, 0.9, 1.7
    (gradient,) = inclusive_gradients(np.array([b, a]).reshape(2, 1, 1), (0, 0), [gamma], np.full((1, 1), 3.0))
    near, far = np.exp(-gamma * a), np.exp(-gamma * (a + b))
    expected = [3 * far * (1 - gamma * b), 3 * (near * (1 - gamma * a) - gamma * b * far)]
    np.testing.assert_allclose(gradient.ravel(), expected, rtol=1e-12)


@pytest.mark.parametrize("view", VIEWS)
def test_gradients_against_central_differences(view: tuple[float, float]) -> None:
    rng = np.random.default_rng(3)
    density, weights, gammas = smoke(*SHAPE), rng.standard_normal(SHAPE[1:]), (0.2, 3.0)
    gradients = inclusive_gradients(density, view, gammas, weights)
    for _ in range(4):
        direction = rng.standard_normal(SHAPE)
        above, below = (inclusive_sums(density + step * direction, view, gammas) for step in (1e-5, -1e-5))
        for gradient, upper, lower in zip(gradients, above, below, strict=True):
            expected = (weights * (upper.upper - lower.upper)).sum() / 2e-5
            assert np.vdot(gradient, direction) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("shape", [SHAPE, (1, 5, 1)])
def test_addition_to_the_cells_is_the_transpose_of_interpolation(shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(4)
    grid, values = rng.standard_normal(shape), rng.standard_normal(200)
    interpolation = Interpolation(shape, rng.uniform(-0.5, np.array(shape[::-1]) - 0.5, (200, 3)))
    total = np.zeros(shape)
    interpolation.add_transposed(values, total)
    assert np.vdot(total, grid) == pytest.approx(np.vdot(values, interpolation.of(grid)), rel=1e-12)
