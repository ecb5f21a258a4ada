"""Fire in the studio: slabs and equilibrium in closed form, colours of black bodies, which grid burns."""

from __future__ import annotations

import math
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from lit_smoke import under_a_sky

from tnst_mi.errors import InputError
from tnst_mi.fields.bounds import smoke_box
from tnst_mi.frame import Frame
from tnst_mi.rendering import fire
from tnst_mi.rendering.fire import Fire, black_body, find_fire, glow_colours
from tnst_mi.rendering.fire_light import FireLight
from tnst_mi.rendering.looks import extinction
from tnst_mi.rendering.studio import Smoke, Studio

CUBE, SIZE = (8, 8, 8), (48, 64)
#: 256 pixels that look through the front and the back of the cube.
MIDDLE = (slice(24, 40), slice(16, 32))
FRONT = (0.0, 0.0)


def alone(density: np.ndarray, albedo: float, sky: float = 0.0) -> Studio:
    """A studio with fire, whose only other light is a sky of a radiance, and nothing else but the smoke."""
    smoke = replace(Smoke.of([density]), occupied=(slice(0, 8),) * 3)
    return under_a_sky(Studio("thin", "volpath", smoke, [FRONT], SIZE, burns=True), albedo, sky)


def uniform(colour: tuple[float, float, float], shape: tuple[int, int, int] = CUBE) -> np.ndarray:
    return np.broadcast_to(np.float32(colour), (*shape, 3)).copy()


def fire_alone(scene: Studio, density: np.ndarray, emission: np.ndarray, passes: int, view=FRONT) -> np.ndarray:
    """The picture of a density in the light of its fire."""
    scene.show(density, view, emission)
    light = scene._fire
    assert light is not None
    return sum(light.render(scene.scene, scene.sensor, seed).numpy() for seed in range(passes)) / passes


def middle(scene: Studio, density: np.ndarray, emission: np.ndarray, passes: int = 24) -> np.ndarray:
    """Mean colour of the pixels in the middle, of 256 paths a pass."""
    return fire_alone(scene, density, emission, passes)[MIDDLE].mean((0, 1))


# --- Closed forms -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("thickness", [0.5, 2.0])
def test_a_slab_that_absorbs_and_emits(thickness: float) -> None:
    """L = j / σ_a (1 − exp(−σ_a s)), here with s = 1."""
    density = np.full(CUBE, thickness / extinction("thin"), np.float32)
    found = middle(alone(density, albedo=0.0), density, uniform((2.0, 1.0, 0.25)))
    expected = (1 - math.exp(-thickness)) / thickness * np.array([2.0, 1.0, 0.25])
    # 6144 paths, each with a relative standard deviation below 1.1; rays are at most 0.02% longer than the slab.
    np.testing.assert_allclose(found, expected, rtol=4 * 1.1 / math.sqrt(6144))


def test_fire_without_smoke_is_as_bright_as_the_way_through_it_is_long() -> None:
    """L = j s, where the smoke beside it is what proposes collisions."""
    density = np.zeros(CUBE, np.float32)
    density[:, :, 0] = 20.0 / extinction("thin")
    density[:, :, -1] = density[:, :, 0]
    found = middle(alone(density, albedo=0.0), density, uniform((3.0, 1.0, 0.0)))
    np.testing.assert_allclose(found, [3.0, 1.0, 0.0], rtol=0.02)


def test_smoke_in_front_dims_fire_and_smoke_behind_does_not() -> None:
    density = np.zeros(CUBE, np.float32)
    density[6:] = 4.0 / extinction("thin")  # towards the camera
    emission = np.zeros((*CUBE, 3), np.float32)
    emission[:3] = 1.0
    # Both are interpolated linearly between the centres of cells, which changes no integral here.
    scene = alone(density, albedo=0.0)
    behind_smoke = middle(scene, density, emission)
    before_smoke = middle(scene, density[::-1].copy(), emission[::-1].copy())
    np.testing.assert_allclose(before_smoke, 3 / 8, rtol=0.03)
    np.testing.assert_allclose(behind_smoke, 3 / 8 * math.exp(-4.0 * 2 / 8), rtol=0.05)


@pytest.mark.parametrize("albedo", [0.0, 0.6, 0.9])
def test_smoke_in_equilibrium_with_its_surroundings_cannot_be_seen(albedo: float) -> None:
    """j = σ_a under a sky of radiance 1: what scatters, absorbs and emits then has the radiance 1 everywhere."""
    density = np.abs(np.random.default_rng(3).normal(size=CUBE)).astype(np.float32)
    density *= 8.0 / extinction("thin") / density.max()
    absorption = extinction("thin") * (1 - albedo) * density
    scene = alone(density, albedo, sky=1.0)
    image = scene.render(density, FRONT, 32, 4, np.repeat(absorption[..., None], 3, axis=3))
    assert image[MIDDLE].mean() == pytest.approx(1.0, abs=0.02)
    assert image.mean() == pytest.approx(1.0, abs=0.005)
    # Not without the fire.
    assert scene.render(density, FRONT, 8, 4, 0 * uniform((1, 1, 1)))[MIDDLE].mean() < 0.85


def test_fire_lights_the_ground() -> None:
    """Under a fire far smaller than its height, the ground shines as under a point light: E/π times its reflectance."""
    density = np.zeros((16, 16, 16), np.float32)
    density[7:9, 7:9, 7:9] = 0.02
    emission = np.zeros((*density.shape, 3), np.float32)
    emission[7:9, 7:9, 7:9] = 400.0
    occupied = smoke_box(density, 1)
    assert occupied is not None
    view = (0.0, 40.0)
    scene = Studio("thin", "volpath", Smoke.of([density]), [view], (128, 128), burns=True)
    image = fire_alone(scene, density, emission, 150, view)
    # Where the middle of the lower rows meets the ground.
    sensor = scene.scene.sensors()[0]
    rows = np.arange(96, 120)
    place = mi.Point2f(mi.Float(np.full(24, 0.5)), mi.Float((rows + 0.5) / 128))
    ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    ground = np.array(scene.scene.ray_intersect(ray).p)
    distance = np.linalg.norm(ground, axis=0)
    power = 400.0 * 8 / 16**3  # j V, the radiant intensity, which trilinear interpolation preserves
    expected = 0.169 / math.pi * power * (-ground[1] / distance) / distance**2
    found = image[rows, 48:80, 0].mean(axis=1)
    assert found.mean() == pytest.approx(expected.mean(), rel=0.15)


def test_a_picture_with_fire_repeats_and_frames_without_fire_are_dark() -> None:
    density = np.full(CUBE, 0.1, np.float32)
    scene = alone(density, albedo=0.5)
    images = [scene.render(density, FRONT, 3, 7, uniform((1, 1, 1))) for _ in range(2)]
    np.testing.assert_array_equal(*images)
    assert fire_alone(scene, density, 0 * uniform((1, 1, 1)), 3).max() == 0.0


def test_emission_is_where_its_cells_are() -> None:
    light = FireLight((-0.5, -0.25, 0.0), (0.5, 0.25, 2.0))
    emission = np.zeros((4, 2, 2, 3), np.float32)
    emission[3, 1, 0] = (1.0, 2.0, 3.0)
    light.set(emission)
    at = mi.Interaction3f()
    at.p = mi.Point3f(-0.25, 0.125, 1.75)
    np.testing.assert_allclose(np.ravel(light._emission.eval_3(at)), [1.0, 2.0, 3.0], rtol=1e-6)


# --- Colours ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kelvin, x, y", [(2000, 0.5267, 0.4133), (2856, 0.4476, 0.4074), (6500, 0.3135, 0.3237)])
def test_black_bodies_have_the_chromaticities_of_the_planckian_locus(kelvin: float, x: float, y: float) -> None:
    """CIE 1931 chromaticities; 2856 K is illuminant A."""
    to_xyz = np.linalg.inv(fire._SRGB)
    xyz = to_xyz @ black_body(np.array([float(kelvin)]))[0]
    # Of 2000 K, the blue of sRGB is negative and clipped.
    np.testing.assert_allclose(xyz[:2] / xyz.sum(), [x, y], atol=0.012)


def test_temperatures_glow_as_plancks_law_says() -> None:
    """Ratios of luminance of neighbouring temperatures, against a sum over wavelengths with an observer of its own."""
    frame = Frame(np.ones((1, 1, 3)), grids={"temperature": np.array([[[1000.0, 1500.0, 2000.0]]])})
    burning = find_fire([frame])
    assert burning is not None and burning.temperature and burning.grid == "temperature"
    emission = burning.emission(frame)[0, 0]
    assert emission.max() == pytest.approx(fire.BRIGHTNESS, rel=1e-3) == emission[2, 0]
    wavelength = np.linspace(400e-9, 720e-9, 400)
    red = np.exp(-0.5 * ((wavelength - 600e-9) / 37e-9) ** 2)
    planck = [(red * wavelength**-5 / np.expm1(0.01438777 / (wavelength * t))).sum() for t in (1000, 1500, 2000)]
    np.testing.assert_allclose(emission[1, 0] / emission[2, 0], planck[1] / planck[2], rtol=0.3)
    assert emission[0, 0] < 0.01 * emission[1, 0]


def test_flames_are_proportional_and_redder_where_they_are_faint() -> None:
    values = np.array([[[0.0, 0.25, 0.5, 1.0]]])
    frame = Frame(np.ones(values.shape), grids={"flame": values})
    burning = find_fire([frame])
    assert burning is not None and not burning.temperature
    emission = burning.emission(frame)[0, 0]
    np.testing.assert_allclose(emission[:, 0], fire.BRIGHTNESS * values[0, 0], rtol=2e-3, atol=1e-6)
    green = emission[1:, 1] / emission[1:, 0]
    assert (np.diff(green) > 0).all()


@pytest.mark.parametrize(
    "kelvin, x, y",
    [(2856, 0.4476, 0.4074), (4000, 0.3805, 0.3768), (5000, 0.3451, 0.3516), (6500, 0.3135, 0.3237)],
)
def test_smoke_has_the_hues_of_the_planckian_locus(kelvin: float, x: float, y: float) -> None:
    """CIE 1931 chromaticities; the primaries and the white of sRGB are those of IEC 61966-2-1."""
    colour = glow_colours(np.float32([[kelvin]]), 9000.0)[0, 0].astype(float)
    xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]] @ colour
    np.testing.assert_allclose(xyz[:2] / xyz.sum(), [x, y], atol=0.004)
    assert colour.max() == pytest.approx(1.0, abs=1e-3)


def test_hues_of_temperatures_with_and_without_a_unit() -> None:
    """Without one, 0 is 20 °C and the largest is 2200 K; colder than 1000 K is as at 1000 K, without blue."""
    kelvin = np.array([-5.0, 293.0, 1000.0, 1246.5, 2200.0])
    in_kelvin = glow_colours(kelvin, 2200.0)
    np.testing.assert_array_equal(in_kelvin[:2], in_kelvin[[2, 2]])
    assert in_kelvin[0, 0] == pytest.approx(1.0) and in_kelvin[0, 1] < 0.1 and in_kelvin[0, 2] == 0.0
    assert (np.diff(in_kelvin[2:, 1]) > 0.02).all()
    np.testing.assert_allclose(glow_colours(np.array([0.0, 1.5, 3.0]), 3.0), in_kelvin[[1, 3, 4]], atol=1e-6)
    # The largest of all frames decides, and not what one of them has.
    assert glow_colours(np.array([100.0]), 150.0)[0, 1] > glow_colours(np.array([100.0]), 2200.0)[0, 1] + 0.05


# --- Which grid burns -------------------------------------------------------------------------------------


def frames_with(**grids: float) -> list[Frame]:
    """Two frames, in the second of which every grid has a value in one cell."""
    empty = {name: np.zeros((2, 3, 4)) for name in grids}
    full = {name: array.copy() for name, array in empty.items()}
    for name, value in grids.items():
        full[name][1, 2, 3] = value
    return [Frame(np.ones((2, 3, 4)), grids=empty), Frame(np.ones((2, 3, 4)), grids=full)]


@pytest.mark.parametrize(
    "grids, choice, taken",
    [
        ({"flame": 1.0, "temperature": 2000.0}, None, "flame"),
        ({"temperature": 2000.0, "flame_noise": 0.5}, None, "flame_noise"),
        ({"temperature": 2000.0}, None, "temperature"),
        ({"temperature": 2.0}, None, None),
        ({"temperature": 320.0}, None, None),
        ({"temperature": 2.0}, "temperature", "temperature"),
        ({"flame": 0.0, "temperature": 1500.0}, None, "temperature"),
        ({"fuel": 1.0}, None, None),
        ({"fuel": 1.0}, "fuel", "fuel"),
        ({"flame": 1.0}, "none", None),
        ({}, None, None),
    ],
)
def test_what_burns(grids: dict[str, float], choice: str | None, taken: str | None) -> None:
    found = find_fire(frames_with(**grids), choice)
    assert (found and found.grid) == taken
    if found is not None:
        assert found.grid in found.in_words and found.largest == grids[found.grid]
        assert found.occupied == (slice(0, 2), slice(1, 3), slice(2, 4))
        assert found.emission(frames_with(**grids)[0]).max() < 1e-6 * fire.BRIGHTNESS


@pytest.mark.parametrize(
    "grids, choice, message",
    [
        ({"flame": 1.0}, "flames", "--fire flames: no frame has such a grid; expected one of 'flame', or none"),
        ({}, "flame", "--fire flame: no frame has such a grid; there is none beside the density"),
        ({"flame": 0.0}, "flame", "--fire flame: is not above 0 anywhere"),
    ],
)
def test_what_cannot_burn(grids: dict[str, float], choice: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        find_fire(frames_with(**grids), choice)


def test_vectors_do_not_burn() -> None:
    """But colours do."""
    frame = Frame(np.ones((2, 3, 4)), grids={"fire": np.ones((2, 3, 4, 3))})
    assert find_fire([frame]) is None
    with pytest.raises(InputError, match=r"grid 'fire' has shape .* expected a scalar grid to burn"):
        find_fire([frame], "fire")


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
def test_smoke_of_a_colour_shines_in_it_and_empty_air_does_not(dtype: type) -> None:
    colours = np.full((2, 3, 4, 3), (120, 60, 20), dtype)
    density = np.zeros((2, 3, 4), np.float32)
    density[1, 1, 1], density[0, 1, 1] = 4.0, 2.0
    frames = [Frame(density, grids={"Cd": colours}), Frame(density / 2, grids={"Cd": colours})]
    assert find_fire(frames) is None
    found = find_fire(frames, "Cd")
    assert found is not None and found.in_words == "fire: grid Cd as the colour of light, times the density"
    assert found.occupied == (slice(0, 2), slice(0, 3), slice(0, 3))
    expected = fire.COLOUR_BRIGHTNESS * np.array([1, 1 / 2, 1 / 6]) * density[..., None] / 4
    np.testing.assert_allclose(found.emission(frames[0]), expected, rtol=1e-5)
    np.testing.assert_allclose(found.emission(frames[1]), expected / 2, rtol=1e-5)


def test_a_grid_of_light_shines_as_it_is() -> None:
    light = np.zeros((2, 3, 4, 3), np.float32)
    light[1, 2, 3] = (0.5, 2.0, 0.0)
    frame = Frame(np.zeros((2, 3, 4)), grids={"emission_color": light})
    found = find_fire([frame], "emission_color")
    assert found is not None and found.occupied == (slice(0, 2), slice(1, 3), slice(2, 4))
    np.testing.assert_allclose(found.emission(frame), fire.COLOUR_BRIGHTNESS / 2 * light)


def test_a_frame_without_the_grid_does_not_burn() -> None:
    burning = Fire("flame", False, 1.0, (slice(0, 1), slice(0, 1), slice(0, 1)))
    assert burning.emission(Frame(np.ones((2, 3, 4)))).max() == 0.0
