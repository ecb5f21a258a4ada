"""Whole runs do not depend on the unit of density, and each frame of a keyframed γ is treated as if it were alone."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from moving_smoke import moving_smoke
from networks import random_googlenet

import tnst_mi
from tnst_mi.frame import Frame
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.api import Result

KEYS = {"semantic": ["inception_3a/3x3:2"], "octaves": 2, "iterations": 3, "views": 2, "gamma": 0.3, "eta": 0.01}
SHAPE = (14, 20, 16)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    random_googlenet(path, narrow=8)
    return str(path)


def smoke(factor: float = 1.0, count: int = 3) -> list[Frame]:
    """Frames whose tails end where a float32 times 2⁻²⁰ has lost no bits."""
    frames = moving_smoke(count, SHAPE)
    kept = [np.where(frame.density > 1e-20, frame.density, 0) for frame in frames]
    return [
        dataclasses.replace(frame, density=density * np.float32(factor))
        for frame, density in zip(frames, kept, strict=True)
    ]


def stylized(frames: list[Frame], weights: str, **keys: Any) -> Result:
    return tnst_mi.stylize(frames, Recipe.from_dict({**KEYS, "weights": weights, **keys}), progress=False)


def change(frames: list[Frame], result: Result, index: int) -> float:
    before, after = (density.astype(np.float64) for density in (frames[index].density, result.densities[index]))
    return float(np.linalg.norm(after - before) / np.linalg.norm(before))


@pytest.mark.parametrize("window", [1, 3])
@pytest.mark.parametrize("parameterisation", ["transport", "density"])
def test_a_power_of_two_in_the_density_gives_the_same_bits(parameterisation: str, window: int, weights: str) -> None:
    keys = {"parameterisation": parameterisation, "window": window, "coherence": 0.5}
    expected = stylized(smoke(), weights, **keys)
    assert change(smoke(), expected, 1) > 0.02
    for exponent in (-20, -6, 4, 20):
        result = stylized(smoke(2.0**exponent), weights, **keys)
        assert result.run["density_scale"] == expected.run["density_scale"] * 2.0**-exponent
        for found, density in zip(result.densities, expected.densities, strict=True):
            np.testing.assert_array_equal(np.ldexp(found, -exponent), density)
        for found, velocity in zip(result.velocities, expected.velocities, strict=True):
            np.testing.assert_array_equal(found, velocity)
        for found, frame in zip(result.run["frames"], expected.run["frames"], strict=True):
            assert found["losses"] == frame["losses"] and found["loss_after"] == frame["loss_after"]


@pytest.mark.parametrize("factor", [0.01, 20.0, 1e30])
def test_another_factor_gives_the_same_to_rounding(factor: float, weights: str) -> None:
    """One step is the same; of more, what they achieve (docs/sequences.md, on the sensitivity to rounding)."""
    one = {"iterations": 1, "octaves": 1, "lam": 0.5}
    steps = [stylized(smoke(f), weights, **one).velocities[0] for f in (1.0, factor)]
    assert np.linalg.norm(steps[1] - steps[0]) < 1e-4 * np.linalg.norm(steps[0])
    results = [stylized(smoke(f), weights) for f in (1.0, factor)]
    losses = [result.run["frames"][1]["loss_after"] for result in results]
    assert losses[1] == pytest.approx(losses[0], rel=0.05)
    changes = [change(smoke(f), result, 1) for f, result in zip((1.0, factor), results, strict=True)]
    assert changes[1] == pytest.approx(changes[0], rel=0.05)


def test_the_input_can_be_taken_as_it_is(weights: str) -> None:
    """Then thin smoke is hardly touched: its mask is its density."""
    thin = smoke(0.05)
    as_it_is, scaled = stylized(thin, weights, density_scale=1.0), stylized(thin, weights)
    assert as_it_is.run["density_scale"] == 1.0 and scaled.run["density_scale"] > 15
    assert change(thin, as_it_is, 1) < 0.2 * change(thin, scaled, 1)
    by_hand = stylized(thin, weights, density_scale=scaled.run["density_scale"])
    np.testing.assert_array_equal(by_hand.densities[1], scaled.densities[1])


def test_untouched_smoke_keeps_its_bits(weights: str) -> None:
    for parameterisation in ("transport", "density"):
        frames = smoke(0.37)
        result = stylized(frames, weights, parameterisation=parameterisation, blend=0.0)
        np.testing.assert_array_equal(result.densities[1], frames[1].density)


def test_a_frame_of_a_keyframed_gamma_changes_as_it_does_alone(weights: str) -> None:
    frames = smoke(count=3)
    together = stylized(frames, weights, gamma={5: 0.1, 7: 1.0})
    alone = stylized(frames[2:], weights, gamma=1.0)
    assert change(frames, together, 2) == pytest.approx(change(frames[2:], alone, 0), rel=0.1)


def test_the_factor_is_said(weights: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    recipe = Recipe.from_dict({**KEYS, "weights": weights, "iterations": 1})
    density = np.full((6, 8, 7), 0.05, np.float32)
    density[2, 3, 4] = 0.2
    tnst_mi.stylize(density, recipe)
    told = "density: up to 0.2, taken times 20 (density_scale), so that gamma is that of density 0.05"
    assert told in capsys.readouterr().err


def test_auto_gamma_is_that_of_the_look(weights: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """To the bit the run of the number, which is said; and the recipe as run still says auto."""
    frames = smoke(count=1)
    auto = tnst_mi.stylize(frames, Recipe.from_dict({**KEYS, "weights": weights, "gamma": "auto"}), tmp_path / "run")
    assert "gamma: auto, 1.25 per cell, as thick as smoke of density 1 is in the look medium" in capsys.readouterr().err
    by_hand = stylized(frames, weights, gamma=25 / max(SHAPE))
    np.testing.assert_array_equal(auto.densities[0], by_hand.densities[0])
    assert auto.run["exposure"] == by_hand.run["exposure"]
    assert Recipe.from_toml(tmp_path / "run" / "recipe.toml").gamma == "auto"
    thin = stylized(frames, weights, gamma="auto", look="thin")
    assert change(frames, thin, 0) > 0 and not np.array_equal(thin.densities[0], by_hand.densities[0])
