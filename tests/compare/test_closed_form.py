"""The continuous image in float64 against chords, sums of cells, and marches with many steps."""

from __future__ import annotations

import numpy as np
import pytest
import ray_march
from fields import smooth_noise

from tnst_mi.compare.closed_form import closed_form, column_density
from tnst_mi.rendering.cameras.views import camera_frame

SHAPE = (6, 9, 8)
VIEWS = [(0.0, 0.0), (90.0, 0.0), (-9.0, 4.0), (37.0, -12.0), (123.0, 48.0)]


def smoke(*shape: int) -> np.ndarray:
    return np.abs(smooth_noise(np.random.default_rng(1), *shape)) + 0.05


def chords(shape: tuple[int, int, int], view: tuple[float, float]) -> np.ndarray:
    """Lengths (H, W) of the pixel-centre rays inside the box; 0 where they miss it."""
    half = np.array(shape[::-1]) / 2
    origins = ray_march.pixel_centres(shape, view, 1.0)
    direction = -camera_frame(*view)[2]
    with np.errstate(divide="ignore"):
        walls = np.sort(np.stack([(-half - origins) / direction, (half - origins) / direction]), axis=0)
    begin, end = walls[0].max(-1), walls[1].min(-1)
    return np.subtract(end, begin, out=np.zeros_like(end), where=end > begin).reshape(shape[1:])


@pytest.mark.parametrize("view", VIEWS)
def test_a_uniform_box_gives_the_lengths_of_the_chords(view: tuple[float, float]) -> None:
    expected = 0.7 * chords(SHAPE, view)
    assert expected.max() > 0.69 * min(SHAPE)
    np.testing.assert_allclose(column_density(np.full(SHAPE, 0.7), view), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("shape", [SHAPE, (1, 9, 7), (5, 1, 1)])
def test_along_z_it_is_the_sum_of_the_cells(shape: tuple[int, int, int]) -> None:
    density = smoke(*shape).astype(np.float64)
    np.testing.assert_allclose(column_density(density, (0.0, 0.0)), density.sum(0)[::-1], rtol=1e-12)


@pytest.mark.parametrize("view", VIEWS[2:])
def test_many_steps_converge_to_it(view: tuple[float, float]) -> None:
    """Errors of a march fall as the square of its step where rays do not end in smoke."""
    density = np.zeros(SHAPE)
    density[1:-1, 1:-1, 1:-1] = smoke(*(n - 2 for n in SHAPE))
    exact = column_density(density, view).ravel()
    towards = camera_frame(*view)[2]
    origins = ray_march.pixel_centres(SHAPE, view, 1.0) + 40 * towards
    edges = np.diag(SHAPE[::-1]).astype(float)
    errors = []
    for step in (0.04, 0.01):
        values = ray_march.samples(density, edges, np.zeros(3), origins, np.tile(-towards, (len(origins), 1)), step)
        errors.append(np.sqrt(np.mean((step * values.sum(-1) - exact) ** 2)))
    assert errors[1] < errors[0] / 12
    assert errors[1] < 2e-5 * exact.max()


def test_closed_form_of_faint_and_opaque_columns() -> None:
    columns = np.array([0.0, 1.0, 50.0])
    np.testing.assert_allclose(closed_form(columns, 1e-9), columns, rtol=1e-7)
    np.testing.assert_allclose(closed_form(columns, 2.0), [0, (1 - np.exp(-2)) / 2, 0.5], rtol=1e-12)
