"""Whole runs whose smoke takes on the colours of a picture."""

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
from tnst_mi.io import load_frames
from tnst_mi.io.pictures.exr import read_exr
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.recipe.recipe import Recipe

__all__ = ["optimiser"]


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """A small recipe with a picture of two colours, orange and dark blue."""
    folder = tmp_path_factory.mktemp("style")
    random_googlenet(folder / "random.safetensors", narrow=8)
    pixels = np.full((24, 24, 3), (255, 128, 0), np.uint8)
    pixels[::2] = (0, 0, 64)
    Image.fromarray(pixels).save(folder / "stripes.png")
    return {
        **{"style": (str(folder / "stripes.png"),), "style_layers": {"inception_3a/3x3": 1.0}, "colour": "style"},
        **{"octaves": 2, "iterations": 3, "views": 2, "weights": str(folder / "random.safetensors"), "eta": 0.02},
    }


@pytest.mark.parametrize("format", ["npz", "vdb"])
def test_the_colours_of_a_picture_come_with_the_smoke(format: str, keys: dict, tmp_path: Path) -> None:
    recipe = Recipe(**keys, format=format)
    result = tnst_mi.stylize(moving_smoke(2), recipe, tmp_path / "out", progress=False)
    again = load_frames(tmp_path / "out" / "density")
    for frame, grids, record in zip(again, result.grids, result.run["frames"], strict=True):
        colour = frame.grids["Cd"]
        np.testing.assert_array_equal(colour, grids["Cd"])
        assert colour.shape == (*SHAPE, 3) and colour.min() >= 0 and colour.max() <= 1
        assert record["terms_after"]["palette stripes.png"] < 0.8 * record["terms_before"]["palette stripes.png"]
        image = read_exr(tmp_path / "out" / "images" / f"{frame.name}_after.exr")
        shown = record["exposure"] * tnst_mi.render(
            frame.density * np.float32(result.run["density_scale"]),
            result.run["main_view"],
            result.recipe.at(frame.number).extinction,
            result.recipe.quadrature,
            size=image.shape[:2],
            colour=srgb(colour),
        )
        np.testing.assert_allclose(image, shown, rtol=0, atol=1e-5)
        before = read_exr(tmp_path / "out" / "images" / f"{frame.name}_before.exr")
        assert np.ptp(before, axis=-1).max() == 0 and np.ptp(image, axis=-1).max() > 0.1
    assert "Cd" in result.run["carried"]


def test_colours_begin_with_those_of_the_input(keys: dict) -> None:
    rng = np.random.default_rng(0)
    colour = rng.random((*SHAPE, 3)).astype(np.float32)
    frames = [dataclasses.replace(frame, grids={"Cd": colour}) for frame in moving_smoke(1)]
    unmoved = tnst_mi.stylize(frames, Recipe(**keys, strength=0.0), progress=False)
    np.testing.assert_allclose(unmoved.grids[0]["Cd"], colour, atol=1e-6)
    left = tnst_mi.stylize(frames, Recipe(**keys, strength=0.0, carry="velocity"), progress=False)
    assert np.ptp(left.grids[0]["Cd"].reshape(-1, 3), axis=0).max() == 0


@pytest.mark.parametrize(
    "more",
    [{}, {"window_average": "plain"}, {"step_order": "align_first", "window_average": "plain"}, {"coherence": 0.5}],
)
def test_windows_average_colours_to_the_same_bits_each_time(more: dict, keys: dict) -> None:
    recipe = Recipe(**(keys | {"octaves": 1, "window": 3, "iterations": 2} | more))
    first, second = (tnst_mi.stylize(moving_smoke(3), recipe, progress=False) for _ in range(2))
    for one, other in zip(first.grids, second.grids, strict=True):
        np.testing.assert_array_equal(one["Cd"], other["Cd"])
        assert np.ptp(one["Cd"].reshape(-1, 3), axis=0).max() > 0.02


def test_a_run_goes_on_from_the_colours_of_another(keys: dict, tmp_path: Path) -> None:
    recipe = Recipe(**keys, keep_octaves=True)
    whole = tnst_mi.stylize(moving_smoke(1), recipe, tmp_path / "whole", progress=False)
    on = tnst_mi.stylize(
        moving_smoke(1), recipe, tmp_path / "on", progress=False, start_from=tmp_path / "whole" / "octaves" / "1"
    )
    np.testing.assert_array_equal(whole.grids[0]["Cd"], on.grids[0]["Cd"])
    np.testing.assert_array_equal(whole.densities[0], on.densities[0])
    with pytest.raises(InputError, match="its run had colour = 'style', this one has 'off'"):
        grey = Recipe(**(keys | {"colour": "off"}))
        tnst_mi.stylize(moving_smoke(1), grey, tmp_path / "grey", progress=False, start_from=tmp_path / "whole")


def test_a_palette_without_strokes_leaves_the_density_alone(keys: dict) -> None:
    (frame,) = moving_smoke(1)
    result = tnst_mi.stylize([frame], Recipe(**keys, style_weight=0.0), progress=False)
    np.testing.assert_array_equal(result.densities[0], frame.density)
    terms = [result.run["frames"][0][key]["palette stripes.png"] for key in ("terms_before", "terms_after")]
    assert terms[1] < 0.8 * terms[0]


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            {"style": (), "tag": ("spiral",)},
            "takes the colours of a style picture, and there is none; expected --style",
        ),
        ({"integrator": "prbvolpath"}, "colour = 'style' and integrator = 'prbvolpath', which shows grey smoke"),
        ({"style_weight": 0.0, "colour_weight": 0.0}, "nothing of the pictures counts; expected one of them above 0"),
    ],
    ids=["no picture", "path traced", "no weight"],
)
def test_colours_that_cannot_be_taken_are_refused_before_the_work(
    more: dict, message: str, keys: dict, optimiser: FakeOptimiser, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        tnst_mi.stylize(moving_smoke(1), Recipe(**(keys | more)), tmp_path / "out", progress=False)
    assert optimiser.calls == [] and not (tmp_path / "out").exists()
