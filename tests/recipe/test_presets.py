"""Presets: what `paper` sets, and that every key that is given stays as it is given."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from pathlib import Path
from typing import Any

import pytest

from tnst_mi.errors import InputError
from tnst_mi.recipe.recipe import KINDS, Recipe

SCENES = Path(__file__).resolve().parents[2] / "scenes"

#: What a recipe of nothing but `preset = "paper"` stands for, goals and resources aside: the paper's formulas, its
#: constants, and our defaults for what its examples vary.
PAPER = {
    "style_loss": "paper",
    "style_statistics": "image",
    "style_weight": 1.0,
    "semantic_weight": 1.0,
    "damping": 0.0,
    "preset": "paper",
    "lam": 1.0,
    "gamma": 0.1,
    "density_scale": 1.0,
    "quadrature": "paper",
    "octaves": 3,
    "motif_size": "cells",
    "scale_factor": 1.8,
    "iterations": 20,
    "views": 9,
    "azimuth": (-10.0, 10.0),
    "elevation": (-5.0, 5.0),
    "fit": False,
    "loss_scaling": "none",
    "sigma": "loss",
    "eta": 0.002,
    "pyramid_levels": 3,
    "mask_strength": 1.0,
    "window": 1,
    "window_weights": "uniform",
    "window_average": "plain",
    "step_order": "align_first",
    "coherence": 0.0,
    "steps": 1,
    "transport": "step",
    "parameterisation": "transport",
    "integrator": "emission_absorption",
    "blend": 1.0,
}

#: Keys in which it differs from our defaults.
OTHERWISE = {"preset", "style_loss", "loss_scaling", "sigma", "window_average", "step_order", "density_scale"} | {
    "lam",
    "transport",
    "motif_size",
}


def values(recipe: Recipe) -> dict[str, Any]:
    return {name: getattr(recipe, name) for name in KINDS}


def test_the_paper_s_keys_are_all_resolved() -> None:
    resolved, default = values(Recipe.from_dict({"preset": "paper"})), values(Recipe())
    assert {name: resolved[name] for name in PAPER} == PAPER
    assert {name for name in KINDS if resolved[name] != default[name]} == OTHERWISE


def test_keys_of_the_same_file_win_wherever_they_stand(tmp_path: Path) -> None:
    lines = ['preset = "paper"', 'sigma = "step"', "iterations = 7", 'step_order = "normalise_first"']
    for order in (lines, lines[::-1]):
        (tmp_path / "r.toml").write_text("\n".join(order), "utf-8")
        recipe = Recipe.from_toml(tmp_path / "r.toml")
        assert (recipe.sigma, recipe.iterations, recipe.step_order) == ("step", 7, "normalise_first")
        assert (recipe.style_loss, recipe.window_average) == ("paper", "plain")


def test_flags_and_keys_win_over_a_preset_by_flag_or_file(tmp_path: Path) -> None:
    """A key that is given our default counts as given, too."""
    (tmp_path / "r.toml").write_text('style_loss = "gram"\neta = 0.004\n', "utf-8")
    flags = {"sigma": "step", "preset": "paper", "loss_scaling": "gradient"}
    for order in (flags, dict(reversed(flags.items()))):
        recipe = Recipe.from_toml(tmp_path / "r.toml").updated_by_flags(order)
        assert (recipe.style_loss, recipe.eta, recipe.sigma, recipe.loss_scaling) == ("gram", 0.004, "step", "gradient")
        assert (recipe.window_average, recipe.step_order) == ("plain", "align_first")
    (tmp_path / "r.toml").write_text('preset = "paper"\n', "utf-8")
    assert Recipe.from_toml(tmp_path / "r.toml").updated_by_flags({"style_loss": "gram"}).style_loss == "gram"


def test_the_constructor_tells_what_is_given() -> None:
    recipe = Recipe(preset="paper", style_loss="gram", lam={1: 0.0, 2: 1.0})
    assert (recipe.style_loss, recipe.sigma) == ("gram", "loss")
    assert recipe.given == {"preset", "style_loss", "lam"}
    assert recipe.updated({"preset": None}, "", Path.cwd()).sigma == "step"
    for same in (copy.copy(recipe), copy.deepcopy(recipe), pickle.loads(pickle.dumps(recipe))):
        assert same == recipe and same.given == recipe.given


def test_copies_keep_what_was_resolved() -> None:
    recipe = Recipe(preset="paper", sigma="step", gamma={1: 0.1, 3: 1.0})
    assert recipe.at(2).sigma == "step" and recipe.at(2).style_loss == "paper"
    replaced = dataclasses.replace(recipe, style_loss="gram")
    assert (replaced.style_loss, replaced.sigma, replaced.step_order) == ("gram", "step", "align_first")
    assert replaced.updated({"views": 2}, "", Path.cwd()).keyframes == recipe.keyframes


def test_the_recipe_of_a_run_gives_the_same_run(tmp_path: Path) -> None:
    recipe = Recipe.from_dict({"preset": "paper", "sigma": "step", "style": ["spirals"], "views": 2})
    (tmp_path / "recipe.toml").write_text(recipe.to_toml(), "utf-8")
    again = Recipe.from_toml(tmp_path / "recipe.toml")
    assert again == recipe
    assert again.preset == "paper" and again.sigma == "step"


@pytest.mark.parametrize("value", ["ours", "Paper", 1])
def test_other_presets_are_refused(value: object) -> None:
    with pytest.raises(InputError, match=r"^recipe: preset = .*: expected paper(; did you mean paper\?)?$"):
        Recipe.from_dict({"preset": value})
    with pytest.raises(InputError, match=r"^recipe: preset = .*: expected paper"):
        Recipe(preset=value)


@pytest.mark.parametrize("name", ["semantic", "style", "volcano", "sato"])
def test_recipes_of_table_2_take_the_preset_and_repeat_none_of_it(name: str) -> None:
    recipe = Recipe.from_toml(SCENES / "paper" / f"{name}.toml")
    assert recipe.preset == "paper" and recipe.window == 9
    resolved, preset = values(recipe), values(Recipe(preset="paper"))
    kept = recipe.given - {"preset"}
    assert {key for key in kept if resolved[key] == preset[key]} <= {"style_layers", "eta", "gamma", "octaves"}
    assert all(resolved[key] == preset[key] for key in PAPER if key not in kept)
