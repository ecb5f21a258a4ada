"""What path-traced smoke leaves to chance: light scattered once is exact, the rest is unbiased and has little noise."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise

import tnst_mi
from tnst_mi.recipe.paths import LIGHTS
from tnst_mi.rendering.renderer import Renderer
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer, load_light
from tnst_mi.rendering.shadows import Lights, draw_lights
from tnst_mi.rendering.single_scattering import SingleScattering

CHECKOUT = Path(__file__).resolve().parents[2]
SHAPE = (10, 14, 12)
#: One orthographic, one in perspective.
VIEWS = [(0.0, 0.0), (30.0, 10.0, 40.0)]
GAMMA = 0.3

#: Standard errors that a mean may be off by; with 15 degrees of freedom, once in 800 times.
TOLERATED = 4.0


@pytest.fixture(scope="module")
def density() -> np.ndarray:
    """A cloud with thin rims inside an empty margin."""
    lumps = smooth_noise(np.random.default_rng(3), *SHAPE)
    cloud = blob(SHAPE, (5.5, 6.5, 4.5), 2.0) * (1.0 + 0.5 * lumps)
    cloud = np.where(blob(SHAPE, (5.5, 6.5, 4.5), 1.5) > 0.05, np.clip(cloud, 0, None), 0)
    return cloud.astype(np.float32)


@pytest.fixture(scope="module")
def weights() -> np.ndarray:
    return (1.0 + smooth_noise(np.random.default_rng(4), len(VIEWS), *SHAPE[1:])).astype(np.float32)


@pytest.fixture(scope="module")
def plain() -> type[ScatteringRenderer]:
    """The same smoke by Mitsuba's `prbvolpath` alone."""
    where = CHECKOUT / "scripts" / "noise_measures" / "plain.py"
    spec = importlib.util.spec_from_file_location("plain", where)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.PlainPathTracer


def renderer(kind: type[ScatteringRenderer], albedo: float, spp: int) -> ScatteringRenderer:
    return kind(SHAPE, GAMMA, 1.0, Lighting(albedo, 0.0, LIGHTS / "key.xml", spp))


def gradient(renderer: Renderer, density: np.ndarray, weights: np.ndarray, seed: int) -> np.ndarray:
    """Of the weighted sum of all pixels, which is linear in them."""
    return renderer.gradient(
        mi.TensorXf(density), VIEWS, [seed], mi.TensorXf(0 * weights), mi.TensorXf(weights)
    ).numpy()


def repeated(estimate: Callable[[int], np.ndarray], count: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard error of independent estimates."""
    values = np.stack([estimate(seed) for seed in range(count)]).astype(np.float64)
    return values.mean(0), values.std(0, ddof=1) / math.sqrt(count)


def test_light_scattered_once_in_a_uniform_box() -> None:
    """∫ α σ E/(4π) exp(−σ (s + t)) ds, with the distances s to the eye and t to the light."""
    tnst_mi.activate()
    shape, σ, albedo = (6, 5, 7), 0.4, 0.8
    once = SingleScattering(shape, σ, 1.0, albedo, shape[1:], 1.0)
    light = Lights(np.array([[-1.0, 0.0, 0.0]]), np.array([3.0]))
    image = once.images(mi.TensorXf(np.ones(shape, np.float32)), [(0.0, 0.0)], light).numpy()[0]
    to_light = np.arange(7) + 0.5
    expected = albedo * 3.0 / (4 * math.pi) * np.exp(-σ * to_light) * (1 - math.exp(-σ * 6))
    np.testing.assert_allclose(image, np.broadcast_to(expected, (5, 7)), rtol=1e-5)


def test_derivative_of_light_scattered_once(density: np.ndarray, weights: np.ndarray) -> None:
    """Against central differences, along directions that change smoke, and that put smoke beside it."""
    lights = draw_lights(load_light(LIGHTS / "key.xml"), seed=1, spp=4)
    once = SingleScattering(SHAPE, GAMMA, 1.0, 0.8, SHAPE[1:], 1.0)
    found = once.gradient(mi.TensorXf(density), VIEWS, lights, mi.TensorXf(weights)).numpy()

    def objective(of: np.ndarray) -> float:
        image = once.images(mi.TensorXf(of.astype(np.float32)), VIEWS, lights).numpy()
        return float((weights * image).sum(dtype=np.float64))

    direction = density * smooth_noise(np.random.default_rng(5), *SHAPE)
    slope = (objective(density + 0.05 * direction) - objective(density - 0.05 * direction)) / 0.1
    assert float((found * direction).sum()) == pytest.approx(slope, rel=2e-3)
    # No smoke can be less than none: differences to one side, of first and second order, are extrapolated.
    rim = (density == 0) & (sum(np.roll(density, shift, axis) for shift in (1, -1) for axis in range(3)) > 0)
    rises = [(objective(density + step * rim) - objective(density)) / step for step in (0.01, 0.02)]
    assert float(found[rim].sum()) == pytest.approx(2 * rises[0] - rises[1], rel=1e-2)


def test_drawn_lights_are_all_of_an_environment(tmp_path: Path) -> None:
    """Σ E_i is the integral of the radiance over all directions."""
    tnst_mi.activate()
    assert draw_lights(load_light(LIGHTS / "environment.xml"), 0, 4).irradiance.sum() == pytest.approx(
        4 * math.pi, rel=1e-5
    )
    rows = np.linspace(0.2, 3.0, 16, dtype=np.float32)[:, None, None]
    mi.Bitmap(np.broadcast_to(rows, (16, 32, 3)).copy()).write(str(tmp_path / "sky.exr"))
    (tmp_path / "sky.xml").write_text(
        "<scene version='3.0.0'><emitter type='envmap'><string name='filename' value='sky.exr'/></emitter></scene>"
    )
    sky = load_light(tmp_path / "sky.xml")
    directions = mi.warp.square_to_uniform_sphere(mi.Point2f(np.random.default_rng(0).random((2, 1 << 16))))
    si = dr.zeros(mi.SurfaceInteraction3f, 1 << 16)
    si.wi = -directions
    whole = 4 * math.pi * float(np.mean(mi.luminance(sky.environment().eval(si)).numpy()))
    sums = [draw_lights(sky, seed, 4).irradiance.sum() for seed in range(64)]
    assert np.mean(sums) == pytest.approx(whole, rel=0.01)


def test_more_paths_come_with_more_directions_of_an_environment(density: np.ndarray) -> None:
    """So that noise falls as that of paths does, or faster: directions are spread evenly."""
    tnst_mi.activate()
    light = load_light(LIGHTS / "environment.xml")
    once = SingleScattering(SHAPE, GAMMA, 1.0, 0.8, SHAPE[1:], 1.0)

    def noise(spp: int) -> float:
        drawn = [draw_lights(light, seed, spp) for seed in range(6)]
        images = [once.images(mi.TensorXf(density), VIEWS[:1], lights).numpy() for lights in drawn]
        return float(np.sqrt(np.var(images, axis=0).mean()) / np.mean(images))

    assert noise(512) < noise(64) / math.sqrt(512 / 64)
    assert [len(draw_lights(light, 0, spp).irradiance) for spp in (1, 64, 128, 1 << 20)] == [8, 8, 16, 64]


def test_nothing_has_the_derivative_of_the_first_smoke() -> None:
    """An empty grid against a difference to thin smoke; light that is scattered twice is of second order there."""
    empty, spread = np.zeros(SHAPE, np.float32), np.random.default_rng(6).random(SHAPE).astype(np.float32)
    one = np.ones((len(VIEWS), *SHAPE[1:]), np.float32)
    few = renderer(ScatteringRenderer, 0.9, 4)
    found = np.mean([(gradient(few, empty, one, seed) * spread).sum(dtype=np.float64) for seed in range(4)])
    thin = few.render(mi.TensorXf(1e-3 * spread), VIEWS, [1]).numpy()
    assert found == pytest.approx(thin.sum(dtype=np.float64) / 1e-3, rel=0.02)


def test_nothing_is_left_to_chance_where_nothing_is_scattered(density: np.ndarray, weights: np.ndarray) -> None:
    black = renderer(ScatteringRenderer, 0.0, 2)
    assert not gradient(black, density, weights, 1).any()


@pytest.mark.parametrize(
    ("light", "anisotropy", "noise"), [("far", 0.0, 0.02), ("far", 0.6, 0.02), ("inside", 0.0, 0.06)]
)
def test_images_are_those_of_prbvolpath(
    density: np.ndarray,
    weights: np.ndarray,
    plain: type[ScatteringRenderer],
    light: str,
    anisotropy: float,
    noise: float,
    tmp_path: Path,
) -> None:
    lamp = tmp_path / "lamp.xml"
    lamp.write_text(
        "<scene version='3.0.0'><emitter type='point'><point name='position' value='1, 2, 0.5'/></emitter></scene>"
    )

    def sums(kind: type[ScatteringRenderer]) -> tuple[np.ndarray, np.ndarray]:
        lighting = Lighting(0.8, anisotropy, lamp if light == "inside" else LIGHTS / "key.xml", 64)
        traced = kind(SHAPE, GAMMA, 1.0, lighting)

        def of_views(seed: int) -> np.ndarray:
            return (weights * traced.images(mi.TensorXf(density), VIEWS, [seed]).numpy()).sum((1, 2))

        return repeated(of_views)

    (ours, our_error), (theirs, their_error) = sums(ScatteringRenderer), sums(plain)
    error = np.hypot(our_error, their_error)
    assert (error < noise * theirs).all()
    assert (np.abs(ours - theirs) < TOLERATED * error + 2e-3 * theirs).all()


def test_derivatives_are_those_of_prbvolpath(
    density: np.ndarray, weights: np.ndarray, plain: type[ScatteringRenderer]
) -> None:
    """Along directions that change the smoke there is, in each of which every cell takes part."""
    random = np.random.default_rng(6)
    directions = np.stack([density * (1 + smooth_noise(random, *SHAPE, passes=4)) for _ in range(4)])

    def along(kind: type[ScatteringRenderer], spp: int) -> tuple[np.ndarray, np.ndarray]:
        traced = renderer(kind, 0.8, spp)
        return repeated(lambda seed: (directions * gradient(traced, density, weights, seed)).sum((1, 2, 3)))

    (ours, our_error), (theirs, their_error) = along(ScatteringRenderer, 16), along(plain, 64)
    error, scale = np.hypot(our_error, their_error), np.abs(theirs).mean()
    assert (error < 0.1 * scale).all()
    assert (np.abs(ours - theirs) < TOLERATED * error + 5e-3 * scale).all()


def test_derivatives_beside_smoke_are_those_of_images(density: np.ndarray, weights: np.ndarray) -> None:
    """`prbvolpath` never scatters there, and leaves out what more smoke would scatter."""
    traced = renderer(ScatteringRenderer, 0.8, 16)
    rim = (density == 0) & (sum(np.roll(density, shift, axis) for shift in (1, -1) for axis in range(3)) > 0)
    found, error = repeated(lambda seed: gradient(traced, density, weights, seed)[rim].sum())

    def rise(seed: int) -> np.ndarray:
        images = [traced.images(mi.TensorXf(of), VIEWS, [seed]).numpy() for of in (density, density + 0.02 * rim)]
        return (weights * (images[1] - images[0])).sum() / 0.02

    expected, its_error = repeated(rise)
    assert math.hypot(error, its_error) < 0.05 * expected
    assert found == pytest.approx(expected, abs=TOLERATED * math.hypot(error, its_error) + 0.02 * expected)


@pytest.mark.parametrize(("albedo", "times"), [(0.3, 30.0), (0.9, 4.0)])
def test_noise_of_derivatives(
    density: np.ndarray, weights: np.ndarray, plain: type[ScatteringRenderer], albedo: float, times: float
) -> None:
    """At equal paths, by more than this many times; of few estimates with long tails, about 100 to 200 and 9 to 20."""

    def variance(kind: type[ScatteringRenderer]) -> float:
        traced = renderer(kind, albedo, 4)
        return float(np.square(repeated(lambda seed: gradient(traced, density, weights, seed))[1]).mean())

    ratio = variance(plain) / variance(ScatteringRenderer)
    assert ratio > times


def test_forward_mode_is_refused() -> None:
    tnst_mi.activate()
    integrator = mi.load_dict({"type": "scattered_light"})
    with pytest.raises(RuntimeError, match="no forward-mode derivatives"):
        integrator.sample(dr.ADMode.Forward, None, None, None, None, None, None)
