"""Drafts and previews: states that the final stylization passes through, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from moving_smoke import moving_smoke
from networks import random_googlenet

import tnst_mi
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.levels import levels_of, levels_seen

SHAPE = (14, 20, 16)


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A recipe of two octaves."""
    weights = random_googlenet(tmp_path_factory.mktemp("weights") / "tiny.safetensors", narrow=8)
    goal = {"semantic": ["inception_3a/3x3:2"], "weights": str(weights)}
    return goal | {"octaves": 2, "iterations": 5, "views": 2, "eta": 0.004}


def stylized(keys: dict[str, Any], quality: str, **others: Any) -> tnst_mi.Result:
    return tnst_mi.stylize(moving_smoke(1, SHAPE), keys | {"quality": quality} | others, progress=False)


def losses(result: tnst_mi.Result) -> list[tuple[int, int, float]]:
    return [(entry["octave"], entry["iteration"], entry["loss"]) for entry in result.history[0]]


def test_draft_and_preview_are_on_the_way_to_the_final(keys: dict[str, Any]) -> None:
    """Their losses, whose views are drawn anew in every iteration, are the first ones of the final."""
    final = losses(stylized(keys, "final"))
    assert [(octave, k) for octave, k, _ in final] == [(octave, k) for octave in (0, 1) for k in range(5)]
    assert losses(stylized(keys, "draft")) == final[:5]
    assert losses(stylized(keys, "preview")) == final[:8]


def test_what_they_end_with_is_what_the_final_has_there(keys: dict[str, Any]) -> None:
    """A preview of four iterations is the final of three in the finest octave only if nothing else differs."""
    preview = stylized(keys | {"octaves": 1, "iterations": 4}, "preview")
    final = stylized(keys | {"octaves": 1, "iterations": 3}, "final")
    assert np.array_equal(preview.densities[0], final.densities[0])
    assert not np.array_equal(preview.densities[0], preview.frames[0].density)


@pytest.mark.parametrize("motif_size", ["cells", 1.5])
def test_exposure_step_and_motifs_do_not_depend_on_the_quality(keys: dict[str, Any], motif_size: float | str) -> None:
    """Nor do densities come back on another grid."""
    results = [stylized(keys, quality, motif_size=motif_size, iterations=1) for quality in ("draft", "final")]
    draft, final = (result.run["frames"][0] for result in results)
    assert draft["exposure"] == final["exposure"] and draft["step_scale"] == final["step_scale"]
    assert draft["losses"] == final["losses"][:1]
    assert all(result.densities[0].shape == SHAPE for result in results)


def test_a_draft_leaves_out_the_finest_octave_and_all_is_measured_on_the_same() -> None:
    shape = (64, 96, 64)
    by_quality = {quality: Recipe(tag=("a",), quality=quality) for quality in ("draft", "preview", "final")}
    final = levels_of(by_quality["final"], shape)
    assert [level.shape[1] for level in final] == [29, 53, 96]
    assert levels_of(by_quality["preview"], shape) == final
    assert levels_of(by_quality["draft"], shape) == final[:2]
    assert {tuple(levels_seen(recipe, shape)) for recipe in by_quality.values()} == {tuple(final)}


def test_a_draft_of_one_octave_has_a_quarter_of_its_iterations(keys: dict[str, Any]) -> None:
    draft = stylized(keys | {"octaves": 1}, "draft")
    assert [(octave, k) for octave, k, _ in losses(draft)] == [(0, 0), (0, 1)]


def test_a_preview_of_a_sequence_with_a_window(keys: dict[str, Any]) -> None:
    """Each frame has the iterations of a preview, and they are those of the final."""
    few = keys | {"window": 3, "iterations": 3}
    preview, final = (
        tnst_mi.stylize(moving_smoke(3), few | {"quality": quality}, progress=False) for quality in ("preview", "final")
    )
    for frame in range(3):
        history = [(entry["octave"], entry["iteration"], entry["loss"]) for entry in final.history[frame]]
        assert [(e["octave"], e["iteration"], e["loss"]) for e in preview.history[frame]] == history[:5]
