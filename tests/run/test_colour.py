"""Whole runs that keep the colour of their smoke: previews in colour, and the colours in the results."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from jobs import FakeOptimiser, optimiser
from moving_smoke import SHAPE, moving_smoke
from networks import random_googlenet
from PIL import Image

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, save_frames
from tnst_mi.io.pictures.exr import read_exr
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.notebook.main_views import shown_results
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.fire import glow_colours
from tnst_mi.rendering.smoke_colour import colour_name, colours_of
from tnst_mi.run.colour import shown_temperature
from tnst_mi.run.measure import measured
from tnst_mi.run.prepare import prepare

__all__ = ["optimiser"]

GOAL = {"semantic": ("inception_3a/3x3:2",), "octaves": 1, "iterations": 2, "views": 2, "eta": 0.02}


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    random_googlenet(path, narrow=8)
    return str(path)


def coloured(count: int, **grids: np.ndarray) -> list[Frame]:
    """Smoke that is red on the left and turns blue to the right, with some green."""
    right = np.broadcast_to(np.linspace(0, 1, SHAPE[2], dtype=np.float32), SHAPE)
    colour = np.stack([1 - right, np.full(SHAPE, 0.25, np.float32), right], axis=-1)
    return [dataclasses.replace(frame, grids={"Cd": colour} | grids) for frame in moving_smoke(count)]


def pictures(out: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """The main views of a frame before and after."""
    before, after = (read_exr(out / "images" / f"{name}_{state}.exr") for state in ("before", "after"))
    return before, after


@pytest.mark.parametrize("format", ["npz", "vdb"])
def test_previews_show_the_colours_that_come_back(format: str, weights: str, tmp_path: Path) -> None:
    save_frames(tmp_path / "in", coloured(2), format)
    recipe = Recipe(**GOAL, weights=weights, colour="keep")
    result = tnst_mi.stylize(tmp_path / "in", recipe, tmp_path / "out", progress=False)
    again = load_frames(tmp_path / "out" / "density")
    factor = result.run["density_scale"]
    for index, frame in enumerate(load_frames(tmp_path / "in")):
        found = again[index]
        np.testing.assert_array_equal(found.grids["Cd"], result.grids[index]["Cd"])
        assert (found.grids["Cd"] != frame.grids["Cd"]).mean() > 0.2, "the colours have moved"
        exposure = result.run["frames"][index]["exposure"]
        recipe_used = result.recipe.at(frame.number)
        for image, smoke in zip(pictures(tmp_path / "out", frame.name), (frame, found), strict=True):
            expected = exposure * tnst_mi.render(
                smoke.density * np.float32(factor),
                result.run["main_view"],
                recipe_used.extinction,
                recipe_used.quadrature,
                size=image.shape[:2],
                # Display values, as the pictures have no curve.
                colour=srgb(smoke.grids["Cd"]),
            )
            np.testing.assert_allclose(image, expected, rtol=0, atol=1e-5)
        left, right = np.array_split(pictures(tmp_path / "out", frame.name)[1], 2, axis=1)
        assert left[..., 0].sum() > left[..., 2].sum() and right[..., 2].sum() > right[..., 0].sum()
    images = tmp_path / "out" / "images"
    for picture in ("s_005_after.png", "s_005_comparison.png", "contact_sheet.png"):
        pixels = np.asarray(Image.open(images / picture).convert("RGB"), int)
        assert np.ptp(pixels, axis=-1).max() > 60, picture


def test_only_the_pictures_differ_from_those_of_a_grey_run(weights: str, tmp_path: Path) -> None:
    """White smoke is grey to the bit, and densities do not depend on the colour."""
    white = np.ones((*SHAPE, 3), np.float32)
    runs = {}
    for colour in ("off", "keep"):
        recipe = Recipe(**GOAL, weights=weights, colour=colour)
        runs[colour] = tnst_mi.stylize(coloured(1, Cd=white), recipe, tmp_path / colour, progress=False)
    np.testing.assert_array_equal(runs["off"].densities[0], runs["keep"].densities[0])
    for grey, shown in zip(pictures(tmp_path / "off", "s_005"), pictures(tmp_path / "keep", "s_005"), strict=True):
        assert grey.ndim == 2 and shown.shape == (*grey.shape, 3)
    grey, shown = pictures(tmp_path / "off", "s_005")[0], pictures(tmp_path / "keep", "s_005")[0]
    np.testing.assert_array_equal(shown, np.stack([grey] * 3, -1))


def test_a_notebook_shows_a_result_in_memory_in_the_same_colours(weights: str, tmp_path: Path) -> None:
    recipe = Recipe(**GOAL, weights=weights, colour="keep")
    stored = tnst_mi.stylize(coloured(1), recipe, tmp_path / "out", progress=False)
    given = tnst_mi.stylize(coloured(1), recipe, progress=False)
    for one, other in zip(shown_results(stored, [0]), shown_results(given, [0]), strict=True):
        for picture, same in zip(one.pictures, other.pictures, strict=True):
            np.testing.assert_allclose(picture, same, rtol=0, atol=1e-6)


def test_temperatures_are_shown_in_the_colours_of_black_bodies(weights: str, tmp_path: Path) -> None:
    """Without a unit, the hottest of all frames says what they mean; in memory and in a notebook it is the same."""
    up = np.broadcast_to(np.linspace(0, 1, SHAPE[1], dtype=np.float32)[:, None], SHAPE)
    frames = [dataclasses.replace(f, grids={"heat": (2 + i) * up}) for i, f in enumerate(moving_smoke(2))]
    recipe = Recipe(**GOAL, weights=weights, colour="keep")
    result = tnst_mi.stylize(frames, recipe, tmp_path / "out", progress=False)
    assert result.run["temperature"] == ["heat", 3.0]
    assert any("heat as a temperature, up to 3, taken as 2200 K" in line for line in prepare(frames, recipe).reading)
    before, after = (frames[0].density, frames[0].grids), (result.densities[1], result.grids[1])
    for index, (density, grids) in enumerate((before, after)):
        image = pictures(tmp_path / "out", frames[index].name)[index]
        expected = result.run["frames"][index]["exposure"] * tnst_mi.render(
            density * np.float32(result.run["density_scale"]),
            result.run["main_view"],
            result.recipe.at(frames[index].number).extinction,
            result.recipe.quadrature,
            size=image.shape[:2],
            colour=srgb(glow_colours(grids["heat"], 3.0)),
        )
        np.testing.assert_allclose(image, expected, rtol=0, atol=1e-5)
        assert image[..., 0].max() > 2 * image[..., 2].max()
    given = tnst_mi.stylize(frames, recipe, progress=False)
    for one, other in zip(shown_results(result, [0])[0].pictures, shown_results(given, [0])[0].pictures, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-6)


def test_colours_come_before_temperatures() -> None:
    """In the frames that lack them too."""
    cold, warm = moving_smoke(2)
    frames = [
        dataclasses.replace(cold, grids={"heat": cold.density + 1}),
        dataclasses.replace(warm, grids={"Cd": np.ones((*SHAPE, 3), np.float32)}),
    ]
    recipe = Recipe(colour="keep")
    assert shown_temperature(recipe, measured(frames, "all")[0]) is None
    assert shown_temperature(recipe, measured(frames[:1], "all")[0]) == ("heat", float(cold.density.max()) + 1)
    assert shown_temperature(Recipe(), measured(frames[:1], "all")[0]) is None


@pytest.mark.parametrize(
    ("grids", "keys", "message"),
    [
        ({}, {}, "no grid of colours, .* nor of temperatures above 0 .*, those beside the density are: 'fuel'"),
        ({"heat": -np.ones(SHAPE, np.float32)}, {}, "no grid of colours, .* nor of temperatures above 0"),
        ({"heat": np.ones(SHAPE, np.float32)}, {"carry": "fuel"}, "nor of temperatures above 0 moves with the smoke"),
        ({"Cd": np.ones((*SHAPE, 3), np.float32)}, {"carry": "fuel"}, "'Cd' is left out by carry; add it there"),
        ({"Cd": np.ones(SHAPE, np.float32)}, {}, "s_005: grid 'Cd' has shape .*, expected colours"),
        ({"Cd": np.ones((*SHAPE, 3), np.float32)}, {"integrator": "prbvolpath"}, "which shows grey smoke; expected"),
    ],
    ids=["no colour", "cold", "left behind temperature", "left behind", "scalar", "path traced"],
)
def test_colours_that_cannot_be_kept_are_refused_before_the_work(
    grids: dict, keys: dict, message: str, optimiser: FakeOptimiser, tmp_path: Path
) -> None:
    frames = [dataclasses.replace(f, grids=grids | {"fuel": f.density}) for f in moving_smoke(2)]
    recipe = Recipe(style=("spirals",), colour="keep", **keys)
    with pytest.raises(InputError, match=message):
        tnst_mi.stylize(frames, recipe, tmp_path / "out", progress=False)
    assert optimiser.calls == [] and not (tmp_path / "out").exists()


def test_which_grid_is_the_colour() -> None:
    assert colour_name(["albedo", "color", "heat", "Cd"]) == "Cd"
    assert colour_name(["heat", "smoke_tint", "rgb"]) == "smoke_tint"
    assert colour_name(["heat", "emission_color", "velocity"]) is None


def test_bytes_are_parts_of_the_largest() -> None:
    """1/3 and 1 of 255."""
    values = np.full((2, 2, 2, 3), 85, np.uint8)
    values[0] = 255
    found = colours_of({"Cd": values}, "Cd", "a")
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[:, 0, 0, 0], [1, 1 / 3], rtol=1e-6)


def test_other_whole_numbers_are_no_colours() -> None:
    for kind in (np.int32, np.uint32, bool):
        with pytest.raises(InputError, match=r"a: grid 'Cd' has colours of .*, expected floating-point numbers"):
            colours_of({"Cd": np.ones((2, 2, 2, 3), kind)}, "Cd", "a")
