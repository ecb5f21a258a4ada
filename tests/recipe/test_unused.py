"""Keys that are given and decide nothing are named, and no others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.unused import unused_keys

STYLE: dict[str, Any] = {"style": ("spirals",)}
TAG: dict[str, Any] = {"tag": ("spiral",)}


@pytest.mark.parametrize(
    ("keys", "frames", "unused"),
    [
        (STYLE, 1, []),
        (STYLE | {"style_weight": 2.0}, 1, ["style_weight"]),
        (STYLE | {"style_weight": 0.0}, 1, []),
        (STYLE | {"style_weight": {1: 1.0, 2: 3.0}}, 2, []),
        (STYLE | TAG | {"style_weight": 2.0, "semantic_weight": 3.0}, 1, []),
        (STYLE | {"semantic_weight": 3.0}, 1, ["semantic_weight"]),
        (TAG | {"style_weight": 2.0, "semantic_weight": 3.0}, 1, ["style_weight", "semantic_weight"]),
        (TAG | {"style_loss": "paper", "damping": 1.0}, 1, ["style_loss", "damping"]),
        ({"semantic": ("conv2/3x3:1",), "damping": 1.0}, 1, []),
        (STYLE | {"content_layers": ["conv2/3x3"]}, 1, ["content_layers"]),
        (STYLE | {"window_weights": "triangle", "window": 3}, 5, []),
        (STYLE | {"window_weights": "triangle", "window": 3}, 1, ["window_weights"]),
        (STYLE | {"coherence": 0.5}, 5, ["coherence"]),
        (STYLE | {"fps": 30.0}, 1, ["fps"]),
        (STYLE | {"fps": 30.0}, 2, []),
        (STYLE | {"look": "thick"}, 1, ["look"]),
        (STYLE | {"look": 50.0, "gamma": "auto"}, 1, []),
        (STYLE | {"spp": 4, "albedo": 0.5}, 1, ["albedo", "spp"]),
        (STYLE | {"spp": 4, "integrator": "prbvolpath"}, 1, []),
        (STYLE | {"quadrature": "exact", "integrator": "prbvolpath"}, 1, ["quadrature"]),
        (STYLE | {"parameterisation": "density", "lam": 0.5}, 1, ["lam"]),
        # A value that is the default is not worth a word.
        (STYLE | {"spp": 16, "style_weight": 1.0}, 1, []),
    ],
)
def test_what_has_no_effect(keys: dict[str, Any], frames: int, unused: list[str]) -> None:
    assert sorted(unused_keys(Recipe.from_dict(keys), frames)) == sorted(unused)


def test_a_preset_gives_no_keys() -> None:
    recipe = Recipe(tag=("spiral",), preset="paper")
    assert unused_keys(recipe, 1) == unused_keys(recipe.located(Path.cwd()), 1) == {}
