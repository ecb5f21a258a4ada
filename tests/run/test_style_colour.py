"""Whole runs whose smoke takes on the colours of a picture."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jobs import FakeOptimiser, optimiser
from moving_smoke import SHAPE, moving_smoke
from networks import random_googlenet
from PIL import Image

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames
from tnst_mi.io.pictures.exr import read_exr
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.optimisation.colouring import COLOUR
from tnst_mi.optimisation.gradient import Evaluation, OctaveProblem
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import FramePlan
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
    assert {tuple(entry["terms"]) for entry in result.history[0]} == {("palette stripes.png",)}
    terms = [result.run["frames"][0][key]["palette stripes.png"] for key in ("terms_before", "terms_after")]
    assert terms[1] < 0.8 * terms[0]


def picture_of(folder: Path, name: str, pixels: np.ndarray) -> str:
    Image.fromarray(pixels.astype(np.uint8)).save(folder / name)
    return str(folder / name)


@pytest.mark.parametrize("loss", ["gram", "swd"])
def test_a_black_picture_has_no_palette(loss: str, keys: dict, tmp_path: Path) -> None:
    """Also beside others, in a target, with an alpha, and where what is not black is cut off."""
    black = np.zeros((24, 24, 4))
    black[..., 3] = 255
    hidden = black.copy()
    hidden[:8] = 0
    wide = np.zeros((24, 72, 3))
    wide[:, :8] = 255
    files = [picture_of(tmp_path, f"{i}.png", pixels) for i, pixels in enumerate((black, hidden, wide))]
    message = "black all over where it is used .*, which is no palette; use a picture with a colour there, or colour"
    for style in ((files[0],), (keys["style"][0], files[0]), (files[1],), (files[2],)):
        for weight in (0.0, 1.0):
            recipe = Recipe(**(keys | {"style": style}), style_weight=weight, style_loss=loss)
            with pytest.raises(InputError, match=message):
                tnst_mi.stylize(moving_smoke(1), recipe, tmp_path / "out", progress=False)
    target = Recipe.from_dict({**keys, "style": [], "target": [{"style": files[0]}]})
    with pytest.raises(InputError, match=message):
        tnst_mi.stylize(moving_smoke(1), target, tmp_path / "out", progress=False)
    assert not (tmp_path / "out").exists()


def test_a_palette_of_one_colour_is_reached(keys: dict, tmp_path: Path) -> None:
    flat = picture_of(tmp_path, "flat.png", np.broadcast_to((40, 90, 160), (24, 24, 3)))
    recipe = Recipe(**(keys | {"style": (flat,)}), style_loss="swd")
    (record,) = tnst_mi.stylize(moving_smoke(1), recipe, progress=False).run["frames"]
    assert np.isfinite(record["loss_after"]) and record["terms_after"]["palette flat.png"] < 0.5


def test_targets_may_give_their_palettes_without_strokes(keys: dict) -> None:
    (frame,) = moving_smoke(1)
    targets = {"style": [], "target": [{"style": keys["style"][0]}], "style_weight": 0.0}
    result = tnst_mi.stylize([frame], Recipe.from_dict({**keys, **targets}), progress=False)
    np.testing.assert_array_equal(result.densities[0], frame.density)
    terms = [result.run["frames"][0][key]["palette stripes.png"] for key in ("terms_before", "terms_after")]
    assert terms[1] < 0.8 * terms[0]
    assert not any("style_weight" in note for note in result.run.get("notes", []))
    with pytest.raises(InputError, match="style_weight = 0 and colour_weight = 0: nothing of the targets"):
        tnst_mi.stylize([frame], Recipe.from_dict({**keys, **targets, "colour_weight": 0.0}), progress=False)


def test_only_colours_of_the_input_are_said_to_be_carried(
    keys: dict, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (frame,), recipe = moving_smoke(1), Recipe(**(keys | {"octaves": 1, "iterations": 1}))
    for name, given, expected in (("white", frame, False), ("own", coloured(frame), True)):
        tnst_mi.stylize([given], recipe, tmp_path / name, progress=True)
        said = capsys.readouterr().err
        assert "colours of the smoke: written as grid Cd" in said
        (carried,) = re.findall("carried with the smoke: (.*) \\(", said)
        assert ("Cd" in carried) == expected


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            {"style": (), "tag": ("spiral",)},
            "takes the colours of a style picture, and there is none; expected --style",
        ),
        ({"integrator": "prbvolpath"}, "colour = 'style' and integrator = 'prbvolpath', which shows grey smoke"),
        (
            {"style_weight": 0.0, "colour_weight": 0.0},
            "style_weight = 0 and colour_weight = 0: nothing of the goals counts",
        ),
    ],
    ids=["no picture", "path traced", "no weight"],
)
def test_colours_that_cannot_be_taken_are_refused_before_the_work(
    more: dict, message: str, keys: dict, optimiser: FakeOptimiser, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        tnst_mi.stylize(moving_smoke(1), Recipe(**(keys | more)), tmp_path / "out", progress=False)
    assert optimiser.calls == [] and not (tmp_path / "out").exists()


def test_smoke_takes_its_own_colour_along(keys: dict) -> None:
    (frame,) = moving_smoke(1)
    given = coloured(frame)
    result = tnst_mi.stylize(
        [given], Recipe(**(keys | {"eta": 0.05, "iterations": 6}), colour_eta=1e-6), progress=False
    )
    found, before = srgb(result.grids[0]["Cd"]), srgb(given.grids["Cd"])
    assert (np.abs(found - before).max(-1) > 0.05).mean() > 0.05
    for channel in range(3):
        own = np.ascontiguousarray(before[..., channel])
        moved = tnst_mi.advect(own, result.velocities[0], outside="edge", trace="flow")
        np.testing.assert_allclose(found[..., channel], np.clip(moved, 0, 1), atol=1e-3)


def test_frames_without_smoke_do_not_weaken_the_colours_of_their_neighbours(keys: dict) -> None:
    empty, smoke, behind = moving_smoke(3)
    nothing = np.zeros(SHAPE, np.float32)
    frames = [dataclasses.replace(empty, density=nothing), smoke, dataclasses.replace(behind, density=nothing)]
    changes = {}
    for window in (1, 3):
        recipe = Recipe(**(keys | {"octaves": 1, "window": window, "style_weight": 0.0}))
        colour = srgb(tnst_mi.stylize(frames, recipe, progress=False).grids[1]["Cd"])
        mean = np.array([127.5, 64, 32]) / 255
        changes[window] = np.abs(colour - mean)[smoke.density > 0.5 * smoke.density.max()].mean()
    assert changes[3] == pytest.approx(changes[1], rel=0.1)


def test_frames_may_call_their_colours_differently(keys: dict) -> None:
    first, second = moving_smoke(2)
    colour = np.full((*SHAPE, 3), 0.25, np.float32)
    frames = [
        dataclasses.replace(first, grids={"Cd": colour}),
        dataclasses.replace(second, grids={"color": 2 * colour}),
    ]
    result = tnst_mi.stylize(frames, Recipe(**keys, strength=0.0), progress=False)
    assert [sorted(grids) for grids in result.grids] == [["Cd", "velocity"], ["Cd", "velocity"]]
    np.testing.assert_allclose(result.grids[1]["Cd"], 2 * colour, atol=1e-6)


def test_a_frame_whose_colours_are_no_colours_is_refused_before_the_work(
    keys: dict, optimiser: FakeOptimiser, tmp_path: Path
) -> None:
    first, second = moving_smoke(2)
    remedy = "; leave it out with --carry NAMES, or take colour = 'off'"
    for values, problem in (
        (np.ones(SHAPE, np.float32), "has shape .*, expected colours"),
        (np.full((*SHAPE, 3), 200, np.int32), "has colours of int32, expected floating-point numbers"),
    ):
        frames = [
            dataclasses.replace(first, grids={"Cd": np.ones((*SHAPE, 3), np.float32)}),
            dataclasses.replace(second, grids={"Cd": values}),
        ]
        for colour in ("style", "keep"):
            with pytest.raises(InputError, match=f"{second.name}: grid 'Cd' {problem}.*{remedy}"):
                tnst_mi.stylize(frames, Recipe(**(keys | {"colour": colour})), tmp_path / "out", progress=False)
    assert optimiser.calls == [] and not (tmp_path / "out").exists()


def test_smoke_outside_a_mask_stays_white_and_a_palette_may_be_of_one_colour(keys: dict, tmp_path: Path) -> None:
    Image.fromarray(np.full((8, 8, 3), (255, 0, 0), np.uint8)).save(tmp_path / "red.png")
    np.savez(tmp_path / "mask.npz", density=np.where(np.arange(SHAPE[2]) < SHAPE[2] // 2, 1, 0) * np.ones(SHAPE))
    recipe = Recipe(
        **(keys | {"style": (str(tmp_path / "red.png"),)}), style_weight=0.0, mask=str(tmp_path / "mask.npz")
    )
    colour = tnst_mi.stylize(moving_smoke(1), recipe, progress=False).grids[0]["Cd"]
    np.testing.assert_array_equal(colour[..., SHAPE[2] // 2 + 3 :, :], 1)
    np.testing.assert_allclose(colour[..., :2, :], np.broadcast_to([1, 0, 0], colour[..., :2, :].shape), atol=0.05)


def test_the_strokes_of_a_grey_picture_make_nothing_colourful(keys: dict, tmp_path: Path) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (24, 24), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "grey.png")
    recipe = Recipe(**(keys | {"style": (str(tmp_path / "grey.png"),)}), colour_weight=0.0)
    colour = tnst_mi.stylize(moving_smoke(1), recipe, progress=False).grids[0]["Cd"]
    assert np.ptp(colour, axis=-1).max() < 1e-5 < 0.01 < np.ptp(colour[..., 0])


def coloured(frame: Frame) -> Frame:
    """The frame with a grid of colours, which differ in the two halves of it."""
    right = np.broadcast_to((np.arange(SHAPE[2]) >= SHAPE[2] // 2)[:, None], (*SHAPE, 3))
    return dataclasses.replace(frame, grids={"Cd": np.where(right, np.float32([0.8, 0.4, 0.1]), np.float32(0.05))})


def test_a_frame_without_colours_is_what_it_is_beside_one_that_has_some(keys: dict) -> None:
    """Scales of the loss are those of the whole sequence: here there are none."""
    (first, second), recipe = moving_smoke(2), Recipe(**keys, loss_scaling="none")
    beside = tnst_mi.stylize([first, coloured(second)], recipe, progress=False)
    alone = tnst_mi.stylize([first, second], recipe, progress=False)
    np.testing.assert_array_equal(beside.densities[0], alone.densities[0])
    np.testing.assert_array_equal(beside.grids[0]["Cd"], alone.grids[0]["Cd"])
    assert (beside.grids[1]["Cd"] != alone.grids[1]["Cd"]).any()


@pytest.mark.parametrize("own", [False, True], ids=["white", "own colours"])
def test_a_result_that_is_the_input_has_its_loss(own: bool, keys: dict) -> None:
    (frame,) = moving_smoke(1)
    given = coloured(frame) if own else frame
    (record,) = tnst_mi.stylize([given], Recipe(**keys, strength=0.0), progress=False).run["frames"]
    assert record["loss_after"] == record["loss_before"] and record["terms_after"] == record["terms_before"]


def test_strength_and_blend_both_lie_between_white_and_the_colours_found(keys: dict) -> None:
    """Without steps of colours, a result is white but for strength · blend of the picture's mean."""
    recipe = Recipe(**keys, strength=0.5, blend=0.4, colour_eta=1e-7)
    colour = srgb(tnst_mi.stylize(moving_smoke(1), recipe, progress=False).grids[0]["Cd"])
    expected = 1 + 0.2 * (np.array([127.5, 64, 32]) / 255 - 1)
    np.testing.assert_allclose(colour, np.broadcast_to(expected, colour.shape), atol=1e-3)


def test_colours_of_an_octave_that_are_some_stay_so(keys: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    """Long steps end where display values do, in every iteration of an octave."""
    seen = []
    gradient = OctaveProblem.gradient

    def watched(problem: OctaveProblem, frame: FramePlan, fields: Fields, *rest: Any) -> Evaluation:
        seen.append(np.array([127.5, 64, 32]) / 255 + fields[COLOUR].numpy())
        return gradient(problem, frame, fields, *rest)

    monkeypatch.setattr(OctaveProblem, "gradient", watched)
    recipe = Recipe(**(keys | {"octaves": 1, "iterations": 6}), colour_eta=1.0, colour_smoothness=0.0)
    tnst_mi.stylize(moving_smoke(1), recipe, progress=False)
    assert len(seen) == 6
    for colours in seen:
        assert colours.min() > -1e-3 and colours.max() < 1 + 1e-3
    assert (np.minimum(seen[-1], 1 - seen[-1]) < 1e-3).any()


def test_the_record_tells_how_near_colours_are_and_how_they_flicker(keys: dict, tmp_path: Path) -> None:
    """As computed from the files: the flicker of (c − start) d*, where smoke begins with the mean of the picture."""
    recipe = Recipe(**(keys | {"octaves": 1, "window": 3}))
    given = tnst_mi.stylize(moving_smoke(3), recipe, progress=False)
    stored = tnst_mi.stylize(moving_smoke(3), recipe, tmp_path / "out", progress=False)
    for record in stored.run["frames"]:
        (found,) = record["palette_distances"].values()
        assert 0 < found["after"] < found["before"] < 1
    sequence = stored.run["sequence"]
    assert sequence["colour_flicker"] == pytest.approx(given.run["sequence"]["colour_flicker"], rel=1e-4)
    mean, light = np.array([127.5, 64, 32], np.float32) / 255, []
    for frame, grids in zip(load_frames(tmp_path / "out" / "density"), stored.grids, strict=True):
        light.append((srgb(grids["Cd"]) - mean) * frame.density[..., None])
    pairs = []
    for source, one, following in zip(moving_smoke(3), light, light[1:], strict=False):
        moved = [
            tnst_mi.advect(np.ascontiguousarray(one[..., i]), source.velocity, "semi_lagrangian", outside="edge")
            for i in range(3)
        ]
        pairs.append(np.linalg.norm(np.stack(moved, -1) - following) / np.linalg.norm(following))
    assert sequence["colour_flicker"] == pytest.approx(np.mean(pairs), rel=0.02)
    assert len(sequence["colour_flicker_pairs"]) == 2
