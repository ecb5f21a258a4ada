"""Which keys of the transport belong together, and what is said where they do not."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.optimisation.parameterisation import Transport
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.recipe.recipe import Recipe


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"transport": "flow", "steps": 4}, "steps = 4 belongs to transport = 'step', and transport is 'flow'"),
        ({"transport": "flow", "steps": "auto"}, "steps = 'auto' belongs to transport = 'step'"),
        ({"transport": "step", "stages": 4}, "stages = 4 belongs to transport = 'flow', and transport is 'step'"),
        ({"preset": "paper", "conservative": True}, "conservative = True belongs to transport = 'flow'"),
    ],
)
def test_keys_of_the_other_transport_are_refused_in_one_line(keys: dict, message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}[^\n]*expected[^\n]*$"):
        tnst_mi.stylize(np.ones((8, 8, 8), np.float32), {"style": ["net"], "weights": "patterns"} | keys)


@pytest.mark.parametrize(
    ("keys", "transport"),
    [
        ({}, "flow"),
        ({"lam": 0.0}, "flow"),
        ({"lam": 0.01}, "step"),
        ({"lam": {1: 0.0, 9: 0.5}}, "step"),
        ({"steps": "auto"}, "step"),
        ({"steps": 1}, "flow"),
        ({"lam": 1.0, "stages": 8}, "flow"),
        ({"lam": 1.0, "stages": "auto"}, "step"),
        ({"lam": 1.0, "conservative": False}, "step"),
        ({"lam": 1.0, "conservative": True}, "flow"),
        ({"lam": 1.0, "transport": "flow"}, "flow"),
        ({"transport": "step"}, "step"),
        ({"preset": "paper", "lam": 0.0}, "step"),
    ],
)
def test_the_transport_follows_from_what_is_given(keys: dict, transport: str) -> None:
    recipe = Recipe.from_dict(keys)
    assert recipe.transport == Recipe.from_dict(tomllib.loads(recipe.to_toml())).transport == transport
    assert Recipe().updated(keys, "", Path()).transport == transport


def test_flags_may_come_in_any_order() -> None:
    flags = {"stages": "8", "conservative": "true", "transport": "flow", "steps": "1"}
    for order in (flags, dict(reversed(flags.items()))):
        recipe = Recipe(style=("net",), steps=4).updated_by_flags(order)
        (frame,) = plan_of(recipe, ["a"], [None], [1.0], [1.0], (8, 8, 8)).frames
        transport = frame.parameterisation
        assert isinstance(transport, Transport)
        assert (transport.trace, transport.stages, transport.conservative) == ("flow", 8, True)
