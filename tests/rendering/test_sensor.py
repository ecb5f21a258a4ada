"""The `camera_views` sensor: where its rays start and point, and the order of the views on the film."""

from __future__ import annotations

import itertools

import mitsuba as mi
import numpy as np
import pytest
from ray_march import camera_axes, pixel_centres
from smoke_scenes import film

VIEWS = [(0.0, 0.0), (37.0, -12.0), (-100.0, 65.0)]
WIDTH, HEIGHT, SPACING, DISTANCE = 5, 4, 1.8, 70.0


def sensor(view_count: int = len(VIEWS), height: int = HEIGHT * len(VIEWS)) -> mi.Sensor:
    description = {"type": "camera_views", "view_count": view_count, "spacing": SPACING, "distance": DISTANCE}
    return mi.load_dict(description | film(WIDTH, height))


def rays(sensor: mi.Sensor, differential: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (views, H, W, 3) through the pixel centres, rows from the top of the film."""
    width, height = sensor.film().size()
    row, column = np.divmod(np.arange(width * height), width)
    position = mi.Point2f((column + 0.5) / width, (row + 0.5) / height)
    sample = sensor.sample_ray_differential if differential else sensor.sample_ray
    ray, weight = sample(0.0, 0.0, position, mi.Point2f(0.5))
    np.testing.assert_array_equal(weight.numpy(), 1)
    shape = (-1, HEIGHT, WIDTH, 3)
    return tuple(np.float64(np.broadcast_to(v, (3, len(row)))).T.reshape(shape) for v in (ray.o, ray.d))


@pytest.mark.parametrize("differential", [False, True])
def test_rays_of_all_views_from_the_top_of_the_film_down(differential: bool) -> None:
    camera = sensor()
    camera.set_views(VIEWS)
    origins, directions = rays(camera, differential)
    for view, o, d in zip(VIEWS, origins, directions, strict=True):
        towards = camera_axes(view)[2]
        expected = pixel_centres((1, HEIGHT, WIDTH), view, SPACING) + DISTANCE * towards
        np.testing.assert_allclose(o.reshape(-1, 3), expected, rtol=0, atol=2e-5)
        np.testing.assert_allclose(d.reshape(-1, 3), np.broadcast_to(-towards, (HEIGHT * WIDTH, 3)), rtol=0, atol=1e-6)


def test_before_views_are_set_all_look_along_minus_z() -> None:
    _, directions = rays(sensor())
    np.testing.assert_array_equal(directions, np.broadcast_to([0.0, 0.0, -1.0], directions.shape))


def test_views_can_be_moved_again() -> None:
    camera = sensor()
    camera.set_views(VIEWS)
    camera.set_views(VIEWS[::-1])
    _, directions = rays(camera)
    expected = [-camera_axes(view)[2] for view in VIEWS[::-1]]
    np.testing.assert_allclose(directions[:, 0, 0], expected, rtol=0, atol=1e-6)


def test_no_view_bleeds_into_the_next() -> None:
    """The whole height of a view belongs to it, up to the last float32 row before the next one."""
    camera = sensor()
    camera.set_views(VIEWS)
    edges = np.arange(len(VIEWS) + 1) / len(VIEWS)
    for view, (top, bottom) in zip(VIEWS, itertools.pairwise(edges), strict=True):
        ray, _ = camera.sample_ray(0.0, 0.0, mi.Point2f(0.5, [top + 1e-5, bottom - 1e-5]), mi.Point2f(0.5))
        _, up, towards = camera_axes(view)
        np.testing.assert_allclose(ray.d.numpy().T, [-towards, -towards], rtol=0, atol=1e-6)
        heights = up @ ray.o.numpy()
        np.testing.assert_allclose(heights, [HEIGHT * SPACING / 2, -HEIGHT * SPACING / 2], rtol=0, atol=2e-3)
    last, _ = camera.sample_ray(0.0, 0.0, mi.Point2f(0.5, 1.0), mi.Point2f(0.5))
    np.testing.assert_allclose(last.d.numpy().T, [-camera_axes(VIEWS[-1])[2]], rtol=0, atol=1e-6)


@pytest.mark.parametrize(("view_count", "height"), [(3, 10), (0, 10), (-1, 10), (11, 10)])
def test_a_film_that_the_views_do_not_fill_is_an_error(view_count: int, height: int) -> None:
    with pytest.raises((ValueError, RuntimeError), match=rf'height {height} cannot show "view_count" = {view_count} '):
        sensor(view_count, height)


@pytest.mark.parametrize("views", [[], VIEWS[:2], [*VIEWS, (1.0, 2.0)]])
def test_another_number_of_views_is_an_error(views: list) -> None:
    with pytest.raises(ValueError, match=rf"{len(views)} views given, expected 3"):
        sensor().set_views(views)
