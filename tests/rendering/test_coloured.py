"""Smoke in colour: against a numpy march, the grey image, closed forms, finite differences, and in scenes."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import ray_march
import torch
from fields import directional_error, smooth_noise
from smoke_scenes import error_message, orthographic, smoke_scene

import tnst_mi

SHAPE = (10, 14, 9)
QUADRATURES = ("paper", "exact", "transmittance", "integrated_transmittance")
VIEWS = [(0.0, 0.0), (37.0, -12.0), (123.0, 48.0)]
VIEW = (37.0, -12.0)
GAMMA = 0.5


def smoke(seed: int) -> np.ndarray:
    """A density with a hole, and without smoke in its nearest planes."""
    density = np.abs(smooth_noise(np.random.default_rng(seed), *SHAPE)) + 0.05
    density[4:6, 5:9, 3:6] = density[8:] = 0
    return density


def colours(seed: int) -> np.ndarray:
    """Colours in [0, 1] that vary from cell to cell."""
    return np.random.default_rng(seed).random((*SHAPE, 3)).astype(np.float32)


def marched(density: np.ndarray, colour: np.ndarray, view: tuple[float, float], quadrature: str) -> np.ndarray:
    """The image (H, W, 3) by a float64 march: the white share of every sample, times the colour there."""
    towards = ray_march.camera_axes(view)[2]
    edges = np.diag(SHAPE[::-1]).astype(float)
    origins = ray_march.pixel_centres(SHAPE, view, 1.0) + 2 * np.linalg.norm(edges) * towards
    place = (edges, np.zeros(3), origins, np.broadcast_to(-towards, origins.shape), 1.0)
    values, exists = (ray_march.samples(grid, *place) for grid in (density, np.ones_like(density)))
    T = np.exp(-GAMMA * np.cumsum(values, -1))
    before = np.concatenate([np.ones_like(T[:, :1]), T[:, :-1]], axis=1)
    shares = {
        "paper": values * T,
        "exact": (before - T) / GAMMA,
        "transmittance": before - T,
        "integrated_transmittance": exists * T,
    }[quadrature]
    channels = [(shares * ray_march.samples(colour[..., c], *place)).sum(-1) for c in range(3)]
    return np.stack(channels, -1).reshape(*SHAPE[1:], 3)


def gradients(
    density: np.ndarray, colour: np.ndarray, weights: np.ndarray, *arguments: object
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the weighted sum of the image(s) with respect to density and colour."""
    leaves = mi.TensorXf(density), mi.TensorXf(colour)
    dr.enable_grad(leaves)
    images = tnst_mi.render(leaves[0], *arguments, colour=leaves[1])
    dr.backward(dr.sum(images * mi.TensorXf(weights), axis=None))
    return dr.grad(leaves[0]).numpy(), dr.grad(leaves[1]).numpy()


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_images_against_a_numpy_march(quadrature: str) -> None:
    density, colour = smoke(1), colours(1)
    for view, image in zip(VIEWS, tnst_mi.render(density, VIEWS, GAMMA, quadrature, colour=colour), strict=True):
        expected = marched(density, colour, view, quadrature)
        np.testing.assert_allclose(image, expected, rtol=0, atol=1e-4 * expected.max(), err_msg=str(view))


@pytest.mark.parametrize("view", [VIEWS, (20.0, 5.0, 40.0)], ids=["parallel", "perspective"])
@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_white_is_the_grey_image_to_the_bit(quadrature: str, view: object) -> None:
    density = smoke(2)
    grey = tnst_mi.render(density, view, GAMMA, quadrature)
    white = tnst_mi.render(density, view, GAMMA, quadrature, colour=np.ones((*SHAPE, 3)))
    np.testing.assert_array_equal(white, np.stack([grey] * 3, -1))
    assert grey.max() > 0.3


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_white_has_the_grey_gradient_of_the_density(quadrature: str) -> None:
    """Rounded otherwise: the coloured adjoint adds up three channels."""
    density, weights = smoke(3), smooth_noise(np.random.default_rng(3), len(VIEWS), *SHAPE[1:])
    leaf = mi.TensorXf(density)
    dr.enable_grad(leaf)
    dr.backward(dr.sum(tnst_mi.render(leaf, VIEWS, GAMMA, quadrature) * mi.TensorXf(weights), axis=None))
    expected = dr.grad(leaf).numpy()
    shares = np.stack([0.2 * weights, 0.5 * weights, 0.3 * weights], -1)
    found, _ = gradients(density, np.ones((*SHAPE, 3)), shares, VIEWS, GAMMA, quadrature)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_black_smoke_shows_nothing_and_hides_what_is_behind(quadrature: str) -> None:
    """Black in front of red: exactly 0 where nothing else is, and red dimmed by T = exp(−γ Σ d) of the black part."""
    density, colour = np.full(SHAPE, 0.3, np.float32), np.zeros((*SHAPE, 3), np.float32)
    assert not tnst_mi.render(density, VIEWS, GAMMA, quadrature, colour=colour).any()
    colour[:5, ..., 0] = 1  # The camera stands at +z.
    image = tnst_mi.render(density, (0, 0), GAMMA, quadrature, colour=colour)
    alone = tnst_mi.render(np.ascontiguousarray(density[:5]), (0, 0), GAMMA, quadrature)
    # Samples lie at the centres of cells up to rounding, ± 2⁻²², where the colour steps from 0 to 1.
    np.testing.assert_allclose(image[..., 0], alone * np.exp(-GAMMA * 5 * 0.3), rtol=1e-5)
    assert not image[..., 1:].any()


@pytest.mark.parametrize("view", [VIEWS, [(20.0, 5.0, 40.0)]], ids=["parallel", "perspective"])
@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_gradients_against_central_differences(quadrature: str, view: list) -> None:
    rng = np.random.default_rng(4)
    density, colour = smoke(4) + 0.05, colours(4)
    weights = np.stack([smooth_noise(rng, len(view), *SHAPE[1:]) for _ in range(3)], -1)

    def objective(density: np.ndarray, colour: np.ndarray) -> float:
        images = tnst_mi.render(density, view, GAMMA, quadrature, colour=colour)
        return float((images.astype(np.float64) * weights).sum())

    of_density, of_colour = gradients(density, colour, weights, view, GAMMA, quadrature)
    directions = [smooth_noise(rng, *SHAPE) for _ in range(16)]
    assert directional_error(lambda d: objective(d, colour), of_density, density, directions, 1e-2) <= 1e-3
    directions = [smooth_noise(rng, *SHAPE, 3) for _ in range(16)]
    assert directional_error(lambda c: objective(density, c), of_colour, colour, directions, 1e-2) <= 1e-3


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_backward_is_the_transpose_of_forward(quadrature: str) -> None:
    rng = np.random.default_rng(5)
    density, colour = smoke(5), colours(5)
    weights = rng.standard_normal((len(VIEWS), *SHAPE[1:], 3)).astype(np.float32)
    for d, c in ((1, 0), (0, 1), (1, 1)):
        changes = d * smooth_noise(rng, *SHAPE), c * smooth_noise(rng, *SHAPE, 3)
        leaves = mi.TensorXf(density), mi.TensorXf(colour)
        for leaf, change, varied in zip(leaves, changes, (d, c), strict=True):
            if varied:
                dr.enable_grad(leaf)
                dr.set_grad(leaf, mi.TensorXf(change))
        images_tangent = dr.forward_to(tnst_mi.render(leaves[0], VIEWS, GAMMA, quadrature, colour=leaves[1])).numpy()
        adjoint = sum(
            float((gradient * change).sum())
            for gradient, change in zip(
                gradients(density, colour, weights, VIEWS, GAMMA, quadrature), changes, strict=True
            )
        )
        assert np.abs(images_tangent).max() > 0.1
        assert float((images_tangent * weights).sum()) == pytest.approx(adjoint, rel=1e-3)


def test_derivatives_have_the_same_bits_in_every_run_and_one_by_one() -> None:
    """The gradient of one of the two alone is that of both together."""
    density, colour = smoke(6), colours(6)
    weights = np.random.default_rng(6).standard_normal((len(VIEWS), *SHAPE[1:], 3)).astype(np.float32)
    both = [array.tobytes() for array in gradients(density, colour, weights, VIEWS, GAMMA)]
    for _ in range(3):
        assert [array.tobytes() for array in gradients(density, colour, weights, VIEWS, GAMMA)] == both
    for which in (0, 1):
        arrays = [mi.TensorXf(density), mi.TensorXf(colour)]
        dr.enable_grad(arrays[which])
        images = tnst_mi.render(arrays[0], VIEWS, GAMMA, colour=arrays[1])
        dr.backward(dr.sum(images * mi.TensorXf(weights), axis=None))
        assert dr.grad(arrays[which]).numpy().tobytes() == both[which]


def test_torch_differentiates_both() -> None:
    density, colour = torch.tensor(smoke(7), requires_grad=True), torch.tensor(colours(7), requires_grad=True)
    tnst_mi.render(density, VIEW, GAMMA, colour=colour).square().sum().backward()
    images = tnst_mi.render(smoke(7), VIEW, GAMMA, colour=colours(7))
    expected = gradients(smoke(7), colours(7), 2 * images, VIEW, GAMMA)
    for found, of_dr in zip((density.grad, colour.grad), expected, strict=True):
        assert found is not None
        np.testing.assert_allclose(found.numpy(), of_dr, rtol=0, atol=1e-5 * np.abs(of_dr).max())


def test_a_grey_render_after_a_coloured_one_is_grey() -> None:
    """Both march through one cached medium."""
    density = smoke(8)
    before = tnst_mi.render(density, VIEW, GAMMA)
    tnst_mi.render(density, VIEW, GAMMA, colour=colours(8))
    np.testing.assert_array_equal(tnst_mi.render(density, VIEW, GAMMA), before)


def test_no_kernel_is_compiled_after_the_first_iterations() -> None:
    weights = np.ones((2, *SHAPE[1:], 3), np.float32)
    for seed in (1, 2):
        gradients(smoke(seed), colours(seed), weights, VIEWS[:2], 0.37)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        gradients(smoke(3), colours(3), weights, VIEWS[1:], 0.123)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert len(kernels) > 0
    assert sum(not kernel["cache_hit"] or kernel["cache_disk"] for kernel in kernels) == 0


@pytest.mark.parametrize("shape", [SHAPE, (*SHAPE, 1), (*SHAPE[:2], 4, 3), (3, *SHAPE)])
def test_a_colour_of_another_shape_is_an_error(shape: tuple) -> None:
    with pytest.raises(tnst_mi.InputError, match=r"render: colour of shape .*, expected \(10, 14, 9, 3\)"):
        tnst_mi.render(smoke(9), colour=np.ones(shape))


@pytest.mark.parametrize(("kind", "largest"), [(np.uint8, 255), (np.uint16, 65535)])
def test_whole_numbers_without_a_sign_are_parts_of_their_largest(kind: type, largest: int) -> None:
    whole = np.random.default_rng(0).integers(0, largest, (*SHAPE, 3), kind, endpoint=True)
    found = tnst_mi.render(smoke(9), VIEW, GAMMA, colour=whole)
    expected = tnst_mi.render(smoke(9), VIEW, GAMMA, colour=whole.astype(np.float32) / np.float32(largest))
    np.testing.assert_array_equal(found, expected)
    tensor = torch.as_tensor(whole.astype(np.int64)).to(torch.uint8 if kind is np.uint8 else torch.uint16)
    from_torch = tnst_mi.render(torch.as_tensor(smoke(9)), VIEW, GAMMA, colour=tensor)
    np.testing.assert_allclose(from_torch.cpu(), expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("colour", "message"),
    [
        (np.ones((*SHAPE, 3), np.int32), "render: colour of int32 given, expected floating-point numbers, or uint8"),
        (torch.ones((*SHAPE, 3), dtype=torch.bool), "render: colour of bool given, expected floating-point numbers"),
        (
            np.full((*SHAPE, 3), np.nan),
            r"colour has 3780 NaN or infinite values \(the first at \(0, 0, 0, 0\)\), expected",
        ),
    ],
    ids=["whole numbers", "switches", "nan"],
)
def test_what_is_no_colour_is_refused_in_one_line(colour: object, message: str) -> None:
    with pytest.raises(tnst_mi.InputError, match=message) as refused:
        tnst_mi.render(smoke(9), colour=colour)
    assert "\n" not in str(refused.value)
    spoilt = np.ones((*SHAPE, 3), np.float32)
    spoilt[2, 3, 4, 1] = np.inf
    with pytest.raises(tnst_mi.InputError, match=r"render: colour has 1 NaN .* at \(2, 3, 4, 1\)"):
        tnst_mi.render(smoke(9), colour=spoilt)


# --------------------------------------------------------------------
# The plugin in scenes
# --------------------------------------------------------------------


def volume(colour: np.ndarray, scale: float = 1.0) -> dict[str, object]:
    """A `gridvolume` of colours on the cells of `smoke_scene`."""
    to_world = mi.ScalarTransform4f().scale([scale * n for n in SHAPE[::-1]]).translate(-0.5)
    grid = mi.VolumeGrid(np.ascontiguousarray(colour))
    return {"type": "gridvolume", "grid": grid, "raw": True, "to_world": to_world, "accel": False}


def coloured_scene(density: np.ndarray, colour: object, quadrature: str = "paper", **others: object) -> mi.Scene:
    """A scene whose integrator has a colour."""
    integrator = {"gamma": GAMMA, "quadrature": quadrature, "colour": colour}
    return smoke_scene(GAMMA * density, orthographic(SHAPE, VIEW, "rgb"), integrator, scale=1.5, **others)


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_a_scene_shows_what_render_shows_in_front_of_a_sky(quadrature: str) -> None:
    density, colour = smoke(10), colours(10)
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [0.9, 0.5, 0.1]}}
    scene = coloured_scene(density, volume(colour), quadrature, sky=sky)
    own = tnst_mi.render(density, VIEW, GAMMA, quadrature, colour=colour)
    opacity = tnst_mi.render(density, VIEW, GAMMA, "transmittance")
    expected = own + (1 - opacity)[..., None] * np.array([0.9, 0.5, 0.1])
    np.testing.assert_allclose(mi.render(scene).numpy(), expected, rtol=0, atol=1e-4 * expected.max())

    parameters = mi.traverse(scene)
    parameters["integrator.colour.data"] = mi.TensorXf(1 - colour)
    parameters.update()
    own = tnst_mi.render(density, VIEW, GAMMA, quadrature, colour=1 - colour)
    expected = own + (1 - opacity)[..., None] * np.array([0.9, 0.5, 0.1])
    np.testing.assert_allclose(mi.render(scene).numpy(), expected, rtol=0, atol=1e-4 * expected.max())


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_gradients_in_a_scene_are_those_of_render(quadrature: str) -> None:
    """There adjoints are scattered, since a scene's rays have nothing in common; and their sums rounded otherwise."""
    density, colour = smoke(11), colours(11)
    weights = smooth_noise(np.random.default_rng(11), *SHAPE[1:], 3)
    scene = coloured_scene(density, volume(colour), quadrature)
    parameters = mi.traverse(scene)
    keys = ("smoke.interior_medium.sigma_t.data", "integrator.colour.data")
    for key in keys:
        dr.enable_grad(parameters[key])
    parameters.update()
    dr.backward(dr.sum(mi.render(scene, parameters) * mi.TensorXf(weights), axis=None))
    found = [dr.grad(parameters[key]).numpy() for key in keys]
    expected = gradients(density, colour, weights, VIEW, GAMMA, quadrature)
    np.testing.assert_allclose(
        found[0][..., 0] * GAMMA / 1.5, expected[0], rtol=0, atol=1e-3 * np.abs(expected[0]).max()
    )
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-3 * np.abs(expected[1]).max())


@pytest.mark.parametrize(
    ("shape", "scale", "named"),
    [
        ((*SHAPE, 1), 1.0, "a `gridvolume` of three channels"),
        ((5, 14, 9, 3), 1.0, '"colour" has (5, 14, 9) cells, the extinction (10, 14, 9)'),
        ((*SHAPE, 3), 1.1, "the same to_world"),
        (None, 1.0, "a `gridvolume` of three channels"),
    ],
    ids=["one channel", "resolution", "place", "no grid"],
)
def test_colours_that_do_not_fit_are_named(shape: tuple | None, scale: float, named: str) -> None:
    white = {"type": "constvolume", "value": 1.0} if shape is None else volume(np.ones(shape, np.float32), scale)
    with pytest.raises((RuntimeError, ValueError)) as error:
        mi.render(coloured_scene(smoke(12), white))
    assert named in error_message(error.value) or named in str(error.value)
