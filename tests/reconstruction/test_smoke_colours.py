"""The colour of smoke from pictures: two clouds of different colours, grey ones, and what is beside them."""

from __future__ import annotations

import signal

import numpy as np
import pytest
from render_views import camera_at, places, radius_around, write_views

import tnst_mi
from tnst_mi.cli import main
from tnst_mi.io.pictures.exr import read_exr
from tnst_mi.reconstruction import one_frame
from tnst_mi.reconstruction.fitting import smoke_colours
from tnst_mi.reconstruction.output.sides import three_sides
from tnst_mi.reconstruction.photographs import LUMINANCE, Photograph, strength
from tnst_mi.reconstruction.reconstruct import reconstruct
from tnst_mi.rendering.coloured_renderer import ColouredRenderer

GAMMA = 0.3
ORANGE, BLUE = (1.0, 0.5, 0.1), (0.1, 0.4, 1.0)
KEYS = {"iterations": 40, "levels": 1, "batch": 3, "channel": "rgb"}


@pytest.fixture(scope="module")
def colours(cloud) -> np.ndarray:
    """The lower of the two balls is orange, the upper one blue, and both are as bright as white smoke."""
    y = np.linspace(0, 1, cloud.shape[1], dtype=np.float32)[None, :, None, None]
    blue = np.clip(4 * y - 1.7, 0, 1)
    mixed = (1 - blue) * ORANGE + blue * BLUE
    return np.broadcast_to(mixed / mixed.max(-1, keepdims=True), (*cloud.shape, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def coloured_views(cloud, colours, tmp_path_factory):
    renderer = ColouredRenderer(cloud.shape, GAMMA, "exact", 1.0, size=(20, 20))
    out = tmp_path_factory.mktemp("coloured")
    return write_views(out, [tnst_mi.Frame(cloud, grids={"Cd": colours})], renderer, (12, 3), 0.0, GAMMA)


def shorten(patch: pytest.MonkeyPatch) -> None:
    """Once, and with fewer steps, is enough for so little smoke."""
    patch.setattr(one_frame, "COLOUR_ROUNDS", 1)
    patch.setattr(one_frame, "REFINING_STEPS", 30)


@pytest.fixture(scope="module")
def found(coloured_views, tmp_path_factory) -> tnst_mi.Reconstruction:
    """What is found of them."""
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch)
        return reconstruct(coloured_views, tmp_path_factory.mktemp("found"), KEYS, progress=False)


def test_two_clouds_get_their_colours(found, coloured_views, cloud, colours):
    (frame,) = tnst_mi.load_frames(found.densities[0])
    colour = frame.grids["Cd"]
    assert np.linalg.norm(frame.density - cloud) < 0.15 * np.linalg.norm(cloud)
    assert np.sqrt(((colour - colours) ** 2).mean(-1)[cloud > 0.1].mean()) < 0.06
    assert colour.min() >= 0 and found.records[0]["psnr"] > 45
    # What the file holds is what is seen, by whoever renders it.
    image = tnst_mi.render(
        frame.density,
        camera=camera_at(places(3, radius_around(cloud.shape), 0.37)[1]),
        gamma=GAMMA,
        quadrature="exact",
        size=(20, 20),
        colour=colour,
    )
    assert np.allclose(image, read_exr(found.densities[0].parents[1] / "images" / "smoke_held_out_01.exr"), atol=1e-3)
    assert np.allclose(image, read_exr(coloured_views.with_name("held_out_01.exr")), atol=0.1 * image.max())
    # Beside the smoke, its colours go on: nothing is black there, and orange stays below blue.
    empty = cloud == 0
    assert colour[empty].max(-1).min() > 0.3
    assert colour[:, 0][empty[:, 0]][:, 0].mean() > 2 * colour[:, -1][empty[:, -1]][:, 0].mean()


def test_grey_pictures_give_grey(views, tmp_path, monkeypatch):
    monkeypatch.setattr(one_frame, "COLOUR_ROUNDS", 0)
    found = reconstruct(views, tmp_path / "out", {**KEYS, "iterations": 20}, progress=False)
    with np.load(found.densities[0]) as file:
        assert np.ptp(file["Cd"], axis=-1).max() == 0
        white = (file["density"] * file["Cd"][..., 0]).sum() / file["density"].sum()
    assert white == pytest.approx(1, abs=0.05) and found.records[0]["mean_colour"] == pytest.approx([white] * 3)


def test_stopped_among_its_colours_it_goes_on_to_the_same_bits(found, coloured_views, tmp_path, monkeypatch):
    shorten(monkeypatch)
    improved, taken = smoke_colours._ColourProblem.improved, []

    def stopped_once(problem, *given):
        taken.append(1)
        if len(taken) == 50:
            signal.raise_signal(signal.SIGINT)
        return improved(problem, *given)

    monkeypatch.setattr(smoke_colours._ColourProblem, "improved", stopped_once)
    parts = reconstruct(coloured_views, tmp_path / "parts", KEYS, progress=False)
    assert parts.interrupted and parts.records[0]["mean_colour"] is None and parts.records[0]["finished"] is False
    parts = reconstruct(coloured_views, tmp_path / "parts", KEYS, progress=False, resume=True)
    with np.load(found.densities[0]) as a, np.load(parts.densities[0]) as b:
        assert all(np.array_equal(a[name], b[name]) for name in ("density", "Cd"))


def test_what_cells_get_from_pixels_is_the_adjoint_of_what_these_show(cloud):
    cameras = [camera_at(place) for place in places(2, radius_around(cloud.shape))]
    blank = np.zeros((20, 20), np.float32)
    pictures = [Photograph(str(n), camera, blank, blank, None, False) for n, camera in enumerate(cameras)]
    renderer = ColouredRenderer(cloud.shape, 1.0, "exact", 1.0, size=(20, 20))
    views = smoke_colours._ViewGroup(GAMMA * cloud, renderer, pictures)
    random = np.random.default_rng(0)
    c, pixels = (random.random(shape, np.float32) for shape in ((*cloud.shape, 3), (2, 20, 20, 3)))
    assert (views.shown(c) * pixels).sum() == pytest.approx((c * views.spread(pixels)).sum(), rel=1e-4)


def test_the_strength_of_pixels():
    """Smoke of one colour shows in its strongest channel what white smoke would; noise of black stays noise."""
    opacity = np.outer(np.hanning(40), np.hanning(40)).astype(np.float32)
    ones = np.ones((40, 40), np.float32)
    assert np.allclose(strength(opacity[..., None] * np.float32(BLUE), ones), opacity, atol=0.03)
    grey = np.repeat(opacity[..., None], 3, axis=2)
    assert np.allclose(strength(grey, ones), opacity, atol=1e-6)
    noisy = opacity[..., None] * np.float32(BLUE) + np.random.default_rng(1).normal(0, 0.01, (40, 40, 3))
    black = opacity < 1e-3
    assert abs(strength(noisy, ones)[black].mean()) < 1e-3 < noisy.max(-1)[black].mean()
    assert LUMINANCE.sum() == pytest.approx(1)


def test_masked_pixels_change_no_others(cloud):
    """A lamp of any brightness and colour, covered by a mask, in front of a picture and of what is behind the smoke."""
    opacity = np.outer(np.hanning(20), np.hanning(20)).astype(np.float32)
    blue, weights = opacity[..., None] * np.float32(BLUE), np.ones((20, 20), np.float32)
    weights[8:12, :3] = weights[9, 9] = weights[0] = 0
    lit = np.where(weights[..., None] > 0, blue, np.float32((1e4, 3e4, 2e4)))
    counts = weights > 0
    assert np.array_equal(strength(lit, weights)[counts], strength(blue, weights)[counts])
    camera = camera_at(places(1, radius_around(cloud.shape))[0])
    pictures = [
        Photograph("", camera, strength(one, weights), weights, strength(one, weights), False, one, one).averaged(2.5)
        for one in (lit, blue)
    ]
    for name in ("values", "background", "colours", "background_colours"):
        assert np.array_equal(*(getattr(picture, name) for picture in pictures))


def test_three_sides_in_colour():
    """In front of a blue cell, an orange one hides a part of it; from behind it would be the other way round."""
    extinction, colour = np.zeros((2, 1, 1), np.float32), np.zeros((2, 1, 1, 3), np.float32)
    extinction[:, 0, 0], colour[1], colour[0] = 0.7, ORANGE, BLUE
    front = three_sides(extinction, colour)[:, 1]
    once = 1 - np.exp(-0.7)
    assert np.allclose(front[front.max(-1) > 0], once * np.array(ORANGE) + (1 - once) * once * np.array(BLUE))
    white = three_sides(extinction, np.ones_like(colour))
    assert np.allclose(white, three_sides(extinction)[..., None], atol=1e-6)


def test_colours_are_of_emission_and_absorption(views, tmp_path, capsys):
    flags = ["--channel", "rgb", "--integrator", "prbvolpath"]
    assert main(["reconstruct", str(views), "--out", str(tmp_path / "out"), *flags]) == 2
    assert "channel = rgb: is of emission_absorption" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
