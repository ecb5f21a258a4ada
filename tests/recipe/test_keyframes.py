"""Keyframed recipes: values between keys, fading pictures, files that survive, flags that win, and every refusal."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from tnst_mi.errors import InputError
from tnst_mi.recipe.flag_values import value_of_flag
from tnst_mi.recipe.keyframes import KEYABLE, converted, value_at
from tnst_mi.recipe.paths import STYLES
from tnst_mi.recipe.recipe import KINDS, Recipe, documentation

KEYED: dict[str, Any] = {
    "style": {49: "spirals", 60: ["net"], 72: ["net", "cells"]},
    "style_weight": {0: 1, 999_999_999: 0},
    "semantic_weight": {50: 0.1, 51: 0.3},
    "lam": {72: 0.0, 49: 1.0},
    "gamma": {49: 0.1, 72: 1.0},
    "azimuth": {49: [-10, 10], 72: [30, 50]},
    "elevation": {49: [0, 0]},
    "eta": {49: 0.002, 60: 0.004, 61: 0.001},
    "strength": {49: 0, 55: 1},
    "blend": {49: 1, 72: 0.25},
}


def write(folder: Path, text: str) -> Path:
    path = folder / "r.toml"
    path.write_text(text, "utf-8")
    return path


def names(pictures: tuple[str, ...]) -> list[str]:
    return [Path(picture).stem for picture in pictures]


# --- Values -----------------------------------------------------------------------------------------------


def test_values_are_linear_between_keys_and_constant_outside() -> None:
    recipe = Recipe.from_dict(KEYED)
    assert recipe.keyframes["gamma"] == ((49, 0.1), (72, 1.0))
    assert recipe.keyframes["lam"] == ((49, 1.0), (72, 0.0)), "keys are sorted by frame"
    assert (recipe.gamma, recipe.lam, recipe.azimuth) == (0.1, 1.0, (-10.0, 10.0)), "attributes hold the first key's"
    for number in (0, 48, 49, 50, 55, 60, 61, 71, 72, 73, 10**9):
        at = recipe.at(number)
        assert at.keyframes == {}
        for name in ("style_weight", "semantic_weight", "lam", "gamma", "eta", "strength", "blend"):
            frames, values = zip(*recipe.keyframes[name], strict=True)
            assert getattr(at, name) == pytest.approx(np.interp(number, frames, values), rel=1e-12, abs=1e-15), name
    assert recipe.at(49).gamma == 0.1 and recipe.at(72).gamma == 1.0, "exact at the keys"
    assert (recipe.at(7).elevation, recipe.at(70).elevation) == ((0.0, 0.0), (0.0, 0.0))


def test_the_camera_moves_along_its_path() -> None:
    recipe = Recipe.from_dict({"azimuth": {10: [-10, 10], 20: [30, 50]}, "elevation": {10: [0, 2], 20: [0, 12]}})
    assert [recipe.at(number).main_view for number in (9, 10, 15, 20, 21)] == [
        (0.0, 1.0),
        (0.0, 1.0),
        (20.0, 3.5),
        (40.0, 6.0),
        (40.0, 6.0),
    ]
    assert recipe.at(15).azimuth == (10.0, 30.0)


@settings(max_examples=100)
@given(st.lists(st.floats(-360, 360), min_size=4, max_size=4), st.integers(0, 1000), st.integers(1, 1000))
def test_no_rounding_leaves_the_range(values: list[float], number: int, last: int) -> None:
    first, second = tuple(sorted(values[:2])), tuple(sorted(values[2:]))
    keys = ((0, first), (last, second))
    low, high = value_at(keys, number)
    assert low <= high
    assert min(first[0], second[0]) <= low <= max(first[0], second[0])
    assert value_at(((0, first), (last, first)), number) == first


def test_an_unkeyed_recipe_is_its_own() -> None:
    recipe = Recipe.from_dict({"style": ["net", "cells"]})
    assert recipe.at(3) is recipe and recipe.at(None) is recipe
    assert (recipe.keyframes, recipe.style_shares) == ({}, (1.0, 1.0))
    assert Recipe().style_shares == ()


def test_a_frame_number_of_numpy_is_one_too() -> None:
    recipe = Recipe.from_dict(KEYED)
    assert recipe.at(np.int64(55)) == recipe.at(55)


# --- Pictures ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "shares"),
    [(0, (1, 0)), (50, (1, 0)), (52, (0.8, 0.2)), (55, (0.5, 0.5)), (60, (0, 1)), (99, (0, 1))],
)
def test_one_picture_fades_into_another(number: int, shares: tuple[float, ...]) -> None:
    recipe = Recipe.from_dict({"style": {60: "net", 50: "spirals"}})
    assert names(recipe.style) == ["spirals", "net"]
    assert recipe.at(number).style == recipe.style
    assert recipe.at(number).style_shares == shares


@pytest.mark.parametrize(
    ("number", "shares"),
    [(49, (1, 0, 0)), (60, (0, 1, 0)), (63, (0, 1, 0.25)), (66, (0, 1, 0.5)), (72, (0, 1, 1))],
)
def test_a_picture_of_both_keys_stays(number: int, shares: tuple[float, ...]) -> None:
    recipe = Recipe.from_dict(KEYED)
    assert names(recipe.style) == ["spirals", "net", "cells"]
    assert recipe.at(number).style_shares == shares


def test_a_picture_fades_in_from_none_and_counts_twice_where_named_twice() -> None:
    recipe = Recipe.from_dict({"style": {0: [], 4: ["net", "net"]}})
    assert names(recipe.style) == ["net"]
    assert [recipe.at(number).style_shares for number in (0, 1, 4)] == [(0.0,), (0.5,), (2.0,)]


def test_shares_stay_with_their_pictures() -> None:
    at = Recipe.from_dict({"style": {0: "net", 4: "cells"}}).at(1)
    assert at.updated({"gamma": 0.5}, "", Path.cwd()).style_shares == (0.75, 0.25)
    assert at.located(Path.cwd()) == at
    assert at.updated({"style": ["net", "cells"]}, "", Path.cwd()).style_shares == (1.0, 1.0)
    assert dataclasses.replace(Recipe(style=("net",)), style=("net", "cells")).style_shares == (1.0, 1.0)
    with pytest.raises(InputError, match="expected a number for each of the 1 pictures"):
        dataclasses.replace(at, style=("net",))


def test_pictures_of_keys_are_looked_for_beside_the_recipe(tmp_path: Path) -> None:
    Image.new("L", (4, 4)).save(tmp_path / "mine.png")
    recipe = Recipe.from_toml(write(tmp_path, 'style = {49 = "mine.png", 72 = ["spirals"]}'))
    mine = str((tmp_path / "mine.png").resolve())
    assert recipe.style == (mine, str(STYLES / "spirals.png"))
    assert recipe.keyframes["style"] == ((49, (mine,)), (72, (str(STYLES / "spirals.png"),)))
    assert tomllib.loads(recipe.to_toml())["style"] == {"49": [mine], "72": ["spirals"]}
    relative = Recipe(keyframes={"style": {49: "mine.png", 72: "spirals"}})
    assert relative.style == ("mine.png", "spirals")
    assert relative.located(tmp_path) == recipe


# --- Files, dicts and flags -------------------------------------------------------------------------------


def test_a_keyframed_recipe_survives_toml(tmp_path: Path) -> None:
    recipe = Recipe.from_dict(KEYED)
    assert set(recipe.keyframes) == set(KEYED) == set(KEYABLE)
    text = recipe.to_toml()
    assert "gamma = {49 = 0.1, 72 = 1.0}\n" in text
    assert "azimuth = {49 = [-10.0, 10.0], 72 = [30.0, 50.0]}\n" in text
    again = Recipe.from_toml(write(tmp_path, text))
    assert again == recipe
    assert again.at(55) == recipe.at(55)


def test_a_table_is_a_section_or_a_dict_too(tmp_path: Path) -> None:
    recipe = Recipe.from_dict({"gamma": {49: 0.1, 72: 1.0}})
    assert Recipe.from_toml(write(tmp_path, "[gamma]\n72 = 1\n0049 = 0.1\n")) == recipe
    assert Recipe.from_dict({"gamma": {"72": 1, "49": 0.1}}) == recipe
    assert Recipe(keyframes={"gamma": ((72, 1), (49, 0.1))}) == recipe
    assert recipe != Recipe(gamma=0.1), "equality sees keyframes"


def test_the_last_one_given_wins() -> None:
    recipe = Recipe.from_dict(KEYED)
    flagged = recipe.updated_by_flags({"gamma": "0.7", "style": ("flames",)})
    assert flagged.gamma == flagged.at(72).gamma == 0.7
    assert names(flagged.style) == ["flames"] and flagged.at(50).style_shares == (1.0,)
    assert set(flagged.keyframes) == set(KEYED) - {"gamma", "style"}
    assert flagged.keyframes["lam"] == recipe.keyframes["lam"]
    keyed = recipe.updated({"gamma": {1: 2.0}}, "", Path.cwd())
    assert keyed.keyframes["gamma"] == ((1, 2.0),) and keyed.gamma == 2.0


def test_help_names_the_keys_that_can_be_keyframed() -> None:
    assert not {"keyframes", "style_shares"} & (set(KINDS) | set(documentation()))
    text = {line.partition(" = ")[0]: block for block in Recipe().to_toml().split("\n\n") for line in block.split("\n")}
    for name in KINDS:
        assert ("Keyframes: " in text.get(name, "").replace("\n# ", " ")) == (name in KEYABLE), name


@pytest.mark.parametrize("name", KEYABLE)
def test_the_example_of_keyframes_of_every_key_is_one(name: str) -> None:
    table = value_of_flag(name, KEYABLE[name])
    assert table == tomllib.loads(f"{name} = {KEYABLE[name]}")[name]
    assert list(converted(name, table, "", lambda key, value, _: KINDS[key].check(value))) == [49, 72]


# --- Refusals ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gamma = {49 = 0.1, 72 = 0}", "r.toml: frame 72: gamma = 0: expected a number above 0"),
        ("azimuth = {49 = [10, -10]}", r"r.toml: frame 49: azimuth = \[10, -10\]: expected two numbers"),
        ("azimuth = {49 = 10}", "r.toml: frame 49: azimuth = 10: expected two numbers"),
        ("style = {49 = 3}", "r.toml: frame 49: style = 3: expected a list of picture files"),
        ('style = {49 = "nowhere.png"}', "r.toml: frame 49: style = 'nowhere.png': no such picture"),
        ("gamma = {4.5 = 0.1}", r"r.toml: frame 4: gamma = \{'5': 0.1\}: expected a number above 0"),
        ("gamma = {}", "r.toml: gamma = {}: expected at least one frame number with a value"),
        ("gamma = {+1 = 0.1}", "not valid TOML"),
        ("gamma = {--1 = 0.1}", "r.toml: gamma: '--1' is no frame number, expected a whole number of up to 9 digits"),
        ("gamma = {first = 0.1}", "r.toml: gamma: 'first' is no frame number"),
        (
            'gamma = {1 = 0.1, 2 = "auto"}',
            "r.toml: gamma: auto is one value for all frames, expected numbers in a table",
        ),
        ("gamma = {1000000000 = 0.1}", "r.toml: gamma: '1000000000' is no frame number"),
        ("gamma = {49 = 0.1, 049 = 0.2}", "r.toml: gamma: frame 49 is there twice"),
        (
            "octaves = {49 = 1, 72 = 2}",
            r"r.toml: octaves = \{'49': 1, '72': 2\}: cannot be keyframed; the keys that can are style, style_weight, "
            "semantic_weight, lam, gamma, azimuth, elevation, eta, strength, blend$",
        ),
        ('content = {49 = ["net"]}', "r.toml: content = .*: cannot be keyframed; the keys that can are style,"),
        ('style_layers = {49 = ["conv2/3x3"]}', "r.toml: style_layers = .*: cannot be keyframed"),
        ('style_layers = {49 = 1, "conv2/3x3" = -1}', "r.toml: style_layers = .*: expected layers with weights"),
    ],
)
def test_a_bad_table_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        Recipe.from_toml(write(tmp_path, text))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 5000])
def test_a_table_of_a_flag_that_python_does_not_read_is_named(value: str) -> None:
    with pytest.raises(InputError, match=r"^--gamma \{1: .*: expected a value for each frame, such as"):
        Recipe().updated_by_flags({"gamma": f"{{1: {value}}}"})


@pytest.mark.parametrize("key", [True, 4.0, -(10**9), 10**9, 10**400, None, "٤"])
def test_bad_keys_of_a_dict(key: Any) -> None:
    with pytest.raises(InputError, match=r"recipe: gamma: .* is no frame number"):
        Recipe.from_dict({"gamma": {key: 1.0}})


def test_keyframes_of_unknown_keys() -> None:
    with pytest.raises(InputError, match=r"recipe: nothing = .*: cannot be keyframed"):
        Recipe(keyframes={"nothing": {1: 2}})


def test_frames_without_numbers_cannot_be_keyframed() -> None:
    recipe = Recipe.from_dict({"gamma": {49: 0.1}, "lam": {49: 1}})
    with pytest.raises(InputError, match="recipe: lam, gamma: frames without numbers cannot be keyframed; number"):
        recipe.at(None)
