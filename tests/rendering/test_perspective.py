"""Perspective views and cameras against a numpy march, the orthographic limit, finite differences and `prbvolpath`."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import ray_march
from fields import blob, directional_error, smooth_noise
from smoke_scenes import film

import tnst_mi
from tnst_mi.compare.closed_form import column_density
from tnst_mi.compare.path_tracing import PathTracer
from tnst_mi.compare.values import refined_exact
from tnst_mi.errors import InputError
from tnst_mi.recipe.paths import LIGHTS
from tnst_mi.rendering.cameras.camera import Camera
from tnst_mi.rendering.cameras.views import common_size, share_cut_off
from tnst_mi.rendering.march.scene_media import SceneMedia
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer
from tnst_mi.rendering.scene import scene_description

SHAPE = (10, 14, 9)
GAMMA = 0.5
QUADRATURES = ("paper", "exact", "transmittance", "integrated_transmittance")

#: From far away, from near, from the wall of the grid and from inside it.
VIEWS = [(0.0, 0.0, 40.0), (-9.0, 4.0, 22.0), (37.0, -12.0, 14.0), (123.0, 48.0, 5.0), (-80.0, 71.0, 2.3)]


def smoke(seed: int, *shape: int) -> np.ndarray:
    """A density that does not vanish at the walls, where clamping and cutting would go unnoticed otherwise."""
    return np.abs(smooth_noise(np.random.default_rng(seed), *shape)) + 0.05


def camera_at(
    position: tuple[float, float, float], view: tuple[float, float], roll: float, field: float = 40.0, **others: object
) -> Camera:
    """A camera at a place, that looks from the direction of a view, rolled by some degrees."""
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    to_world = np.eye(4)
    to_world[:3, :3] = (np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ ray_march.camera_axes(view)).T
    to_world[:3, 3] = position
    return Camera(to_world, **({"perspective": True, "field": field, "aspect": 0.8} | others))


#: Off centre, rolled and shifted; in the smoke with its centre behind the camera; parallel rays from inside.
CAMERAS = [
    camera_at((12.0, 5.0, 20.0), (27.0, 9.0), 30.0, shift=(0.2, -0.1)),
    camera_at((1.0, -2.0, -3.0), (10.0, -20.0), -75.0, field=80.0),
    camera_at((3.0, 2.0, 1.0), (-40.0, 15.0), 12.0, field=12.0, perspective=False, shift=(0.0, 0.3)),
]


def centred(view: tuple[float, float, float], rows: int, aspect: float, h: float = 1.0) -> Camera:
    """The camera whose image a perspective view is."""
    axes = ray_march.camera_axes(view[:2])
    field = 2 * np.degrees(np.arctan(h * rows / 2 / view[2]))
    return camera_at(tuple(view[2] * axes[2]), view[:2], 0.0, field, aspect=aspect)


def oracle(density: np.ndarray, camera: Camera, size: tuple[int, int], quadrature: str, h: float = 1.0) -> np.ndarray:
    """The image of a perspective camera by the numpy march."""
    rows, columns = size
    height = 2 * np.tan(np.radians(camera.field) / 2)
    y, x = np.meshgrid(0.5 - (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns - 0.5, indexing="ij")
    pixels = height * np.stack([camera.aspect * x - camera.shift[0], y - camera.shift[1]], -1).reshape(-1, 2)
    image = ray_march.through_eye(density, camera.position, camera.axes, pixels, GAMMA, quadrature, h)
    return image.reshape(size)


def gradient(density: np.ndarray, weights: np.ndarray, viewpoints: list, quadrature: str = "paper") -> np.ndarray:
    """Gradient of the weighted sum of the images."""
    leaf = mi.TensorXf(density)
    dr.enable_grad(leaf)
    renderer = EmissionAbsorptionRenderer(density.shape, GAMMA, quadrature, 1.0)
    dr.backward(dr.sum(renderer.render(leaf, viewpoints) * mi.TensorXf(weights), axis=None))
    return dr.grad(leaf).numpy()


# --------------------------------------------------------------------
# Images
# --------------------------------------------------------------------


@pytest.mark.parametrize("quadrature", QUADRATURES)
@pytest.mark.parametrize(("shape", "h"), [(SHAPE, 1.0), ((11, 13, 12), 1.8)])
def test_images_are_those_of_a_numpy_march(shape: tuple, h: float, quadrature: str) -> None:
    density = smoke(1, *shape)
    views = [(azimuth, elevation, h * distance) for azimuth, elevation, distance in VIEWS]
    for view, image in zip(views, tnst_mi.render(density, views, GAMMA, quadrature, h), strict=True):
        expected = oracle(density, centred(view, shape[1], shape[2] / shape[1], h), shape[1:], quadrature, h)
        np.testing.assert_allclose(image, expected, rtol=0, atol=1e-3 * expected.max(), err_msg=str(view))


@pytest.mark.parametrize("quadrature", QUADRATURES)
@pytest.mark.parametrize("camera", CAMERAS[:2])
def test_cameras_see_what_a_numpy_march_sees(camera: Camera, quadrature: str) -> None:
    density = smoke(2, *SHAPE)
    image = tnst_mi.render(density, gamma=GAMMA, quadrature=quadrature, camera=camera, size=(20, 16))
    expected = oracle(density, camera, (20, 16), quadrature)
    assert expected.max() > 0.2
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-3 * expected.max())


def test_an_orthographic_camera_shows_part_of_an_orthographic_view() -> None:
    """Of smoke wholly in front of it; the picture is moved by whole pixels."""
    density, view = smoke(3, *SHAPE), (33.0, -20.0)
    axes = ray_march.camera_axes(view)
    place = 50 * axes[2] + 3 * axes[0] - 2 * axes[1]
    camera = camera_at(tuple(place), view, 0.0, 8.0, perspective=False, aspect=0.5)
    image = tnst_mi.render(density, gamma=GAMMA, camera=camera, size=(8, 4))
    whole = tnst_mi.render(density, view, GAMMA, size=(20, 20))
    np.testing.assert_allclose(image, whole[8:16, 11:15], rtol=0, atol=2e-5 * whole.max())


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_distant_eyes_converge_to_the_orthographic_view_at_first_order(quadrature: str) -> None:
    """Ten times the distance leaves a tenth of the difference, down to rounding."""
    density = blob(SHAPE, (4.0, 7.5, 4.5), 1.0).astype(np.float32)
    if quadrature == "integrated_transmittance":
        # Empty space is seen, whose ends jump by a sample where a ray enters or leaves the box; from the front it does
        # so in the same sample, but for the rays that leave through a side.
        view, part = (0.0, 0.0), (slice(2, -2), slice(2, -2))
    else:
        view, part = (37.0, -12.0), (slice(None), slice(None))
    expected = tnst_mi.render(density, view, GAMMA, quadrature).astype(np.float64)[part]
    distances = 10.0 ** np.arange(3, 6)
    errors = [
        np.abs(tnst_mi.render(density, (*view, distance), GAMMA, quadrature)[part] - expected).mean()
        for distance in distances
    ]
    assert errors[0] > 2e-5 * expected.mean()
    orders = -np.diff(np.log10(errors))
    np.testing.assert_allclose(orders, 1.0, atol=0.05)


def test_nearer_smoke_is_larger() -> None:
    """A blob at z appears d/(d − z) times as far from the centre, from a distance d."""
    n, away, distance = 25, 5.0, 30.0
    for z in (-8.0, 0.0, 8.0):
        middle = (n - 1) / 2
        density = blob((n, n, n), (middle + away, middle, middle + z), 1.0)
        image = tnst_mi.render(density, (0.0, 0.0, distance), 0.01, "exact").astype(np.float64)
        column = (image.sum(0) * np.arange(n)).sum() / image.sum() - middle
        assert column == pytest.approx(away * distance / (distance - z), rel=0.01)


def test_smoke_behind_the_eye_is_not_seen() -> None:
    density = np.zeros((12, 5, 5))
    density[8] = 1.0
    # In front of the slab at z = 2.5 … 3.5, inside it, and behind it.
    seen = [tnst_mi.render(density, (0.0, 0.0, z), 1.0, "exact")[2, 2] for z in (5.0, 1.0)]
    assert seen[0] == pytest.approx(1 - np.exp(-1), rel=1e-4)
    assert seen[1] == 0


def test_views_and_cameras_rendered_together_are_those_rendered_alone() -> None:
    density = mi.TensorXf(smoke(4, *SHAPE))
    renderer = EmissionAbsorptionRenderer(SHAPE, GAMMA, "paper", 1.0)
    mixed = [(37.0, -12.0), *VIEWS[:3], *CAMERAS]
    together = renderer.render(density, mixed).numpy()
    for viewpoint, image in zip(mixed, together, strict=True):
        alone = renderer.render(density, [viewpoint]).numpy()[0]
        np.testing.assert_allclose(image, alone, rtol=0, atol=2e-5 * alone.max(), err_msg=str(viewpoint))


def test_a_scene_with_the_sensor_shows_the_same_images_and_has_the_same_gradient() -> None:
    """Through the plugins: `camera_views` in a Mitsuba scene, its rays jittered nowhere."""
    density, viewpoints = smoke(5, *SHAPE), [VIEWS[1], CAMERAS[0], (5.0, 6.0)]
    renderer = EmissionAbsorptionRenderer(SHAPE, GAMMA, "paper", 1.0)
    expected = renderer.render(mi.TensorXf(density), viewpoints).numpy()
    description = scene_description(SHAPE, GAMMA, "paper", 1.0, len(viewpoints))
    description["smoke"]["interior"]["scale"] = GAMMA
    description["smoke"]["interior"]["sigma_t"]["grid"] = mi.VolumeGrid(density[..., None])
    scene = mi.load_dict(description)
    scene.sensors()[0].set_views(viewpoints)
    parameters = mi.traverse(scene)
    key = "smoke.interior_medium.sigma_t.data"
    dr.enable_grad(parameters[key])
    image = mi.render(scene, parameters)
    np.testing.assert_allclose(image.numpy().reshape(expected.shape), expected, rtol=0, atol=1e-5 * expected.max())
    weights = np.random.default_rng(5).normal(size=expected.shape).astype(np.float32)
    dr.backward(dr.sum(image * mi.TensorXf(weights.reshape(image.shape)), axis=None))
    found, gathered = dr.grad(parameters[key]).numpy()[..., 0], gradient(density, weights, viewpoints)
    np.testing.assert_allclose(found, gathered, rtol=0, atol=1e-4 * np.abs(gathered).max())
    assert SceneMedia(scene).box is not None


# --------------------------------------------------------------------
# Derivatives
# --------------------------------------------------------------------


@pytest.mark.parametrize("shape", [SHAPE, (9, 8, 11)])
@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_gradient_against_central_differences(quadrature: str, shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(8)
    viewpoints = [*VIEWS, *CAMERAS]
    density, weights = smoke(8, *shape), smooth_noise(rng, len(viewpoints), *shape[1:])
    renderer = EmissionAbsorptionRenderer(shape, GAMMA, quadrature, 1.0)

    def objective(point: np.ndarray) -> float:
        images = renderer.render(mi.TensorXf(np.float32(point)), viewpoints).numpy()
        return float((images.astype(np.float64) * weights).sum())

    directions = [smooth_noise(rng, *shape) for _ in range(16)]
    exact = gradient(density, weights, viewpoints, quadrature)
    assert directional_error(objective, exact, density, directions, 1e-2) <= 1e-3


@pytest.mark.parametrize("viewpoint", [*VIEWS, *CAMERAS])
def test_gradient_of_every_voxel_is_the_transpose_of_the_images(viewpoint: object) -> None:
    """Of thin smoke images are linear: a pixel's gradient is what each cell alone would show in it."""
    shape = (4, 5, 3)
    weights = np.random.default_rng(9).normal(size=(1, *shape[1:])).astype(np.float32)
    renderer = EmissionAbsorptionRenderer(shape, 1e-6, "exact", 1.0)
    leaf = mi.TensorXf(np.ones(shape, np.float32))
    dr.enable_grad(leaf)
    dr.backward(dr.sum(renderer.render(leaf, [viewpoint]) * mi.TensorXf(weights), axis=None))
    expected = np.zeros(shape)
    for cell in np.ndindex(*shape):
        alone = np.zeros(shape, np.float32)
        alone[cell] = 1
        expected[cell] = (renderer.render(mi.TensorXf(alone), [viewpoint]).numpy() * weights).sum(dtype=np.float64)
    np.testing.assert_allclose(dr.grad(leaf).numpy(), expected, rtol=0, atol=2e-4 * np.abs(expected).max())


@pytest.mark.parametrize("quadrature", QUADRATURES)
def test_backward_is_the_transpose_of_forward(quadrature: str) -> None:
    rng = np.random.default_rng(10)
    viewpoints = [*VIEWS, *CAMERAS]
    density, tangent = smoke(10, *SHAPE), smooth_noise(rng, *SHAPE)
    weights = smooth_noise(rng, len(viewpoints), *SHAPE[1:])
    leaf = mi.TensorXf(density)
    dr.enable_grad(leaf)
    dr.set_grad(leaf, mi.TensorXf(tangent))
    renderer = EmissionAbsorptionRenderer(SHAPE, GAMMA, quadrature, 1.0)
    changed = dr.forward_to(renderer.render(leaf, viewpoints)).numpy()
    adjoint = (gradient(density, weights, viewpoints, quadrature) * tangent).sum()
    assert np.abs(changed).max() > 0.1
    assert (changed * weights).sum() == pytest.approx(adjoint, rel=1e-4)


def test_gradient_has_the_same_bits_in_every_run_and_however_many_views_are_stored(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shape = (16, 24, 16)
    density = np.random.default_rng(11).random(shape).astype(np.float32)
    viewpoints = [VIEWS[0], (37.0, -12.0), CAMERAS[0]]
    weights = np.random.default_rng(12).standard_normal((3, *shape[1:])).astype(np.float32)
    runs = {gradient(density, weights, viewpoints).tobytes() for _ in range(5)}
    monkeypatch.setattr(EmissionAbsorptionRenderer, "_views_at_once", lambda *_: 3)
    runs |= {gradient(density, weights, viewpoints).tobytes() for _ in range(3)}
    assert len(runs) == 1


@pytest.mark.parametrize("mode", ["forward", "backward"])
def test_no_kernel_is_compiled_for_other_viewpoints(mode: str) -> None:
    density = mi.TensorXf(dr.linspace(mi.Float, 0.1, 1, int(np.prod(SHAPE))), SHAPE)
    dr.eval(density)
    renderer = EmissionAbsorptionRenderer(SHAPE, 0.37, "paper", 1.3)

    def differentiate(viewpoints: list) -> None:
        leaf = mi.TensorXf(density)
        dr.enable_grad(leaf)
        if mode == "forward":
            dr.set_grad(leaf, density)
            dr.eval(dr.forward_to(renderer.render(leaf, viewpoints)))
        else:
            dr.backward(dr.sum(renderer.render(leaf, viewpoints), axis=None))
            dr.eval(dr.grad(leaf))

    for _ in range(2):
        differentiate(VIEWS[1:3])
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        differentiate([VIEWS[4], VIEWS[0]])
        differentiate([CAMERAS[2], CAMERAS[1]])
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert len(kernels) > 0
    assert sum(not kernel["cache_hit"] or kernel["cache_disk"] for kernel in kernels) == 0


# --------------------------------------------------------------------
# Mitsuba's path tracer
# --------------------------------------------------------------------


def test_the_path_tracer_of_compare_agrees_in_perspective() -> None:
    """Within three standard errors, but for a hundredth of the testable pixels; and so does the closed form."""
    shape, views, spp = (12, 18, 10), [(25.0, -12.0, 30.0), (-70.0, 33.0, 14.0)], 1024
    density = 0.9 * smoke(13, *shape)
    _, ours = refined_exact(density, views, GAMMA, spp)
    exact = 1 - GAMMA * ours
    traced = PathTracer(density, views, GAMMA, 1.1).transmittance(spp, seed=3)
    closed = np.exp(-GAMMA * np.stack([column_density(density, view) for view in views]))
    error = np.sqrt(exact * (1 - exact) / spp)
    testable = spp * exact * (1 - exact) >= 5
    assert testable.mean() > 0.5
    z = (traced - exact)[testable] / error[testable]
    assert (np.abs(z) <= 3).mean() >= 0.99
    assert abs(z.mean()) < 3.5 / np.sqrt(len(z))
    assert np.abs((exact - closed)[testable] / error[testable]).max() < 0.5


def test_mitsuba_s_own_perspective_sensor_shows_the_same_picture() -> None:
    """`prbvolpath` through its `perspective` sensor, averaged over pixels, of smoke that is smooth over them."""
    shape, spp = (12, 18, 12), 1024
    density = 0.4 * blob(shape, (5.5, 8.5, 6.0), 2.5).astype(np.float32)
    camera = camera_at((20.0, 8.0, 26.0), (38.0, 14.0), 20.0, 35.0, aspect=1.0)
    rows = 24
    description = scene_description(shape, GAMMA, "exact", 1.0, 1)
    description["integrator"] = {"type": "prbvolpath", "max_depth": 1}
    description["environment"] = {"type": "constant", "radiance": 1.0}
    description["smoke"]["interior"]["sigma_t"] |= {
        "grid": mi.VolumeGrid(GAMMA * density[..., None]),
        "max_value": 1.1 * GAMMA * float(density.max()),
    }
    flipped = np.array(camera.to_world) @ np.diag([-1.0, 1.0, -1.0, 1.0])  # Mitsuba's cameras look along +z
    description["sensor"] = {
        "type": "perspective",
        "fov": camera.field,
        "fov_axis": "y",
        "to_world": mi.ScalarTransform4f(flipped.tolist()),
        **film(rows, rows),
    }
    description["sensor"]["sampler"] = {"type": "independent"}
    traced = mi.render(mi.load_dict(description), spp=spp, seed=1).numpy()[..., 0]
    fine = tnst_mi.render(density, gamma=GAMMA, quadrature="exact", camera=camera, size=(4 * rows, 4 * rows))
    exact = 1 - GAMMA * fine.astype(np.float64).reshape(rows, 4, rows, 4).mean((1, 3))
    testable = spp * exact * (1 - exact) >= 5
    assert testable.sum() > 50
    z = (traced - exact)[testable] / np.sqrt(exact * (1 - exact) / spp)[testable]
    assert (np.abs(z) <= 3).mean() >= 0.99


def test_the_scattering_renderer_takes_perspective_views_from_outside_alone() -> None:
    density = mi.TensorXf(blob(SHAPE, (4.0, 6.5, 7.5), 1.2).astype(np.float32))
    renderer = ScatteringRenderer(SHAPE, 1.0, 1.0, Lighting(0.9, 0.0, LIGHTS / "environment.xml", 64))
    near, far, orthographic = (
        renderer.render(density, [view]).numpy()[0] for view in ((20.0, 5.0, 12.0), (20.0, 5.0, 1e5), (20.0, 5.0))
    )
    assert near.sum() > 1.2 * orthographic.sum(), "nearer smoke is larger"
    np.testing.assert_allclose(far.sum(), orthographic.sum(), rtol=0.05)
    for inside in (VIEWS[-1], CAMERAS[1], CAMERAS[2]):
        with pytest.raises(InputError, match="a camera is inside the grid"):
            renderer.render(density, [inside])


# --------------------------------------------------------------------
# Sizes and arguments
# --------------------------------------------------------------------


@pytest.mark.parametrize("view", [(0.0, 0.0, 30.0), (37.0, -12.0, 14.0), (-160.0, 80.0, 100.0)])
def test_images_that_fit_show_all_of_the_grid_and_hardly_more(view: tuple[float, float, float]) -> None:
    """By the corners of the grid, seen from the eye; two rows or columns less would cut them off."""
    rows, columns = common_size(SHAPE, [view])
    axes = ray_march.camera_axes(view[:2])
    corners = np.array([[x, y, z] for x in (-4.5, 4.5) for y in (-7, 7) for z in (-5, 5)], float)
    x, y, nearer = axes @ corners.T
    scale = view[2] / (view[2] - nearer)
    for reach, size in ((np.abs(x * scale).max(), columns), (np.abs(y * scale).max(), rows)):
        assert size - 2 < 2 * reach + 1e-5 and 2 * reach <= size + 1e-5
    everything = np.ones(SHAPE, np.float32)
    assert share_cut_off(everything, [view], (rows, columns)) == 0
    assert tnst_mi.render(everything, view, fit=True).shape == (rows, columns)
    # Twice the cells' size at twice the distance is the same picture.
    assert common_size(SHAPE, [(view[0], view[1], 2 * view[2])], 2.0) == (rows, columns)


def test_what_is_cut_off_is_what_the_eye_does_not_see() -> None:
    density = np.random.default_rng(14).random(SHAPE, np.float32)
    z, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in SHAPE), indexing="ij")
    for view in VIEWS:
        right, up, nearer = (axis[0] * x + axis[1] * y + axis[2] * z for axis in ray_march.camera_axes(view[:2]))
        with np.errstate(divide="ignore"):
            scale = np.where(view[2] > nearer, view[2] / (view[2] - nearer), np.inf)
        outside = (nearer >= view[2]) | (np.abs(right) * scale > 4.5 + 1e-6) | (np.abs(up) * scale > 7 + 1e-6)
        expected = density[outside].sum() / density.sum()
        assert 0 < expected < 1
        assert share_cut_off(density, [view], SHAPE[1:]) == pytest.approx(expected, abs=1e-5)


def test_from_inside_no_image_shows_all() -> None:
    with pytest.raises(InputError, match="no image shows all of a grid"):
        tnst_mi.render(np.ones(SHAPE), VIEWS[-1], fit=True)


def test_the_size_of_a_camera_s_image() -> None:
    density = np.ones(SHAPE, np.float32)
    assert tnst_mi.render(density, camera=CAMERAS[0]).shape == (14, round(14 * 0.8))
    assert tnst_mi.render(density, camera=CAMERAS[0], size=(3, 5)).shape == (3, 5)
    assert tnst_mi.render(density, [(0, 0), (0, 0, 30)], size=(3, 5)).shape == (2, 3, 5)


@pytest.mark.parametrize(
    "wrong",
    [
        {"view": (0.0, 0.0, -1.0)},
        {"view": (0.0, 0.0, np.inf)},
        {"view": [(0.0, 0.0), (0.0, 0.0, 0.0)]},
        {"view": (0.0, 0.0, 1.0, 2.0)},
        {"view": (1.0, 0.0), "camera": CAMERAS[0]},
        {"camera": "front"},
        {"camera": CAMERAS[0], "fit": True},
        {"size": (3, 5), "fit": True},
        {"size": (3,)},
        {"size": (0, 5)},
        {"size": (3.5, 5)},
    ],
)
def test_bad_arguments_are_named_in_one_line(wrong: dict) -> None:
    with pytest.raises(InputError, match=r"^render: ") as error:
        tnst_mi.render(np.ones(SHAPE), **wrong)
    assert "\n" not in str(error.value)
