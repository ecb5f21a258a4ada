"""Views: the camera's axes against the fixed conventions, and the sampling's guarantees."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tnst_mi.errors import InputError
from tnst_mi.rendering.cameras.views import camera_frame, sample_views

ANGLES = [(0.0, 0.0), (-8.0, 3.0), (37.0, -12.0), (135.0, 60.0), (-90.0, 88.0)]


def smallest_distance(views: np.ndarray) -> float:
    distances = np.hypot(*(views[:, None] - views[None, :]).transpose(2, 0, 1))
    return distances[~np.eye(len(views), dtype=bool)].min()


def test_main_view_looks_along_minus_z_with_x_right_and_y_up() -> None:
    np.testing.assert_array_equal(np.stack(camera_frame(0.0, 0.0)), np.eye(3))


@pytest.mark.parametrize("view", ANGLES)
def test_camera_frame_is_a_right_handed_orthonormal_basis(view: tuple[float, float]) -> None:
    right, up, towards = frame = camera_frame(*view)
    np.testing.assert_allclose(np.stack(frame) @ np.stack(frame).T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.cross(right, up), towards, atol=1e-15)
    assert right[1] == 0.0 and up[1] >= 0.0, "the camera must not roll"


def test_positive_azimuth_moves_the_camera_towards_x_and_positive_elevation_up() -> None:
    np.testing.assert_allclose(camera_frame(90.0, 0.0)[2], [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(camera_frame(0.0, 90.0)[2], [0.0, 1.0, 0.0], atol=1e-15)
    assert camera_frame(5.0, 0.0)[2][0] > 0.0
    assert camera_frame(0.0, 5.0)[2][1] > 0.0


@pytest.mark.parametrize("view", ANGLES)
def test_camera_frame_is_elevation_about_x_then_azimuth_about_y(view: tuple[float, float]) -> None:
    a, e = np.radians(view)
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(e), np.sin(e)], [0, -np.sin(e), np.cos(e)]])
    np.testing.assert_allclose(np.stack(camera_frame(*view)).T, about_y @ about_x, atol=1e-15)


@pytest.mark.parametrize("azimuth", [(-10.0, 10.0), (80.0, 110.0), (3.0, 3.0)])
@pytest.mark.parametrize("n", [1, 2, 9, 40])
def test_first_view_is_the_centre_and_all_lie_in_range(n: int, azimuth: tuple[float, float]) -> None:
    views = sample_views(n, azimuth, (-5.0, 15.0), seed=3)
    assert views.shape == (n, 2) and views.dtype == np.float64
    np.testing.assert_array_equal(views[0], [sum(azimuth) / 2, 5.0])
    assert (views >= [azimuth[0], -5.0]).all() and (views <= [azimuth[1], 15.0]).all()


def test_views_keep_their_distance_where_independent_random_ones_do_not() -> None:
    area, n = 20.0 * 10.0, 9
    densest = np.sqrt(2.0 / np.sqrt(3.0) * area / n)
    generator = np.random.default_rng(0)
    spread = [smallest_distance(sample_views(n, seed=seed)) for seed in range(50)]
    random = [smallest_distance(generator.uniform([-10, -5], [10, 5], (n, 2))) for _ in range(50)]
    assert min(spread) > 0.6 * densest
    assert np.mean(random) < 0.25 * densest


def test_views_of_many_draws_cover_the_range_evenly() -> None:
    drawn = np.concatenate([sample_views(9, seed=seed)[1:] for seed in range(150)])
    counts, *_ = np.histogram2d(*drawn.T, bins=2, range=((-10, 10), (-5, 5)))
    assert np.abs(counts / len(drawn) - 0.25).max() < 0.04


@pytest.mark.parametrize("azimuth, elevation, spread", [((2.0, 2.0), (-5.0, 5.0), 1), ((-10.0, 10.0), (0.0, 0.0), 0)])
def test_a_range_flat_in_one_axis_is_sampled_along_the_other(
    azimuth: tuple[float, float], elevation: tuple[float, float], spread: int
) -> None:
    views = sample_views(6, azimuth, elevation)
    assert np.ptp(views[:, 1 - spread]) == 0.0
    assert smallest_distance(views) > 0.4 * (20.0, 10.0)[spread] / 6


def test_a_range_without_extent_repeats_its_only_view() -> None:
    np.testing.assert_array_equal(sample_views(5, (7.0, 7.0), (1.0, 1.0)), np.tile([7.0, 1.0], (5, 1)))


@settings(max_examples=40)
@given(n=st.integers(1, 20), low=st.floats(-300, 300), extent=st.floats(0, 1e-10), seed=st.integers(0, 9))
def test_ranges_with_hardly_any_floats_in_them_end(n: int, low: float, extent: float, seed: int) -> None:
    views = sample_views(n, (low, low + extent), (low, low), seed)
    assert views.shape == (n, 2)
    assert (views[:, 0] >= low).all() and (views[:, 0] <= low + extent).all()


def test_the_seed_alone_decides_the_views() -> None:
    np.testing.assert_array_equal(sample_views(9, seed=(7, 2, 0)), sample_views(9, seed=(7, 2, 0)))
    np.testing.assert_array_equal(sample_views(9, seed=4), sample_views(9, seed=np.int64(4)))
    assert not np.array_equal(sample_views(9, seed=(7, 2, 0)), sample_views(9, seed=(7, 2, 1)))
    assert not np.array_equal(sample_views(9, seed=0), sample_views(9, seed=1))


@pytest.mark.parametrize(
    "wrong, named",
    [
        ({"n": 0}, "views: 0"),
        ({"n": 2.5}, "views: 2.5"),
        ({"n": 3, "azimuth": (5.0, -5.0)}, "azimuth"),
        ({"n": 3, "elevation": (float("nan"), 1.0)}, "elevation"),
        ({"n": 3, "azimuth": (0.0, float("inf"))}, "azimuth"),
        ({"n": 3, "azimuth": (1.0, 2.0, 3.0)}, "azimuth"),
        ({"n": 3, "seed": -1}, "seed"),
        ({"n": 3, "seed": (1, 2.5)}, "seed"),
        ({"n": 3, "seed": None}, "seed"),
    ],
)
def test_bad_arguments_are_named_in_one_line(wrong: dict, named: str) -> None:
    with pytest.raises(InputError, match=named) as error:
        sample_views(**wrong)
    assert "\n" not in str(error.value)
