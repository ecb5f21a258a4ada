"""The outline of smoke, by what views see as empty, and that a path tracer's noise leaves no haze outside of it."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from render_views import camera_at, places, radius_around, write_views

import tnst_mi
from tnst_mi.cli import main
from tnst_mi.fields.grid import Octave
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.recipe.paths import LIGHTS
from tnst_mi.reconstruction.fitting.outline import outline
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.reconstruction.reconstruct import reconstruct
from tnst_mi.rendering.scattering import Lighting, ScatteringRenderer


@pytest.fixture
def photographs(cloud, renderer) -> list[Photograph]:
    cameras = [camera_at(place) for place in places(8, radius_around(cloud.shape))]
    images = renderer.render(mi.TensorXf(cloud), cameras).numpy()
    peak, ones = images.max(), np.ones(renderer.size, np.float32)
    return [Photograph("", c, image / peak, ones, None, False) for c, image in zip(cameras, images, strict=True)]


def test_all_smoke_is_inside_and_little_else(cloud, photographs):
    possible = outline(photographs, Octave(cloud.shape, 1.0), 0.0, 1e-4)
    assert possible[cloud > 0.02].all()
    assert (cloud > 0).mean() < possible.mean() < 2 * (cloud > 0).mean()


def test_noise_carves_no_smoke_away(cloud, photographs):
    rng = np.random.default_rng(3)
    noisy = [
        Photograph("", p.camera, p.values + rng.normal(0, 0.01, p.values.shape), p.weights, None, False)
        for p in photographs
    ]
    possible = outline(noisy, Octave(cloud.shape, 1.0), 0.0, 0.01)
    assert cloud[~possible].sum() < 0.01 * cloud.sum() and possible.mean() < 0.8
    # Of noise that seems to be larger than smoke is bright, the smoke may be the reason.
    assert cloud[~outline(photographs, Octave(cloud.shape, 1.0), 0.0, 0.5)].sum() < 0.05 * cloud.sum()


def test_masked_pixels_and_cells_out_of_sight_may_hide_smoke(cloud, photographs):
    hidden = [Photograph("", p.camera, p.values, 0 * p.weights, None, False) for p in photographs]
    assert outline(hidden, Octave(cloud.shape, 1.0), 0.0, 1e-4).all()
    (first, *_) = photographs
    narrow = tnst_mi.Camera(first.camera.to_world, True, 4.0, 1.0)
    aside = Photograph("", narrow, 0 * first.values, first.weights, None, False)
    seen = ~outline([aside], Octave(cloud.shape, 1.0), 0.0, 1e-4)
    assert 0 < seen.mean() < 0.2


def test_views_that_contradict_each_other_are_told_in_one_line(views, tmp_path, capsys):
    """Smoke at the lower edge of one picture and at the upper edge of another, from the same height."""
    for number, file in enumerate(sorted(views.parent.glob("*.exr"))):
        image = np.zeros((20, 20), np.float32)
        image[:2] = 1
        write_exr(tmp_path / file.name, image if number % 2 else image[::-1].copy(), {})
    (tmp_path / "cameras.toml").write_text(views.read_text())
    flags = ["--integrator", "prbvolpath", "--levels", "1"]
    assert main(["reconstruct", str(tmp_path / "cameras.toml"), "--out", str(tmp_path / "out"), *flags]) == 2
    told = capsys.readouterr().err
    assert "every cell of the box is seen as empty by some view" in told and told.count("\n") == 1


def test_scattered_light_is_fitted_inside_the_outline(cloud, tmp_path):
    lighting = Lighting(0.8, 0.0, LIGHTS / "key.xml", 64)
    traced = ScatteringRenderer(cloud.shape, 0.3, 1.0, lighting, (20, 20))
    views = write_views(tmp_path, [tnst_mi.Frame(cloud)], traced, (8, 2), 0.0, 0.3)
    keys = {"integrator": "prbvolpath", "albedo": 0.8, "spp": 4, "iterations": 60, "levels": 1}
    found = reconstruct(views, tmp_path / "out", keys, progress=False)
    with np.load(found.densities[0]) as file:
        density = file["density"]
    assert (density > 0).mean() < 2 * (cloud > 0).mean()
    assert np.linalg.norm(density - cloud) < 0.4 * np.linalg.norm(cloud)
    # Its renderings are noisier than its pictures, which decides how smooth it becomes.
    assert 0.02 < found.records[0]["noise"] < 0.3
