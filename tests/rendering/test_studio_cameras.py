"""Shots' cameras in the studio: the framing of emission-absorption, light, fire, and where they cannot stand."""

from __future__ import annotations

import dataclasses
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from fields import smooth_noise
from lit_smoke import under_a_sky

import tnst_mi
from tnst_mi.io.cameras.scene_camera import looking
from tnst_mi.rendering.cameras.camera import Camera, Viewpoint
from tnst_mi.rendering.cameras.views import camera_frame
from tnst_mi.rendering.looks import extinction, gamma
from tnst_mi.rendering.studio import Smoke, Studio

SHAPE = (14, 20, 16)
SIZE = (60, 40)

#: With roll and shift, beside and above the smoke, which they do not look at straight.
PERSPECTIVE = {
    "position": (40.0, 22.0, 50.0),
    "target": (2.0, 3.0, -1.0),
    "up": (0.4, 1.0, 0.1),
    "field": 24.0,
    "shift": (0.15, -0.1),
}
ORTHOGRAPHIC = PERSPECTIVE | {"field": 24.0, "perspective": False}


def camera(
    position: tuple[float, float, float],
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    field: float = 30.0,
    shift: tuple[float, float] = (0.0, 0.0),
    perspective: bool = True,
    aspect: float = 1.5,
) -> Camera:
    """In cells about the centre of the grid."""
    return Camera(looking(*map(np.array, (position, target, up))), perspective, field, aspect, shift)


def block() -> np.ndarray:
    density = np.zeros(SHAPE, np.float32)
    density[4:11, 8:17, 5:13] = 1.0
    density[9:12, 15:18, 11:14] = 1.0
    return density


def studio(
    density: np.ndarray, *viewpoints: Viewpoint, look: str = "thick", size: tuple[int, int] = SIZE, burns: bool = False
) -> Studio:
    return Studio(look, "volpath", Smoke.of([density]), viewpoints, size, burns)


def estimate(scene: Studio, density: np.ndarray, viewpoint: Viewpoint, samples: int = 64) -> np.ndarray:
    """As `Studio.render`, all samples in one launch."""
    scene.show(density, viewpoint)
    return mi.render(scene.scene, sensor=scene.sensor, spp=samples, seed=1).numpy()


def bounding_box(seen: np.ndarray) -> tuple[int, int, int, int]:
    rows, columns = np.nonzero(seen)
    return rows.min(), rows.max(), columns.min(), columns.max()


# --- Framing ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("keys", [PERSPECTIVE, ORTHOGRAPHIC], ids=["perspective", "orthographic"])
def test_smoke_is_where_emission_absorption_has_it(keys: dict[str, object]) -> None:
    density, shot = block(), camera(**keys)
    scene = under_a_sky(studio(density, shot), albedo=0.0)
    opacity = 1.0 - estimate(scene, density, shot)[..., 0]
    grey = tnst_mi.render(
        density, gamma=gamma("thick", SHAPE), quadrature="transmittance", camera=shot, size=SIZE[::-1]
    )
    expected = bounding_box(grey > 0.5)
    assert min(expected) > 0 and expected[1] - expected[0] > 15, "all of the smoke is in the picture, and large"
    assert np.abs(np.subtract(bounding_box(opacity > 0.5), expected)).max() <= 1
    # Not only its box: with 64 paths, the noise of a pixel is up to 1/16. Steps of a cell blur the grey edges.
    assert np.abs(opacity - grey).mean() < 0.01
    # Without shift, or mirrored, the picture is another.
    plain = dataclasses.replace(shot, shift=(0.0, 0.0))
    moved = np.subtract(bounding_box(estimate(scene, density, plain)[..., 0] < 0.5), expected)
    # Shifted to the right by 0.15 and down by 0.1 of 40 rows.
    np.testing.assert_allclose(moved, [-4, -4, -6, -6], atol=1)


def test_a_shot_from_where_a_view_looks_shows_the_same_light() -> None:
    """Camera, lamps, ground and sky stand as for the view; the field of view is the vertical one."""
    density, view = np.abs(smooth_noise(np.random.default_rng(3), 8, 8, 8)).astype(np.float32), (35.0, 12.0)
    scene = studio(density, view, look="medium", size=(36, 24))
    slope = math.tan(math.radians(float(scene.parameters["camera.x_fov"][0]) / 2)) / 1.5
    place = 4.5 * 8 * camera_frame(*view)[2]
    shot = camera(tuple(place.tolist()), field=2 * math.degrees(math.atan(slope)))
    ours, theirs = (
        estimate(scene, density, viewpoint, 256).reshape(4, 6, 6, 6, 3).mean((1, 3)) for viewpoint in (shot, view)
    )
    np.testing.assert_allclose(ours, theirs, rtol=0.04)
    assert np.ptp(theirs[..., 0]) > 0.2 * theirs[..., 0].mean(), "there is something to see"


@pytest.mark.parametrize("perspective", [True, False])
def test_lamps_turn_with_the_azimuth_of_the_camera(perspective: bool) -> None:
    """Smoke that looks the same from four sides is lit alike from all of them, wherever the camera looks."""
    density = np.abs(smooth_noise(np.random.default_rng(3), 8, 8, 8)).astype(np.float32)
    density = sum(np.rot90(density, k, axes=(0, 2)) for k in range(4))
    field = 22.0 if perspective else 12.0
    shots = [
        camera((2.0, 8.0, 36.0), (1.0, 0.0, 0.0), field=field, perspective=perspective),
        camera((36.0, 8.0, -2.0), (0.0, 0.0, -1.0), field=field, perspective=perspective),
    ]
    scene = studio(density, *shots, look="medium", size=(36, 24))
    front, side = (estimate(scene, density, shot, 256).reshape(4, 6, 6, 6, 3).mean((1, 3)) for shot in shots)
    np.testing.assert_allclose(front, side, rtol=0.05)
    # The key light stands on the left.
    assert front[1:3, 1:3].mean() > 1.05 * front[1:3, 3:5].mean()


def test_a_camera_close_to_the_smoke_sees_all_of_it() -> None:
    """Uniform smoke of optical thickness 1 along a view through it, 0.03 cells before it: closed form e^−1."""
    density = np.full((8, 8, 8), 1 / extinction("thin"), np.float32)
    shot = camera((0.0, 0.0, 4.03), field=1.0, aspect=1.0)
    scene = under_a_sky(studio(density, shot, look="thin", size=(16, 16)), albedo=0.0)
    found = estimate(scene, density, shot, 64)[..., 0].mean()
    expected = math.exp(-1)
    assert found == pytest.approx(expected, abs=4 * math.sqrt(expected * (1 - expected) / (64 * 256)))


@pytest.mark.parametrize("keys", [PERSPECTIVE, ORTHOGRAPHIC], ids=["perspective", "orthographic"])
def test_fire_is_seen_through_the_camera_of_the_shot(keys: dict[str, object]) -> None:
    """Fire without smoke, whose light is the grey picture of unabsorbed emission: ∫ j ds along each ray."""
    flame, shot = block(), camera(**keys)
    scene = under_a_sky(studio(flame, shot, look="thin", burns=True), albedo=0.0, radiance=0.0)
    # Radiance per longest edge, which is 20 cells.
    found = scene.render(0 * flame, shot, 64, emission=np.repeat(flame[..., None], 3, axis=-1))[..., 1]
    thin = tnst_mi.render(flame, gamma=1e-6, quadrature="exact", camera=shot, size=SIZE[::-1]) / 20
    assert np.abs(np.subtract(bounding_box(found > 0.1), bounding_box(thin > 0.1))).max() <= 1
    assert found.sum() == pytest.approx(thin.sum(), rel=0.03)


@pytest.mark.parametrize("keys", [PERSPECTIVE, ORTHOGRAPHIC], ids=["perspective", "orthographic"])
def test_no_kernel_is_compiled_for_another_camera(keys: dict[str, object]) -> None:
    density = block()
    other = keys | {"position": (-30.0, 40.0, 35.0), "field": 35.0, "shift": (0.0, 0.2), "up": (0.0, 1.0, 0.0)}
    first, second = camera(**keys), camera(**other)
    scene = studio(density, first, second, burns=True)
    emission = np.repeat(density[..., None], 3, axis=-1)
    scene.render(density, first, 2, emission=emission)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        scene.render(density, second, 2, seed=9, emission=emission)
        history = dr.kernel_history([dr.KernelType.JIT])
    assert history and all(kernel["cache_hit"] for kernel in history)


def test_viewpoints_leave_no_trace() -> None:
    density, view = block(), (20.0, 10.0)
    shots = camera(**PERSPECTIVE), camera(**ORTHOGRAPHIC)
    scene = studio(density, view, *shots)
    first = [scene.render(density, viewpoint, 1) for viewpoint in (view, *shots)]
    again = [scene.render(density, viewpoint, 1) for viewpoint in (*reversed(shots), view)]
    for one, two in zip(first, reversed(again), strict=True):
        np.testing.assert_array_equal(one, two)


# --- Where cameras cannot stand ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"position": (0.0, 2.0, 1.0)}, "inside the box of the smoke"),
        ({"position": (0.0, -10.3, 50.0)}, "camera is below the studio's ground"),
        # Its picture begins in a plane through the smoke.
        ({"position": (0.0, 3.0, 0.0), "target": (0.0, 0.0, -9.0), "perspective": False}, "inside the box of the smo"),
        # That plane is beside the smoke, and its lower edge below the ground at y = −10.
        ({"position": (0.0, 4.0, 25.0), "perspective": False}, "picture starts below the studio's ground"),
    ],
)
def test_cameras_that_cannot_stand_in_the_studio(keys: dict[str, object], message: str) -> None:
    density, shot = block(), camera(**keys)
    scene = studio(density, shot)
    with pytest.raises(tnst_mi.InputError, match=message):
        scene.require_place(shot)
    with pytest.raises(tnst_mi.InputError, match=message):
        scene.render(density, shot, 1)


@pytest.mark.parametrize(
    "keys",
    [
        # In the grid, and above the box of the smoke, whose cells end at y = 9.
        {"position": (0.0, 9.1, 0.0), "target": (0.0, 0.0, 1.0)},
        {"position": (0.0, -9.9, 50.0)},
        # Level rays see the ground as a line, also those that start below it.
        {"position": (0.0, 0.0, 25.0), "field": 40.0, "perspective": False},
        # Farther along its axis, the camera of the fourth case above is high enough.
        {"position": (0.0, 10.0, 62.5), "perspective": False},
    ],
)
def test_cameras_that_can(keys: dict[str, object]) -> None:
    density, shot = block(), camera(**keys)
    image = studio(density, shot).render(density, shot, 2)
    assert np.isfinite(image).all() and image.max() > 0.0


# --- Views at a distance ----------------------------------------------------------------------------------


def test_a_view_with_a_distance_is_seen_from_there() -> None:
    density = np.zeros(SHAPE, np.float32)
    density[10:13, 13:16, 11:14] = 1.0  # front, upper right
    position = np.array([12.5, 14.5, 11.5]) - np.array([8, 10, 7])
    views = [(0.0, 0.0, 35.0), (35.0, 20.0, 60.0), (-120.0, 6.0)]
    scene = under_a_sky(studio(density, *views), albedo=0.0)
    slope = math.tan(math.radians(float(scene.parameters["camera.x_fov"][0]) / 2)) / (SIZE[0] / 2)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    for view in views:
        right, up, towards = camera_frame(*view[:2])
        opacity = 1.0 - estimate(scene, density, view)[..., 0]
        centre = np.array([(opacity * (x - SIZE[0] / 2)).sum(), (opacity * (SIZE[1] / 2 - y)).sum()]) / opacity.sum()
        distance = view[2] if len(view) == 3 else 90.0
        found = centre * slope * (distance - towards @ position)
        np.testing.assert_allclose(found, [right @ position, up @ position], atol=0.25)


@pytest.mark.parametrize(
    ("view", "message"),
    [
        ((10.0, 0.0, 8.0), "view 10,0,8: from so near no picture shows all of the grid"),
        ((0.0, -40.0, 30.0), "view 0,-40: the camera would be below the ground; expected an elevation above -19.5"),
    ],
)
def test_views_from_too_near_or_below_are_refused(view: tuple[float, float, float], message: str) -> None:
    with pytest.raises(tnst_mi.InputError, match=message):
        studio(block(), view)


def test_no_kernel_is_compiled_after_images_of_another_extinction() -> None:
    """A path tracer's code is that of all media of the process, so no γ may be a part of it."""
    density, view = block(), (20.0, 10.0)
    scene = studio(density, view)
    tnst_mi.render(density, [view], 0.21)
    scene.render(density, view, 1)
    tnst_mi.render(density, [view], 0.22)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        scene.render(density, view, 1, seed=9)
        history = dr.kernel_history([dr.KernelType.JIT])
    assert history and all(kernel["cache_hit"] and not kernel["cache_disk"] for kernel in history)
