"""Path-traced scattering smoke: closed forms, derivatives, fresh noise, lights from files, and what it drives."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise
from networks import random_googlenet

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.machine.backend import on_gpu
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.single_frame import optimise
from tnst_mi.recipe.paths import LIGHTS, shipped_lights
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.driving import driving_renderer, main_view
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer, Renderer
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer, _seeds, load_light

SHAPE = (8, 12, 10)
VIEWS = [(0.0, 0.0), (30.0, 10.0)]
GAMMA = 0.15


@pytest.fixture(scope="module")
def density() -> np.ndarray:
    """A lumpy cloud inside its grid."""
    lumps = smooth_noise(np.random.default_rng(3), *SHAPE)
    return np.clip(blob(SHAPE, (4.5, 5.5, 3.5), 2.0) * (1.0 + lumps), 0.0, None).astype(np.float32)


def furnace(spp: int, albedo: float = 1.0, anisotropy: float = 0.0) -> ScatteringRenderer:
    lighting = Lighting(albedo, anisotropy, LIGHTS / "environment.xml", spp)
    return ScatteringRenderer(SHAPE, GAMMA, 1.0, lighting)


def images(renderer: Renderer, density: np.ndarray, seed: Sequence[int] = (0,)) -> np.ndarray:
    return renderer.render(mi.TensorXf(density), VIEWS, seed).numpy()


@pytest.mark.parametrize("anisotropy", [0.0, 0.7])
def test_white_furnace(density: np.ndarray, anisotropy: float):
    # Smoke that absorbs nothing, in light from everywhere, is as bright as the light: what its body covers, 1 - T, is
    # exactly what the absorbing renderer calls "transmittance". A path tracer averages over pixels, that one does not.
    spp = 4096
    traced = images(furnace(spp, anisotropy=anisotropy), density)
    absorbed = EmissionAbsorptionRenderer(SHAPE, GAMMA, "transmittance", 1.0, step=0.1)
    expected = images(absorbed, density)
    assert expected.max() > 0.3
    assert np.abs(traced.mean((1, 2)) / expected.mean((1, 2)) - 1.0).max() < 0.01
    # Pixels differ by their noise and by their own slope; a one-cell shift or a flip would show here.
    assert np.corrcoef(traced.ravel(), expected.ravel())[0, 1] > 0.995


def test_smoke_that_scatters_nothing_is_black(density: np.ndarray):
    assert images(furnace(4, albedo=0.0), density).max() == 0.0


def test_the_background_is_black(density: np.ndarray):
    empty = furnace(4)
    assert images(empty, np.zeros_like(density)).max() == 0.0


def test_gradient_of_the_furnace(density: np.ndarray):
    # The derivative of Σ w I in random smooth directions, against the absorbing renderer's.
    weights = mi.TensorXf(smooth_noise(np.random.default_rng(4), len(VIEWS), *SHAPE[1:]))

    def gradient(renderer: Renderer) -> np.ndarray:
        leaf = mi.TensorXf(density)
        dr.enable_grad(leaf)
        dr.backward(dr.sum(renderer.render(leaf, VIEWS) * weights, axis=None))
        return dr.grad(leaf).numpy()

    traced = gradient(furnace(2048))
    expected = gradient(EmissionAbsorptionRenderer(SHAPE, GAMMA, "transmittance", 1.0))
    rng = np.random.default_rng(5)
    directions = [smooth_noise(rng, *SHAPE, passes=4).ravel() for _ in range(24)]
    a, b = (np.array([field.ravel() @ direction for direction in directions]) for field in (traced, expected))
    assert (a @ b) / (b @ b) == pytest.approx(1.0, abs=0.1)
    assert np.corrcoef(a, b)[0, 1] > 0.97


def test_noise_belongs_to_the_seed(density: np.ndarray):
    renderer = furnace(4)
    first, second = images(renderer, density, [7, 1]), images(renderer, density, [7, 2])
    assert not np.array_equal(first, second)
    # Whatever was rendered in between, and by which renderer of the kind.
    assert np.array_equal(first, images(renderer, density, [7, 1]))
    assert np.array_equal(second, images(furnace(4), density, [7, 2]))


def test_images_and_derivatives_share_no_random_numbers():
    seeds = [seed for iteration in range(64) for seed in _seeds([7, iteration])]
    assert len(set(seeds)) == 256 and all(0 <= seed < 1 << 32 for seed in seeds)


def test_images_do_not_depend_on_what_was_rendered_before(density: np.ndarray):
    """Neither under a majorant that was too small for them nor under one that is larger than theirs."""
    fresh = images(furnace(64), 10 * density)
    for earlier in (0.2, 100.0):
        used = furnace(64)
        images(used, earlier * density)
        found = images(used, 10 * density)
        # Other paths would differ by the noise. A GPU adds those of a pixel in no fixed order.
        np.testing.assert_allclose(found, fresh, rtol=1e-5 if on_gpu() else 0, atol=0)


def test_the_majorant_is_no_bias(density: np.ndarray):
    """Smoke twice as dense in light that scatters half as much: the same path lengths under another majorant."""
    thin, thick = (ScatteringRenderer(SHAPE, gamma, 1.0, furnace(2048).lighting) for gamma in (GAMMA, GAMMA / 64))
    assert images(thin, density).mean() == pytest.approx(images(thick, 64 * density).mean(), rel=0.01)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<scene version='3.0.0'></scene>", "has no emitter"),
        ("no xml", "cannot be read as a Mitsuba scene"),
        ("<scene version='3.0.0'><shape type='sphere'><emitter type='area'/></shape></scene>", "belongs to a shape"),
    ],
)
def test_lights_that_cannot_be_used(tmp_path: Path, text: str, told: str):
    tnst_mi.activate()
    (tmp_path / "light.xml").write_text(text)
    with pytest.raises(InputError, match=told) as raised:
        load_light(tmp_path / "light.xml")
    assert "light.xml" in str(raised.value) and "\n" not in str(raised.value)


def test_light_falls_from_where_the_file_says(density: np.ndarray):
    key = ScatteringRenderer(SHAPE, 1.0, 1.0, Lighting(0.5, 0.0, LIGHTS / "key.xml", 512))
    image = key.render(mi.TensorXf(blob(SHAPE, (4.5, 5.5, 3.5), 2.0)), [(0.0, 0.0)]).numpy()[0]
    assert image[:, :5].sum() > 1.2 * image[:, 5:].sum(), "the left is brighter"
    assert image[:6].sum() > 1.2 * image[6:].sum(), "the top is brighter"


def test_shipped_lights_and_files_in_recipes(tmp_path: Path):
    assert shipped_lights() == ["environment", "key"]
    (tmp_path / "mine.xml").write_text((LIGHTS / "key.xml").read_text())
    (tmp_path / "recipe.toml").write_text('tag = ["net"]\nlight = "mine.xml"\n')
    assert Recipe.from_toml(tmp_path / "recipe.toml").light == str((tmp_path / "mine.xml").resolve())
    (tmp_path / "recipe.toml").write_text('tag = ["net"]\nlight = "missing.xml"\n')
    with pytest.raises(InputError, match=r"light = 'missing.xml': no such file, nor one of environment, key"):
        Recipe.from_toml(tmp_path / "recipe.toml")


def test_it_drives_a_stylization(density: np.ndarray, tmp_path: Path):
    network = GoogLeNet.load(random_googlenet(tmp_path / "random.safetensors", narrow=8))
    goal = {"semantic": ("inception_3a/3x3:2",), "octaves": 1, "iterations": 8, "views": 2, "gamma": 0.3}
    frame = Frame(density, name="cloud")
    traced = Recipe(**goal, integrator="prbvolpath", albedo=0.95, spp=32)
    results = [optimise(frame, traced, network) for _ in range(2)]
    # To rounding: the derivatives of `prbvolpath` are summed up in the order in which threads come.
    assert np.allclose(results[0].density, results[1].density, rtol=0.0, atol=1e-4)
    # The goal is met under emission and absorption too, which took no part.
    plain = Recipe(**goal)
    renderer = driving_renderer(plain, SHAPE, 1.0)
    exposure = 1.0 / main_view(density, plain).max()

    def fires(of: np.ndarray) -> float:
        image = exposure * renderer.render(mi.TensorXf(of), [(0.0, 0.0)]).torch()
        return (
            network(image[:, None].expand(-1, 3, -1, -1), ["inception_3a/3x3"])["inception_3a/3x3"][:, 2].mean().item()
        )

    assert fires(results[0].density) > fires(density)
