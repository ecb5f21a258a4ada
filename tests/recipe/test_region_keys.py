"""Masks and targets in recipes: their tables in TOML, their files, and what is wrong with them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tnst_mi.errors import InputError
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.targets import mask_files, targets_of
from tnst_mi.recipe.unused import unused_keys

SPHERE = {"shape": "sphere", "centre": [0, 1, 0], "radius": 1}


def test_targets_in_toml_and_files_beside_the_recipe(tmp_path: Path) -> None:
    """[[target]] tables, written back inline, mean the same wherever the recipe lies."""
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "paint.png")
    np.savez(tmp_path / "m.npz", density=np.ones((2, 2, 2)))
    text = """
        gamma = {5 = 0.1, 9 = 0.2}
        style_layers = ["conv2/3x3"]
        [[target]]
        style = {5 = "net", 9 = ["spirals", "flames"]}
        weight = {5 = 0, 9 = 2}
        mask = { shape = "sphere", centre = {5 = [0, 0, 0], 9 = [1, 2, 3]}, radius = 0.5, follow = 7 }
        [[target]]
        tag = "spiral"
        mask = ["heat", "m.npz", { image = "paint.png", view = [30, 0], invert = true }]
    """
    (tmp_path / "r.toml").write_text(text)
    recipe = Recipe.from_toml(tmp_path / "r.toml")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "r.toml").write_text(recipe.to_toml())
    assert Recipe.from_toml(tmp_path / "elsewhere" / "r.toml") == recipe
    assert mask_files(recipe) == [str(tmp_path / "m.npz"), str(tmp_path / "paint.png")]
    first, second = targets_of(recipe)
    assert (first.weight(6), first.weight(20), second.weight(None)) == (0.5, 2.0, 1.0)
    assert first.recipe.at(7).style_shares == (0.5, 0.5, 0.5) and first.recipe.at(7).gamma == pytest.approx(0.15)
    assert first.recipe.style_layers == {"conv2/3x3": 1.0} and second.recipe.tag == ("spiral",)
    assert first.recipe.tag == () and second.recipe.style == () and first.recipe.target == ()


def test_a_recipe_without_targets_is_its_only_one() -> None:
    recipe = Recipe.from_dict({"style": ["net"], "mask": SPHERE})
    (only,) = targets_of(recipe)
    assert only.recipe is recipe and only.mask == (recipe.mask,) and only.number == 0


def test_flags_of_masks() -> None:
    by_flag = Recipe().updated_by_flags({"mask": "{shape = 'sphere', centre = [0, 1, 0], radius = {5: 1, 9: 2}}"})
    assert by_flag.mask == {"shape": "sphere", "centre": (0.0, 1.0, 0.0), "radius": {5: 1.0, 9: 2.0}}
    assert Recipe().updated_by_flags({"mask": "heat"}).mask == "heat"
    with pytest.raises(
        InputError, match=r"^--mask \{strength: 1\}: expected a table as in a recipe file, such as '\{hei"
    ):
        Recipe().updated_by_flags({"mask": "{strength: 1}"})


@pytest.mark.parametrize(
    ("mask", "said"),
    [
        ({"shape": "sphere", "radius": 1}, r'^recipe: mask: shape = "sphere" needs centre$'),
        ({"shape": "cone"}, "shape = 'cone': expected sphere or box"),
        ({"radius": 1}, "a table without shape, grid, file, height or image needs strength"),
        (SPHERE | {"radius": 0}, "radius = 0: expected a number above 0"),
        (SPHERE | {"low": [0, 0, 0]}, 'low does not belong to shape = "sphere"'),
        (SPHERE | {"radius": {"x": 1}}, "radius = .*: expected a number above 0"),
        (SPHERE | {"centre": [0, 1]}, "centre = .*: expected three numbers"),
        (SPHERE | {"follow": 1.5}, "follow = 1.5: expected true, or the number of the frame"),
        (SPHERE | {"size": 3}, "unknown key 'size'; the keys of a mask are"),
        ({"grid": "heat", "range": [2, 2]}, "range = .*: expected two different numbers, such as"),
        (SPHERE | {"range": [0, 2]}, 'range does not belong to shape = "sphere"'),
        ({"height": [2, 2]}, "height = .*: expected two different numbers"),
        ({"strength": 1.5}, "strength = 1.5: expected a number from 0 to 1"),
        ("no.vdb", r"mask = 'no.vdb': no such file"),
        ({"image": "no.png", "view": [0, 0]}, "mask: image = 'no.png': no such file"),
        ({"file": "nowhere/m_##.vdb"}, "mask: file = .*: no such file"),
        ([], r"mask = \[\]: expected the name of a grid"),
        (3, "mask = 3: expected the name of a grid"),
    ],
    ids=str,
)
def test_masks_that_mean_nothing(mask: Any, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        Recipe.from_dict({"mask": mask})
    assert "\n" not in str(caught.value)


def test_pictures_are_no_grids(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "paint.png")
    said = r"mask.* = '.*paint.png': is a picture, .* is \{ image = \".*paint.png\", view = \[0, 0\] \}, with azimuth"
    for mask in (str(tmp_path / "paint.png"), {"file": str(tmp_path / "paint.png")}):
        with pytest.raises(InputError, match=said):
            Recipe.from_dict({"mask": mask})
    with pytest.raises(InputError, match=r"mask = 'paint.png': no such file"):
        Recipe.from_dict({"mask": "paint.png"}, folder=tmp_path / "elsewhere")


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ({}, "^recipe: target: number 1: has none, expected one of style"),
        ({"style": "net", "tag": "x"}, "has style and tag, expected one of"),
        ({"style": "net", "damping": 1}, "'damping' is no key of a target with style; they are style, mask, weight"),
        ({"style": "net", "iterations": 3}, r"'iterations' is no key .*; keys of the recipe go above the first \[\["),
        ({"style": "net", "strenght": 3}, "'strenght' is no key of a target with style; they are [^;]*$"),
        ({"style": "net", "weight": -1}, "weight = -1: expected a number of 0 or more"),
        ({"style": "net", "weight": {}}, "weight = {}: expected a number of 0 or more"),
        ({"style": "net", "mask": {"shape": "box"}}, 'mask: shape = "box" needs high and low'),
        ({"style": "no.png"}, "target: number 1: style = 'no.png': no such picture"),
        ({"semantic": "16"}, "semantic = '16': expected a list of layers with channels"),
        ({"tag": {5: ["spiral"]}}, "tag = .*: expected a list of class names"),
    ],
    ids=str,
)
def test_targets_that_mean_nothing(target: Any, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        Recipe.from_dict({"target": [target]})
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="target = 'net': expected tables"):
        Recipe.from_dict({"target": "net"})


def test_weights_of_a_recipe_have_no_effect_on_targets() -> None:
    recipe = Recipe.from_dict({"target": [{"style": "net"}, {"tag": "spiral"}], "style_weight": 2, "damping": 1})
    unused = unused_keys(recipe, 1)
    assert unused == {
        "style_weight": "each target has a weight of its own",
        "damping": "there is no semantic",
    }
    layers = dataclasses.replace(recipe, style_weight=1.0, damping=0.0, style_layers={"conv2/3x3": 1.0})
    assert unused_keys(layers, 1) == {}, "layers of the recipe are those of targets without their own"


@pytest.mark.parametrize("weight", [0, 3.0, {5: 0, 9: 2}], ids=str)
@pytest.mark.parametrize("key", ["style_weight", "semantic_weight"])
def test_weights_of_a_recipe_do_not_reach_its_targets(key: str, weight: Any) -> None:
    """As the note on them says; they would switch targets off."""
    recipe = Recipe.from_dict({"target": [{"style": "net"}, {"tag": "spiral"}], key: weight, "gamma": {5: 1, 9: 3}})
    for target in targets_of(recipe):
        assert (target.recipe.style_weight, target.recipe.semantic_weight) == (1.0, 1.0)
        assert set(target.recipe.keyframes) == {"gamma"} and target.recipe.at(7).gamma == 2.0
    assert unused_keys(recipe, 1) == {key: "each target has a weight of its own"}


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (
            {"style": ["net", "spirals"]},
            r"^recipe: style = net spirals stands beside .*; write it as a target",
        ),
        ({"style": {5: "net", 9: "spirals"}}, r"^recipe: style = net spirals stands beside"),
        ({"tag": ["spiral"]}, r"^recipe: tag = spiral stands beside"),
        ({"mask": SPHERE}, r"^recipe: mask stands beside \[\[target\]\]; give each target its own"),
    ],
    ids=str,
)
def test_goals_beside_targets_are_told_as_they_are_written(keys: dict[str, Any], said: str) -> None:
    """A shipped picture by its name, not by where it is installed."""
    with pytest.raises(InputError, match=said):
        targets_of(Recipe.from_dict({"target": [{"style": "net"}], **keys}))
