"""Smoke in the studio: energy and transmittance in closed form, views, zoom, the scene files, repeatability."""

from __future__ import annotations

import dataclasses
import math

import draw_sky
import drjit as dr
import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from fields import smooth_noise
from lit_smoke import under_a_sky

import tnst_mi
from tnst_mi.choices import LOOKS
from tnst_mi.rendering.cameras.views import camera_frame
from tnst_mi.rendering.looks import extinction, gamma, look_file
from tnst_mi.rendering.studio import Smoke, Studio

SIZE = (24, 32)
CUBE = (8, 8, 8)
DISTANCE = 4.5


def studio(density: np.ndarray, *views: tuple[float, float], look: str = "thin", integrator: str = "volpath") -> Studio:
    return Studio(look, integrator, Smoke.of([density]), views or [(0.0, 0.0)], SIZE)


def estimate(scene: Studio, density: np.ndarray, view: tuple[float, float], samples: int = 64) -> np.ndarray:
    """As `Studio.render`, all samples in one launch: quicker for pictures as small as these."""
    scene.show(density, view)
    return mi.render(scene.scene, spp=samples, seed=1).numpy()


def opacity(scene: Studio, density: np.ndarray, view: tuple[float, float], samples: int = 64) -> np.ndarray:
    """1 − transmittance (height, width), from a scene under a white sky with albedo 0."""
    return 1.0 - estimate(scene, density, view, samples)[..., 0]


def noise(*shape: int) -> np.ndarray:
    return np.abs(smooth_noise(np.random.default_rng(3), *shape)).astype(np.float32)


def blocks(image: np.ndarray) -> np.ndarray:
    """Means over 12 blocks of 8 × 8 pixels: their noise is an eighth of a pixel's."""
    return image.reshape(4, 8, 3, 8, 3).mean((1, 3))


# --- Light in the smoke -----------------------------------------------------------------------------------


@pytest.mark.parametrize("look", LOOKS)
def test_smoke_transmits_what_its_optical_thickness_says(look: str) -> None:
    # The four pixels around the centre look through the front and the back of the box.
    samples, middle = 600, (slice(15, 17), slice(11, 13))
    for shape, thickness in ((CUBE, 1.0), ((10, 20, 12), 0.5)):
        density = np.full(shape, 1.0 / extinction(look), np.float32)
        scene = under_a_sky(studio(density, look=look), albedo=0.0)
        found = 1.0 - opacity(scene, density, (0.0, 0.0), samples)[middle].mean()
        expected = math.exp(-thickness)
        assert found == pytest.approx(expected, abs=4 * math.sqrt(expected * (1 - expected) / (4 * samples)))
        # The same optical thickness is what emission_absorption takes as the look's γ.
        grey = tnst_mi.render(density, gamma=gamma(look, shape), quadrature="transmittance")
        assert 1.0 - grey[shape[1] // 2, shape[2] // 2] == pytest.approx(expected, abs=1e-5)


def test_looks_go_from_thin_to_thick() -> None:
    assert LOOKS == ("thin", "medium", "thick")
    assert extinction("thin") < extinction("medium") < extinction("thick")


@pytest.mark.parametrize("look, integrator", [("thin", "volpath"), ("thick", "prbvolpath")])
def test_smoke_that_absorbs_nothing_vanishes_in_a_white_environment(look: str, integrator: str) -> None:
    # At most 10 mean free paths across, so that hardly any path is as long as `max_depth`.
    density = noise(*CUBE)
    density *= 10.0 / extinction(look) / density.max()
    view = (20.0, 10.0)
    scene = under_a_sky(studio(density, view, look=look, integrator=integrator), albedo=1.0)
    image = estimate(scene, density, view, 256)[..., 0]
    np.testing.assert_allclose(image, 1.0, atol=0.12)
    assert image.mean() == pytest.approx(1.0, abs=3e-3)
    # The sky is seen through the smoke, not beside it.
    scene.parameters["smoke.interior_medium.albedo.value.value"] = mi.Color3f(0.0)
    scene.parameters.update()
    assert estimate(scene, density, view, 16)[..., 0].mean() < 0.8


def test_an_empty_grid_shows_the_studio_alone() -> None:
    empty = np.zeros(CUBE, np.float32)
    scene = studio(empty, look="medium")
    bare = mi.load_dict(studio_as_dictionary(scene, smoke=False))
    expected = mi.render(bare, spp=256, seed=2).numpy()
    np.testing.assert_allclose(blocks(estimate(scene, empty, (0.0, 0.0), 256)), blocks(expected), rtol=0.03)


def test_both_path_tracers_estimate_the_same_picture() -> None:
    density, view = noise(*CUBE), (30.0, 5.0)
    images = [
        estimate(studio(density, view, integrator=name), density, view, 256) for name in ("volpath", "prbvolpath")
    ]
    np.testing.assert_allclose(images[0].mean((0, 1)), images[1].mean((0, 1)), rtol=0.01)
    np.testing.assert_allclose(blocks(images[0]), blocks(images[1]), rtol=0.06)


# --- Views ------------------------------------------------------------------------------------------------


def test_views_show_the_smoke_where_emission_absorption_shows_it() -> None:
    shape = (14, 20, 16)
    density = np.zeros(shape, np.float32)
    density[10:13, 13:16, 11:14] = 1.0  # front, upper right
    position = np.array([12.5, 14.5, 11.5]) - np.array([8, 10, 7])
    views = [(0.0, 0.0), (90.0, 0.0), (-120.0, 6.0), (35.0, 40.0), (0.0, 90.0), (400.0, -3.0)]
    scene = under_a_sky(studio(density, *views, look="thick"), albedo=0.0)
    slope = math.tan(math.radians(float(scene.parameters["camera.x_fov"][0]) / 2)) / (SIZE[0] / 2)

    def centroid(image: np.ndarray) -> np.ndarray:
        """Where the smoke is, in pixels to the right of and above the centre."""
        rows, columns = image.shape
        y, x = np.mgrid[:rows, :columns] + 0.5
        return np.array([(image * (x - columns / 2)).sum(), (image * (rows / 2 - y)).sum()]) / image.sum()

    for view in views:
        towards = camera_frame(*view)[2] @ position
        expected = centroid(tnst_mi.render(density, view, quadrature="transmittance"))
        found = centroid(opacity(scene, density, view)) * slope * (20 * DISTANCE - towards)
        np.testing.assert_allclose(found, expected, atol=0.25)


@pytest.mark.parametrize("shape", [(5, 16, 4), (4, 5, 18), (16, 4, 6)])
def test_the_zoom_shows_all_of_any_grid_from_all_views(shape: tuple[int, int, int]) -> None:
    density = np.full(shape, 5.0, np.float32)
    views = [(0.0, 0.0), (50.0, 10.0), (90.0, 0.0)]
    size = (72, 96)
    scene = under_a_sky(Studio("thick", "volpath", Smoke.of([density]), views, size), albedo=0.0)
    images = [opacity(scene, density, view, samples=8) for view in views]
    for image in images:
        assert abs(image[[0, -1]]).max() < 1e-4 and abs(image[:, [0, -1]]).max() < 1e-4
    rows, columns = np.nonzero(np.max(images, axis=0) > 0.1)
    assert max(np.ptp(rows) / size[1], np.ptp(columns) / size[0]) > 0.88


def test_camera_and_lights_turn_together() -> None:
    # This smoke looks the same from four sides.
    density = noise(*CUBE)
    density = sum(np.rot90(density, k, axes=(0, 2)) for k in range(4))
    scene = studio(density, (0.0, 8.0), (90.0, 8.0), look="medium")
    front, side = (estimate(scene, density, (azimuth, 8.0), 128) for azimuth in (0.0, 90.0))
    np.testing.assert_allclose(blocks(front), blocks(side), rtol=0.05)
    # The key light stands on the left, the rim light on the right.
    assert front[8:22, 6:12].mean() > 1.1 * front[8:22, 12:18].mean()


def test_views_leave_no_trace_and_seeds_decide_the_noise() -> None:
    density = noise(*CUBE)
    scene = studio(density, (0.0, 0.0), (70.0, 20.0))
    first = scene.render(density, (70.0, 20.0), samples=4, seed=(5, 1))
    other = scene.render(density, (70.0, 20.0), samples=4, seed=(5, 2))
    scene.render(0.5 * density, (0.0, 0.0), samples=1)
    np.testing.assert_array_equal(scene.render(density, (70.0, 20.0), samples=4, seed=(5, 1)), first)
    assert (first != other).any()


def test_a_picture_is_the_same_to_the_bit_whatever_was_shown_before() -> None:
    """Of thousands of pixels: what follows from the places of lamps was rounded differently in a few."""
    density = noise(*CUBE)
    scene = Studio("medium", "volpath", Smoke.of([density]), [(0.0, 0.0), (20.0, 5.0)], (48, 50))
    front, *others = (
        scene.render(density, view, samples=2, seed=3)
        for view in ((0.0, 0.0), (0.0, 0.0), (20.0, 5.0), (20.0, 5.0), (0.0, 0.0))
    )
    np.testing.assert_array_equal(others[0], front)
    np.testing.assert_array_equal(others[1], others[2])
    np.testing.assert_array_equal(others[3], front)


def test_no_kernel_is_compiled_for_another_view_density_or_seed() -> None:
    density = noise(*CUBE)
    scene = studio(density, (0.0, 0.0), (70.0, 20.0))
    scene.render(density, (0.0, 0.0), samples=2)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        scene.render(0.5 * density, (70.0, 20.0), samples=2, seed=9)
        history = dr.kernel_history([dr.KernelType.JIT])
    assert history and all(kernel["cache_hit"] for kernel in history)


def test_a_camera_below_the_ground_is_refused() -> None:
    with pytest.raises(tnst_mi.InputError, match=r"view 0,-7: .* below the ground; expected .* above -6.4"):
        studio(noise(*CUBE), (0.0, 0.0), (0.0, -7.0))


# --- What the frames have in common -----------------------------------------------------------------------


def test_the_box_around_all_smoke_is_found() -> None:
    first, second = np.zeros((6, 9, 7)), np.zeros((6, 9, 7))
    first[2, 4, 3], second[3, 8, 5] = 2.0, 0.5
    smoke = Smoke.of([first, second])
    assert smoke == Smoke((6, 9, 7), 2.0, (slice(1, 5), slice(3, 9), slice(2, 7)))
    assert Smoke.of([np.zeros((2, 3, 4))]).occupied == (slice(0, 2), slice(0, 3), slice(0, 4))
    with pytest.raises(tnst_mi.InputError, match=r"shape \(2, 3, 5\) after ones of \(2, 3, 4\)"):
        Smoke.of([np.zeros((2, 3, 4)), np.zeros((2, 3, 5))])
    with pytest.raises(tnst_mi.InputError, match="no frames"):
        Smoke.of([])


def test_leaving_out_the_empty_part_of_the_grid_changes_nothing() -> None:
    density, view = np.zeros((12, 16, 10), np.float32), (25.0, 10.0)
    density[3:7, 9:13, 0:4] = noise(4, 4, 4)
    smoke = Smoke.of([density])
    whole = dataclasses.replace(smoke, occupied=tuple(slice(0, n) for n in density.shape))
    images = [
        opacity(under_a_sky(Studio("medium", "volpath", s, [view], SIZE), 0.0), density, view, 256)
        for s in (smoke, whole)
    ]
    assert images[0].max() > 0.3
    np.testing.assert_allclose(images[0], images[1], atol=5 * math.sqrt(2 * 0.25 / 256))
    assert images[0].mean() == pytest.approx(images[1].mean(), rel=0.01)


# --- The scene files --------------------------------------------------------------------------------------


def rgb(*values: float) -> dict[str, object]:
    return {"type": "rgb", "value": list(values)}


def studio_as_dictionary(scene: Studio, smoke: bool = True) -> dict[str, object]:
    """The scene of the look "medium" around a cube, written down once more."""
    place = mi.ScalarTransform4f

    def light(radiance: dict[str, object], origin: list[float], width: float, height: float) -> dict[str, object]:
        to_world = place().look_at(origin, [0, 0, 0], [0, 1, 0]) @ place().scale([width, height, 1])
        return {"type": "rectangle", "to_world": to_world, "emitter": {"type": "area", "radiance": radiance}}

    description = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 128, "rr_depth": 6},
        "camera": {
            "type": "perspective",
            "fov_axis": "x",
            "fov": float(scene.parameters["camera.x_fov"][0]),
            "to_world": place().look_at([0, 0, DISTANCE], [0, 0, 0], [0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": SIZE[0],
                "height": SIZE[1],
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent"},
        },
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(draw_sky.sky())},
        "ground": {
            "type": "disk",
            "to_world": place().translate([0, -0.502, 0]) @ place().rotate([1, 0, 0], -90) @ place().scale(200),
            "bsdf": {"type": "diffuse", "reflectance": rgb(0.169, 0.169, 0.169)},
        },
        "key": light(rgb(54, 47, 39), [-1.9, 2.7, 0.5], 0.6, 0.6),
        "rim": light(rgb(9, 12, 17), [2.4, 0.9, -2.0], 0.5, 0.9),
    }
    if smoke:
        description["smoke"] = {
            "type": "cube",
            "to_world": place().scale(0.5),
            "bsdf": {"type": "null"},
            "interior": {
                "type": "heterogeneous",
                "scale": 25.0,
                "albedo": rgb(0.92, 0.92, 0.92),
                "phase": {"type": "isotropic"},
                "sigma_t": {
                    "type": "gridvolume",
                    "grid": mi.VolumeGrid(noise(*CUBE)[..., None]),
                    "to_world": place().translate(-0.5),
                    "max_value": 1.1 * float(noise(*CUBE).max()),
                    "accel": False,
                },
            },
        }
    return description


def test_a_look_is_the_scene_that_a_dictionary_describes() -> None:
    density = noise(*CUBE)
    scene = studio(density, look="medium")
    scene.show(density, (0.0, 0.0))
    described = mi.load_dict(studio_as_dictionary(scene))
    # Emitters are numbered in the order of loading, which decides what a random number selects.
    images = [mi.render(s, spp=256, seed=0).numpy() for s in (scene.scene, described)]
    np.testing.assert_allclose(images[0].mean((0, 1)), images[1].mean((0, 1)), rtol=0.005)
    np.testing.assert_allclose(blocks(images[0]), blocks(images[1]), rtol=0.05)


def test_a_look_loads_with_mitsuba_alone(tmp_path) -> None:
    mi.VolumeGrid(noise(*CUBE)[..., None]).write(str(tmp_path / "smoke.vol"))
    for look in LOOKS:
        scene = mi.load_file(str(look_file(look)), volume=str(tmp_path / "smoke.vol"), largest=5, columns=6, rows=8)
        assert mi.traverse(scene)["smoke.interior_medium.scale"] == extinction(look)


def test_the_sky_is_as_bright_at_the_horizon_as_the_ground_it_lights() -> None:
    with OpenEXR.File(str(draw_sky.SKY)) as file:
        pixels = file.channels()["RGB"].pixels
    np.testing.assert_array_equal(pixels, draw_sky.sky())
    elevation = np.radians(90 - (np.arange(64) + 0.5) * 180 / 64)
    above = elevation > 0
    # Irradiance over π of the upper half: ∫ L sin cos / ∫ sin cos.
    weights = (np.sin(elevation) * np.cos(elevation))[above]
    ground = 0.169 * (weights @ pixels[above, 0]) / weights.sum()
    np.testing.assert_allclose(ground, pixels[32, 0], rtol=0.005)
    np.testing.assert_array_equal(pixels[29:], np.broadcast_to(pixels[32], pixels[29:].shape))
