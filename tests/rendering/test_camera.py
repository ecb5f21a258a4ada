"""The camera of a shot: what is refused, how it moves with a world, and the centred view from where it stands."""

from __future__ import annotations

import numpy as np
import pytest
from ray_march import camera_axes

from tnst_mi import Camera
from tnst_mi.errors import InputError


def placed(axes: np.ndarray, position: np.ndarray) -> np.ndarray:
    """The to_world of a camera with these axes (rows right, up, towards) at a position."""
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = axes.T, position
    return to_world


def rolled(axes: np.ndarray, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ axes


VIEWS = [(0.0, 0.0, 80.0), (37.0, -12.0, 55.0), (-160.0, 70.0, 300.0), (0.0, 90.0, 60.0)]


@pytest.mark.parametrize("view", VIEWS)
def test_zoom_pan_roll_and_shift_leave_the_centred_view_alone(view: tuple[float, float, float]) -> None:
    axes = camera_axes(view[:2])
    position = view[2] * axes[2]
    panned = camera_axes((view[0] + 4, max(view[1] - 7, -80)))
    for turned in (axes, rolled(axes, 33), rolled(panned, -120)):
        for field, shift in ((20, (0, 0)), (70, (0.3, -0.2))):
            camera = Camera(placed(turned, position), True, field, 1.6, shift)
            np.testing.assert_allclose(camera.centred_view, view, rtol=1e-9, atol=1e-9)
            assert len(Camera(placed(turned, position), False, field, 1.6, shift).centred_view) == 2


def test_an_orthographic_camera_has_the_view_that_it_looks_from_wherever_it_is() -> None:
    camera = Camera(placed(rolled(camera_axes((25.0, -40.0)), 15), np.array([300.0, 1.0, 2.0])), False, 80, 1.0)
    np.testing.assert_allclose(camera.centred_view, (25.0, -40.0), rtol=1e-12)


def test_a_camera_moves_with_its_world() -> None:
    """Points keep their places in its image: in its own axes they are the same, but for the scale."""
    rng = np.random.default_rng(1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    similarity = np.eye(4)
    similarity[:3, :3], similarity[:3, 3] = 2.5 * turn, (4, -7, 9)
    points = rng.normal(size=(10, 3))
    for perspective in (True, False):
        camera = Camera(placed(camera_axes((20, 30)), np.array([10.0, -3.0, 4.0])), perspective, 40, 1.2, (0.1, 0.2))
        moved = camera.moved(similarity)
        before = (points - camera.position) @ camera.axes.T
        after = (points @ similarity[:3, :3].T + similarity[:3, 3] - moved.position) @ moved.axes.T
        np.testing.assert_allclose(after, 2.5 * before, rtol=1e-12, atol=1e-12)
        assert moved.field == pytest.approx(40 if perspective else 100)
        assert (moved.aspect, moved.shift) == (camera.aspect, camera.shift)


def test_equal_cameras_are_one_key() -> None:
    first, second = (Camera(np.eye(4), True, 40, 1.5, (0, 0)) for _ in range(2))
    assert {first: 1}[second] == 1
    assert Camera(np.eye(4).tolist(), True, 41, 1.5) != first


def test_a_matrix_in_single_precision_becomes_a_rotation() -> None:
    axes = np.float32(rolled(camera_axes((37.0, -12.0)), 17))
    camera = Camera(placed(axes, np.zeros(3)), True, 40, 1.5)
    np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), rtol=0, atol=1e-15)
    np.testing.assert_allclose(camera.axes, axes, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"to_world": np.eye(3)}, "to_world"),
        ({"to_world": "front"}, "to_world"),
        ({"to_world": [[1, 2], [3]]}, "to_world"),
        ({"to_world": np.eye(4) * np.nan}, "to_world"),
        ({"to_world": np.diag([2.0, 2.0, 2.0, 1.0])}, "scales"),
        ({"to_world": np.diag([-1.0, 1.0, 1.0, 1.0])}, "mirrors"),
        ({"to_world": np.eye(4) + np.eye(4)[[3, 0, 1, 2]].T}, "last row"),
        ({"field": 0}, "field 0"),
        ({"field": 180}, "field 180"),
        ({"field": -1, "perspective": False}, "field -1"),
        ({"field": np.inf}, "field inf"),
        ({"aspect": 0}, "aspect 0"),
        ({"aspect": np.nan}, "aspect nan"),
        ({"shift": (1.0,)}, "shift"),
        ({"shift": (np.inf, 0.0)}, "shift"),
    ],
)
def test_bad_arguments_are_named_in_one_line(wrong: dict, named: str) -> None:
    good = {"to_world": np.eye(4), "perspective": True, "field": 40, "aspect": 1.5}
    with pytest.raises(InputError, match=f"^camera: .*{named}.*expected|^camera: .*{named}") as error:
        Camera(**(good | wrong))
    assert "\n" not in str(error.value)


def test_moves_that_are_no_similarities_and_a_camera_in_the_centre_are_refused() -> None:
    camera = Camera(np.eye(4), True, 40, 1.5)
    for matrix in (np.diag([1.0, 1, -1, 1]), np.diag([1.0, 1, 2, 1]), np.diag([0.0, 0, 0, 1])):
        with pytest.raises(InputError, match="expected a similarity"):
            camera.moved(matrix)
    with pytest.raises(InputError, match="at the centre"):
        _ = camera.centred_view
