"""Maps between grids: permutations are exact, linear fields are interpolated exactly, boxes hold what they should."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tnst_mi.geometry.affine import Affine, between
from tnst_mi.geometry.boxes import extents, image
from tnst_mi.geometry.resampling import needed_box, resampled

ROTATIONS = [
    np.diag(signs) @ np.eye(3)[list(order)]
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
]


@settings(max_examples=60)
@given(st.sampled_from(ROTATIONS), st.tuples(*[st.integers(-9, 9)] * 3), st.tuples(*[st.integers(1, 5)] * 3))
def test_permutations_are_exact(matrix: np.ndarray, offset: tuple[int, ...], shape: tuple[int, ...]) -> None:
    voxels_of = Affine(matrix, np.array(offset, float))
    cells = np.array([1, -2, 3]), np.array([1, -2, 3]) + shape - np.array(1)
    box = needed_box(cells, voxels_of)
    values = np.random.default_rng(0).random((*extents(box)[::-1], 3))
    found = resampled(values, box, cells, voxels_of)
    assert voxels_of.whole and found.dtype == values.dtype
    for z, y, x in np.ndindex(found.shape[:3]):
        i, j, k = np.rint(matrix @ (cells[0] + [x, y, z]) + offset).astype(int) - box[0]
        np.testing.assert_array_equal(found[z, y, x], values[k, j, i])
    back = resampled(found, cells, box, voxels_of.inverse())
    np.testing.assert_array_equal(back, values)


def test_linear_fields_are_interpolated_exactly() -> None:
    rng = np.random.default_rng(1)
    voxels_of = Affine(np.eye(3) + 0.3 * rng.normal(size=(3, 3)), np.array([0.3, -4.0, 2.2]))
    cells = np.array([0, 1, 2]), np.array([6, 4, 5])
    box = needed_box(cells, voxels_of)
    z, y, x = np.indices(extents(box)[::-1])
    values = 0.5 * (x + box[0][0]) - 0.25 * (y + box[0][1]) + 2.0 * (z + box[0][2])
    found = resampled(values, box, cells, voxels_of)
    for index in np.ndindex(found.shape):
        i, j, k = voxels_of(cells[0] + np.array(index[::-1]))
        assert found[index] == pytest.approx(0.5 * i - 0.25 * j + 2.0 * k, rel=1e-5, abs=1e-4)


def test_beyond_the_box_its_border_goes_on() -> None:
    values = np.array([2.0, 4.0]).reshape(1, 1, 2)
    half = Affine(np.eye(3), np.array([0.5, 0.0, 0.0]))
    cells = np.array([-3, 0, 0]), np.array([3, 0, 0])
    found = resampled(values, (np.zeros(3, int), np.array([1, 0, 0])), cells, half)
    np.testing.assert_array_equal(found[0, 0], [2, 2, 2, 3, 4, 4, 4])


def test_cubes_that_coincide_are_matched_by_number() -> None:
    cells = Affine.scaling(0.1, (1e6, 2.0, 3.0))
    turned = Affine(0.1 * ROTATIONS[7], cells.offset + np.array([0.3, -0.2, 0.1]))
    matched = between(cells, turned)
    assert matched.whole
    np.testing.assert_allclose(matched(np.zeros(3)), ROTATIONS[7].T @ [-3, 2, -1])
    # A size in single precision does not let voxels drift apart; an edge off by half a percent still makes a cube.
    assert between(cells, Affine.scaling(float(np.float32(0.1)), cells.offset)).whole
    almost = Affine(np.diag([0.1, 0.1005, 0.1]), cells.offset)
    assert between(Affine.scaling(almost.edge, cells.offset), almost).whole
    for other in (
        Affine.scaling(0.11, cells.offset),
        Affine.scaling(0.1, cells.offset + 0.05),
        Affine(np.diag([0.1, 0.1, 0.2]), cells.offset),
    ):
        assert not between(cells, other).whole


def test_images_of_boxes() -> None:
    box = np.array([0, 0, 0]), np.array([3, 1, 0])
    mirrored = Affine(np.diag([-1.0, 1.0, 1.0]), np.array([5.0, 0.0, 0.0]))
    low, high = image(box, mirrored)
    assert (low.tolist(), high.tolist()) == ([2, 0, 0], [5, 1, 0])
    coarser = Affine.scaling(0.5)
    low, high = image(box, coarser, 0.5)
    assert (low.tolist(), high.tolist()) == ([-1, -1, -1], [2, 1, 1])
