"""The `emission_absorption` plugin in scenes that are not ours: any sensor, transform, boundary, sampler and colour."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import ray_march
from fields import directional_error, smooth_noise
from ray_march import camera_axes
from smoke_scenes import (
    EXTINCTION,
    affine,
    cube,
    error_message,
    extinction_gradient,
    extinction_objective,
    extinction_of,
    film,
    image_of,
    orthographic,
    plate,
    smoke_scene,
)

import tnst_mi

SHAPE = (11, 12, 8)
QUADRATURES = ("paper", "exact", "transmittance", "integrated_transmittance")
VIEW = (37.0, -12.0)
GAMMA = 0.5


def smoke(seed: int, *shape: int) -> np.ndarray:
    """A density that does not vanish at the walls of its grid."""
    return np.abs(smooth_noise(np.random.default_rng(seed), *(shape or SHAPE))) + 0.05


def density_gradient(density: np.ndarray, weights: np.ndarray, quadrature: str) -> np.ndarray:
    """Gradient of the weighted sum of `tnst_mi.render`'s image with respect to the density."""
    leaf = mi.TensorXf(density)
    dr.enable_grad(leaf)
    dr.backward(dr.sum(tnst_mi.render(leaf, VIEW, GAMMA, quadrature) * mi.TensorXf(weights), axis=None))
    return dr.grad(leaf).numpy()


# --------------------------------------------------------------------
# Images and gradients
# --------------------------------------------------------------------


@pytest.mark.parametrize("quadrature", QUADRATURES)
@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_a_foreign_scene_shows_what_render_shows(quadrature: str, scale: float) -> None:
    """Mitsuba's own sensor, a scattering medium, the default step; γ ∂/∂σ_t is the gradient of the density."""
    density = smoke(1)
    integrator = {"gamma": GAMMA, "quadrature": quadrature}
    scene = smoke_scene(GAMMA * density, orthographic(SHAPE, VIEW), integrator, scale=scale)
    expected = tnst_mi.render(density, VIEW, GAMMA, quadrature)
    np.testing.assert_allclose(image_of(scene), expected, rtol=0, atol=1e-4)

    weights = smooth_noise(np.random.default_rng(1), *SHAPE[1:], 1)
    gradient = extinction_gradient(scene, weights)[..., 0] * GAMMA / scale
    expected = density_gradient(density, weights[..., 0], quadrature)
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


#: Edges of the grid's box as columns: rotated, with flat cells, sheared.
_turn = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
EDGES = {
    "rotated": _turn @ np.diag([8.0, 12.0, 11.0]),
    "flat cells": _turn @ np.diag([4.0, 2.0, 9.0]),
    "sheared": _turn @ np.diag([8.0, 12.0, 11.0]) @ [[1, 0.4, 0], [0, 1, -0.3], [0, 0, 1]],
}


@pytest.mark.parametrize("camera", ["outside", "inside"])
@pytest.mark.parametrize("boundary", ["box", "smaller box", "sphere"])
@pytest.mark.parametrize("placement", EDGES)
def test_any_transform_boundary_and_camera_against_a_numpy_march(placement: str, boundary: str, camera: str) -> None:
    edges, centre = EDGES[placement], np.array([3.0, -2.0, 1.5])
    radius = 0.4 * np.linalg.norm(edges, axis=0).min()
    shapes, inside = {"box": None}, {"box": None}
    shapes["sphere"] = {"type": "sphere", "center": centre.tolist(), "radius": radius}
    inside["sphere"] = lambda points: ((points - centre) ** 2).sum(-1) <= radius**2
    shapes["smaller box"] = cube(affine(0.35 * edges, centre))
    inside["smaller box"] = lambda points: (np.abs((points - centre) @ np.linalg.inv(edges).T) <= 0.35).all(-1)
    towards = np.array([0.36, 0.48, 0.8])
    origin = centre + towards * (0.3 * radius if camera == "inside" else 2 * np.linalg.norm(edges))
    width, height = 24, 18
    sensor = {
        "type": "perspective",
        "fov": 80 if camera == "inside" else 25,
        "near_clip": 1e-3,
        "to_world": mi.ScalarTransform4f().look_at(origin.tolist(), centre.tolist(), [0, 1, 0]),
        **film(width, height),
    }
    scale, density = 0.7, smoke(2)
    scene = smoke_scene(GAMMA * density, sensor, {"gamma": GAMMA}, edges, centre, scale, shapes[boundary])

    row, column = np.divmod(np.arange(width * height), width)
    position = mi.Point2f((column + 0.5) / width, (row + 0.5) / height)
    rays, _ = scene.sensors()[0].sample_ray(0.0, 0.0, position, mi.Point2f(0.5))
    origins, directions = (np.float64(vectors).T for vectors in (rays.o, rays.d))
    step = (np.linalg.norm(edges, axis=0) / SHAPE[::-1]).min()
    values = ray_march.samples(density, edges, centre, origins, directions, step, inside[boundary])
    expected = ray_march.radiance(values, GAMMA, step, "paper").reshape(height, width)
    assert (expected > 0).mean() > 0.03
    np.testing.assert_allclose(image_of(scene), expected, rtol=0, atol=1e-4 * expected.max())


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_gradient_against_central_differences_with_everything_at_once(quadrature: str) -> None:
    """A sheared grid in a sphere, the camera inside it, a scale, a plate behind, a coloured sky, several samples."""
    rng, scale, centre = np.random.default_rng(20), 0.7, np.array([1.0, -2.0, 0.5])
    to_world = mi.ScalarTransform4f().look_at((centre + np.array([0.5, 1, 2.5])).tolist(), centre.tolist(), [0, 1, 0])
    sensor = {"type": "perspective", "fov": 80, "near_clip": 1e-3, "to_world": to_world, **film(9, 8, "rgb")}
    sensor["sampler"] = {"type": "stratified", "sample_count": 4, "jitter": False}
    scene = smoke_scene(
        GAMMA * smoke(20),
        sensor,
        {"gamma": GAMMA, "quadrature": quadrature},
        EDGES["sheared"],
        centre,
        scale,
        {"type": "sphere", "center": centre.tolist(), "radius": 4.5},
        plate=plate(VIEW, -20, emitter={"type": "area", "radiance": 2.0}),
        sky={"type": "constant", "radiance": {"type": "rgb", "value": [0.9, 0.5, 0.1]}},
    )
    weights = smooth_noise(rng, 8, 9, 3)
    start, objective = extinction_of(scene), extinction_objective(scene, weights)
    directions = [smooth_noise(rng, *SHAPE)[..., None] for _ in range(16)]
    gradient = extinction_gradient(scene, weights)
    assert directional_error(objective, gradient, start, directions, 1e-2) <= 1e-3
    assert 0.1 < (gradient != 0).mean() < 1, "cells outside the sphere or out of sight have no gradient"


def test_several_samples_of_a_pixel_are_averaged() -> None:
    """2×2 samples in the middles of a pixel's quarters: a film of twice the resolution, averaged."""
    density = smoke(21)
    weights = smooth_noise(np.random.default_rng(21), *SHAPE[1:], 1)
    coarse_sensor, fine_sensor = orthographic(SHAPE, VIEW), orthographic(SHAPE, VIEW)
    coarse_sensor["sampler"] = {"type": "stratified", "sample_count": 4, "jitter": False}
    fine_sensor |= film(2 * SHAPE[2], 2 * SHAPE[1])
    coarse, fine = (smoke_scene(GAMMA * density, sensor, {"gamma": GAMMA}) for sensor in (coarse_sensor, fine_sensor))
    quarters = image_of(fine)
    averaged = sum(quarters[i::2, j::2] for i in (0, 1) for j in (0, 1)) / 4
    np.testing.assert_allclose(image_of(coarse), averaged, rtol=0, atol=1e-5)
    expected = extinction_gradient(fine, np.kron(weights[..., 0], np.full((2, 2), 0.25, np.float32))[..., None])
    gradient = extinction_gradient(coarse, weights)
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("step", [0.37, 2.5])
def test_the_step_is_a_world_length(step: float) -> None:
    density = smoke(3)
    sensor = orthographic(SHAPE, VIEW)
    scene = smoke_scene(GAMMA * density, sensor, {"gamma": GAMMA, "step": step})
    towards = camera_axes(VIEW)[2]
    origins = ray_march.pixel_centres(SHAPE, VIEW, 1.0) + 50 * towards
    directions = np.broadcast_to(-towards, origins.shape)
    edges = np.diag(SHAPE[::-1]).astype(float)
    values = ray_march.samples(density, edges, np.zeros(3), origins, directions, step)
    expected = ray_march.radiance(values, GAMMA, step, "paper").reshape(SHAPE[1:])
    # Mitsuba computes these rays through two matrices: their rounding moves the samples by 1e-5 cells.
    np.testing.assert_allclose(image_of(scene), expected, rtol=0, atol=1e-4 * expected.max())


def test_changed_parameters_show_in_the_next_image() -> None:
    """New values, another resolution with its own default step, another scale."""
    sensor, integrator = orthographic(SHAPE, VIEW), {"gamma": GAMMA}
    scene = smoke_scene(GAMMA * smoke(4), sensor, integrator)
    image_of(scene)
    parameters = mi.traverse(scene)
    for seed, shape in ((5, SHAPE), (6, (22, 24, 16))):
        extinction = GAMMA * smoke(seed, *shape)
        parameters[EXTINCTION] = mi.TensorXf(extinction[..., None])
        parameters.update()
        fresh = smoke_scene(extinction, sensor, integrator, edges=np.diag(SHAPE[::-1]).astype(float))
        np.testing.assert_allclose(image_of(scene), image_of(fresh), rtol=0, atol=1e-5)
    parameters["smoke.interior_medium.scale"] = 1.7
    parameters.update()
    fresh = smoke_scene(1.7 * extinction, sensor, integrator, edges=np.diag(SHAPE[::-1]).astype(float))
    np.testing.assert_allclose(image_of(scene), image_of(fresh), rtol=0, atol=1e-5)


def test_every_parameter_that_the_plugin_exposes_can_be_set() -> None:
    scene = smoke_scene(GAMMA * smoke(4), orthographic(SHAPE, VIEW), {"gamma": GAMMA, "step": 1.0})
    parameters = mi.traverse(scene)
    for key in [key for key in parameters.keys() if key.startswith("integrator.")]:
        before = image_of(scene)
        parameters[key] = 2.0
        parameters.update()
        assert np.abs(image_of(scene) - before).max() > 1e-2, key


def test_one_integrator_serves_two_scenes_in_turn() -> None:
    scenes = [smoke_scene(GAMMA * smoke(seed), orthographic(SHAPE, VIEW), {"gamma": GAMMA}) for seed in (7, 8)]
    own = [image_of(scene) for scene in scenes]
    integrator = scenes[0].integrator()
    for i in (0, 1, 0, 1):
        shared = mi.render(scenes[i], integrator=integrator).numpy()[..., 0]
        np.testing.assert_array_equal(shared, own[i])


# --------------------------------------------------------------------
# Colour
# --------------------------------------------------------------------


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_each_channel_of_a_coloured_medium_is_a_grey_medium(quadrature: str) -> None:
    colours = smoke(13, *SHAPE, 3)
    channels = [np.ascontiguousarray(colours[..., c]) for c in range(3)]
    sensor = orthographic(SHAPE, VIEW, "rgb")
    scene = smoke_scene(GAMMA * colours, sensor, {"gamma": GAMMA, "quadrature": quadrature}, scale=1.5)
    expected = np.stack([tnst_mi.render(channel, VIEW, GAMMA, quadrature) for channel in channels], -1)
    assert np.abs(expected[..., 0] - expected[..., 1]).max() > 0.05
    np.testing.assert_allclose(mi.render(scene).numpy(), expected, rtol=0, atol=1e-4)

    weights = smooth_noise(np.random.default_rng(13), *SHAPE[1:], 3)
    expected = np.stack(
        [density_gradient(d, np.ascontiguousarray(weights[..., c]), quadrature) for c, d in enumerate(channels)], -1
    )
    gradient = extinction_gradient(scene, weights) * GAMMA / 1.5
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


# --------------------------------------------------------------------
# Scenes and properties that cannot be rendered
# --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("properties", "named"),
    [
        ({"gamma": 0.0}, '"gamma" is 0.0, expected'),
        ({"gamma": -2.0}, '"gamma" is -2.0, expected'),
        ({"gamma": float("nan")}, '"gamma" is nan, expected'),
        ({"gamma": float("inf")}, '"gamma" is inf, expected'),
        ({"step": 0.0}, '"step" is 0.0, expected'),
        ({"step": -1.0}, '"step" is -1.0, expected'),
        ({"step": float("inf")}, '"step" is inf, expected'),
        ({"quadrature": "simpson"}, "\"quadrature\" is 'simpson', expected one of paper, exact, transmittance, "),
        ({"gama": 1.0}, '"gama"'),
    ],
)
def test_bad_properties_are_named(properties: dict, named: str) -> None:
    with pytest.raises((RuntimeError, ValueError)) as error:
        mi.load_dict({"type": "emission_absorption", **properties})
    assert named in str(error.value)


def test_a_scene_without_a_medium_is_an_error() -> None:
    scene = mi.load_dict(
        {"type": "scene", "integrator": {"type": "emission_absorption"}, "sensor": orthographic(SHAPE)}
    )
    with pytest.raises(RuntimeError) as error:
        mi.render(scene)
    assert "the scene has no medium, expected one" in error_message(error.value)
