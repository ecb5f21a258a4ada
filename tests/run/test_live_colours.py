"""images/ in colour while a run goes on."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import tiny_weights
from moving_smoke import moving_smoke
from PIL import Image

import tnst_mi
from tnst_mi.optimisation.glimpse import Glimpses
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.driving import main_view
from tnst_mi.rendering.smoke_colour import shown_colours

__all__ = ["tiny_weights"]

SHAPE = (10, 14, 12)


@pytest.fixture
def keys(tiny_weights: Path, tmp_path: Path) -> dict[str, Any]:
    """A recipe of two octaves with a picture of orange and dark blue."""
    pixels = np.full((24, 24, 3), (255, 128, 0), np.uint8)
    pixels[::2] = (0, 0, 64)
    Image.fromarray(pixels).save(tmp_path / "stripes.png")
    keys = {"style": [str(tmp_path / "stripes.png")], "style_layers": {"inception_3a/3x3": 1.0}}
    keys |= {"weights": str(tiny_weights), "octaves": 2, "iterations": 4, "views": 2, "eta": 0.02}
    return keys | {"density_scale": 1.0, "fit": False, "keep_octaves": True, "colour_eta": 0.1}


def with_colours(own: bool) -> tnst_mi.Frame:
    """Smoke, red on the left and blue on the right if it has colours."""
    (frame,) = moving_smoke(1, SHAPE)
    right = np.broadcast_to(np.linspace(0, 1, SHAPE[2], dtype=np.float32), SHAPE)
    colour = np.stack([1 - right, np.full(SHAPE, 0.25, np.float32), right], axis=-1)
    return dataclasses.replace(frame, grids={"Cd": colour}) if own else frame


@pytest.mark.parametrize(
    ("colour", "own", "more"),
    [("style", False, {}), ("style", True, {}), ("style", False, {"strength": 0.5, "blend": 0.5}), ("keep", True, {})],
    ids=["style", "style of coloured smoke", "half", "keep"],
)
def test_octaves_are_shown_in_the_colours_of_the_draft(
    colour: str, own: bool, more: dict[str, Any], keys: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame, seen, of = with_colours(own), [], Glimpses.of

    def noted(self: Glimpses, *arguments: Any) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        for name, before, after in of(self, *arguments):
            seen.append((before, after))
            yield name, before, after

    monkeypatch.setattr(Glimpses, "of", noted)
    keys |= {"colour": colour} | more
    result = tnst_mi.stylize(frame, keys, tmp_path / "out", progress=False)
    blind = tnst_mi.stylize(frame, keys | {"keep_octaves": False}, progress=False)
    np.testing.assert_array_equal(result.grids[0]["Cd"], blind.grids[0]["Cd"])
    # Once for images/, once for octaves/.
    (before, after), again = seen
    np.testing.assert_array_equal(after, again[1])
    assert before.shape == after.shape == (7, 6, 3)
    assert (np.ptp(before, axis=-1).max() > 0.1) == own, "white smoke is grey before"

    draft = tnst_mi.stylize(frame, keys | {"quality": "draft", "keep_octaves": False}, progress=False)
    exposure = result.run["frames"][0]["exposure"]
    expected = [
        exposure * main_view(d, Recipe.from_dict(keys), SHAPE[1:], shown_colours(grids, "Cd", "", SHAPE))
        for d, grids in ((frame.density, frame.grids), (draft.densities[0], draft.grids[0]))
    ]
    for image, whole in zip((before, after), expected, strict=True):
        shrunk = whole.reshape(7, 2, 6, 2, 3).mean((1, 3))
        assert np.abs(image - shrunk).mean() < 0.1 * shrunk.mean()
        for mixture in ([1, -1, 0], [0, 1, -1]):
            if own or whole is expected[1]:
                assert np.corrcoef((image @ mixture).ravel(), (shrunk @ mixture).ravel())[0, 1] > 0.95
    pixels = np.asarray(Image.open(tmp_path / "out/octaves/1/images/s_005_comparison.png").convert("RGB"), int)
    left, right = np.array_split(np.ptp(pixels, axis=-1), 2, axis=1)
    assert (left[:, :-40].max() > 20) == own and right.max() > 20
