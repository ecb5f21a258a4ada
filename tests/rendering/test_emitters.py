"""The `emission_absorption` plugin among other things: a sky, lights and surfaces behind, before and in the smoke."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import ray_march
from fields import directional_error, smooth_noise
from smoke_scenes import (
    EXTINCTION,
    error_message,
    extinction_gradient,
    extinction_objective,
    extinction_of,
    image_of,
    orthographic,
    plate,
    smoke_scene,
)

import tnst_mi

SHAPE = (11, 12, 8)
VIEW = (37.0, -12.0)
GAMMA = 0.5
BOUNDARIES = {"box": None, "sphere": {"type": "sphere", "radius": 3.7}}


def smoke(seed: int) -> np.ndarray:
    """A density that does not vanish at the walls of its grid."""
    return np.abs(smooth_noise(np.random.default_rng(seed), *SHAPE)) + 0.05


@pytest.mark.parametrize("quadrature", ["paper", "exact", "transmittance", "integrated_transmittance"])
def test_an_environment_behind_is_multiplied_by_the_transmittance(quadrature: str) -> None:
    rng = np.random.default_rng(9)
    density, sky = smoke(9), 0.7
    scene = smoke_scene(
        GAMMA * density,
        orthographic(SHAPE, VIEW),
        {"gamma": GAMMA, "quadrature": quadrature},
        sky={"type": "constant", "radiance": sky},
    )
    transmittance = 1 - tnst_mi.render(density, VIEW, GAMMA, "transmittance")
    expected = tnst_mi.render(density, VIEW, GAMMA, quadrature) + sky * transmittance
    np.testing.assert_allclose(image_of(scene), expected, rtol=0, atol=2e-5)

    weights = smooth_noise(rng, *SHAPE[1:], 1)
    start, objective = extinction_of(scene), extinction_objective(scene, weights)
    directions = [smooth_noise(rng, *SHAPE)[..., None] for _ in range(16)]
    gradient = extinction_gradient(scene, weights)
    assert directional_error(objective, gradient, start, directions, 5e-3) <= 1e-3

    parameters, leaf = mi.traverse(scene), mi.TensorXf(start)
    dr.enable_grad(leaf)
    parameters[EXTINCTION] = leaf
    parameters.update()
    dr.set_grad(leaf, mi.TensorXf(directions[0]))
    tangent = dr.forward_to(mi.render(scene, parameters)).numpy()
    assert (tangent * weights).sum() == pytest.approx((gradient * directions[0]).sum(), rel=1e-4)


@pytest.mark.parametrize("where", ["behind", "in front"])
@pytest.mark.parametrize("lit", [True, False])
@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_a_plate_is_attenuated_behind_the_smoke_and_hides_it_in_front(boundary: str, lit: bool, where: str) -> None:
    extinction, radiance, sky = GAMMA * smoke(10), 2.0 if lit else 0.0, 0.5

    def image(quadrature: str, **others: dict) -> np.ndarray:
        integrator = {"gamma": GAMMA, "quadrature": quadrature}
        shape = BOUNDARIES[boundary]
        return image_of(smoke_scene(extinction, orthographic(SHAPE, VIEW), integrator, boundary=shape, **others))

    # A black plate hides what is behind it; the sky goes around the plate.
    placed = plate(VIEW, -40 if where == "behind" else 40, emitter={"type": "area", "radiance": radiance})
    row, column = np.indices(SHAPE[1:])
    covered = (np.abs(row - (SHAPE[1] - 1) / 2) < 3) & (np.abs(column - (SHAPE[2] - 1) / 2) < 3)
    transmittance = 1 - image("transmittance")
    expected = image("paper") + transmittance * np.where(covered & (where == "behind"), radiance, sky)
    if where == "in front":
        expected = np.where(covered, radiance, expected)
    shown = image("paper", plate=placed, sky={"type": "constant", "radiance": sky})
    np.testing.assert_allclose(shown, expected, rtol=0, atol=2e-5)
    assert transmittance[covered].max() < 0.9


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_smoke_hidden_by_a_plate_has_no_gradient(boundary: str) -> None:
    extinction, weights = GAMMA * smoke(10), smooth_noise(np.random.default_rng(10), *SHAPE[1:], 1)
    others = {"sky": {"type": "constant", "radiance": 0.5}}
    row, column = np.indices(SHAPE[1:])
    covered = (np.abs(row - (SHAPE[1] - 1) / 2) < 3) & (np.abs(column - (SHAPE[2] - 1) / 2) < 3)

    def gradient(weights: np.ndarray, **others: dict) -> np.ndarray:
        shape = BOUNDARIES[boundary]
        scene = smoke_scene(extinction, orthographic(SHAPE, VIEW), {"gamma": GAMMA}, boundary=shape, **others)
        return extinction_gradient(scene, weights)

    hidden = gradient(weights, plate=plate(VIEW, 40, emitter={"type": "area", "radiance": 0.0}), **others)
    expected = gradient(weights * ~covered[..., None], **others)
    np.testing.assert_allclose(hidden, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_rays_that_miss_the_smoke_see_the_sky() -> None:
    sensor = orthographic((1, 30, 40))
    scene = smoke_scene(GAMMA * smoke(11), sensor, {"gamma": GAMMA}, sky={"type": "constant", "radiance": 0.25})
    image = image_of(scene)
    np.testing.assert_allclose(image[:5], 0.25, rtol=1e-6)
    rows, columns = (30 - SHAPE[1]) // 2, (40 - SHAPE[2]) // 2
    assert np.abs(image[rows:-rows, columns:-columns] - 0.25).min() > 1e-3


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_a_surface_inside_the_smoke_ends_the_march(boundary: str) -> None:
    """A plate through the middle: in front of it half of the samples, behind it none; light and gradient alike."""
    density, radiance = smoke(12), 0.8
    sensor = orthographic(SHAPE)
    scene = smoke_scene(
        GAMMA * density,
        sensor,
        {"gamma": GAMMA},
        boundary=BOUNDARIES[boundary],
        wall={
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, 0.7]).scale(20),
            "emitter": {"type": "area", "radiance": radiance},
        },
    )
    edges, origins = np.diag(SHAPE[::-1]).astype(float), ray_march.pixel_centres(SHAPE, (0.0, 0.0), 1.0)
    origins[:, 2] += 100
    inside = {"box": lambda points: points[..., 2] > 0.7}
    inside["sphere"] = lambda points: (points[..., 2] > 0.7) & ((points**2).sum(-1) <= 3.7**2)
    directions = np.broadcast_to([0, 0, -1.0], origins.shape)
    values = ray_march.samples(density, edges, np.zeros(3), origins, directions, 1.0, inside[boundary])
    transmittance = 1 - ray_march.radiance(values, GAMMA, 1.0, "transmittance")
    expected = ray_march.radiance(values, GAMMA, 1.0, "paper") + transmittance * radiance
    np.testing.assert_allclose(image_of(scene), expected.reshape(SHAPE[1:]), rtol=0, atol=1e-4)

    weights = smooth_noise(np.random.default_rng(12), *SHAPE[1:], 1)
    start, objective = extinction_of(scene), extinction_objective(scene, weights)
    directions = [smooth_noise(np.random.default_rng(seed), *SHAPE)[..., None] for seed in range(8)]
    gradient = extinction_gradient(scene, weights)
    assert np.abs(gradient[:5]).max() == 0 < np.abs(gradient[6:]).max()
    assert directional_error(objective, gradient, start, directions, 1e-2) <= 1e-3


@pytest.mark.parametrize("where", [-40, 0])
@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_a_surface_that_is_not_an_emitter_needs_a_nested_integrator(boundary: str, where: float) -> None:
    scene = smoke_scene(
        GAMMA * smoke(12),
        orthographic(SHAPE, VIEW),
        {"gamma": GAMMA},
        boundary=BOUNDARIES[boundary],
        plate=plate(VIEW, where),
        sky={"type": "constant"},
    )
    with pytest.raises(RuntimeError) as error:
        mi.render(scene)
    message = error_message(error.value)
    assert message.startswith("emission_absorption: a surface is seen that is not an emitter") and "nested" in message


def test_a_surface_beside_the_medium_is_none() -> None:
    density, ball = smoke(12), {"type": "sphere", "center": [30, 0, 0], "radius": 2.0}
    scene = smoke_scene(GAMMA * density, orthographic(SHAPE, VIEW), {"gamma": GAMMA}, ball=ball)
    np.testing.assert_allclose(image_of(scene), tnst_mi.render(density, VIEW, GAMMA), rtol=0, atol=1e-4)


def test_grey_smoke_before_a_coloured_sky_on_a_colour_film() -> None:
    density, sky = smoke(14), np.array([0.9, 0.5, 0.1])
    scene = smoke_scene(
        GAMMA * density,
        orthographic(SHAPE, VIEW, "rgb"),
        {"gamma": GAMMA},
        sky={"type": "constant", "radiance": {"type": "rgb", "value": sky.tolist()}},
    )
    transmittance = 1 - tnst_mi.render(density, VIEW, GAMMA, "transmittance")[..., None]
    expected = tnst_mi.render(density, VIEW, GAMMA)[..., None] + sky * transmittance
    np.testing.assert_allclose(mi.render(scene).numpy(), expected, rtol=0, atol=1e-4)

    rng = np.random.default_rng(14)
    weights, direction = smooth_noise(rng, *SHAPE[1:], 3), smooth_noise(rng, *SHAPE)[..., None]
    gradient, start = extinction_gradient(scene, weights), (GAMMA * density)[..., None]
    objective = extinction_objective(scene, weights)
    assert directional_error(objective, gradient, start, [direction], 5e-3) <= 1e-3
