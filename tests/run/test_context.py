"""`context`: neighbours of selected frames are stylized with them, and leave no results."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from moving_smoke import moving_smoke

import tnst_mi
from tnst_mi.io.sequence import save_frame
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare

GOAL = {"semantic": ["inception_3a/3x3:2"], "octaves": 2, "iterations": 2, "views": 1, "window": 3}


@pytest.fixture(scope="module")
def smoke(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames 5 to 10."""
    folder = tmp_path_factory.mktemp("smoke")
    for frame in moving_smoke(6):
        save_frame(folder / f"{frame.name}.npz", frame)
    return folder


@pytest.fixture(scope="module")
def whole(smoke: Path, weights: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[int | float | None, np.ndarray]:
    result = tnst_mi.stylize(smoke, GOAL | {"weights": str(weights)}, tmp_path_factory.mktemp("whole"), progress=False)
    return {f.number: d for f, d in zip(result.frames, result.densities, strict=True)}


def test_with_all_others_as_context_frames_are_those_of_the_whole(
    smoke: Path, weights: Path, whole: dict, tmp_path: Path
) -> None:
    recipe = GOAL | {"weights": str(weights), "frames": "7:8"}
    with_context = tnst_mi.stylize(smoke, recipe | {"context": 9}, tmp_path / "part", progress=False)
    assert [frame.number for frame in with_context.frames] == [7, 8]
    for frame, density in zip(with_context.frames, with_context.densities, strict=True):
        np.testing.assert_array_equal(density, whole[frame.number])
    assert sorted(path.name for path in (tmp_path / "part" / "density").iterdir()) == ["s_007.npz", "s_008.npz"]
    run = with_context.run
    assert run["status"] == "done" and len(run["sequence"]["relative_changes"]) == 2
    assert list(run["inputs"]) == [f"s_{number:03d}" for number in range(5, 11)]
    assert {json.loads(line)["frame"] for line in (tmp_path / "part" / "metrics.jsonl").open()} == {"s_007", "s_008"}
    alone = tnst_mi.stylize(smoke, recipe, tmp_path / "alone", progress=False)
    near = tnst_mi.stylize(smoke, recipe | {"context": 1}, tmp_path / "near", progress=False)
    away = [
        sum(np.abs(d - whole[f.number]).sum() for f, d in zip(r.frames, r.densities, strict=True))
        for r in (alone, near)
    ]
    assert away[0] > away[1] > 0


def test_a_part_in_memory_and_one_frame_of_it(smoke: Path, weights: Path, whole: dict) -> None:
    recipe = GOAL | {"weights": str(weights), "frames": "6", "context": 9}
    result = tnst_mi.stylize(smoke, recipe, progress=False)
    assert "sequence" not in result.run
    np.testing.assert_array_equal(result.densities[0], whole[6])


def test_a_part_that_was_stopped_goes_on(smoke: Path, weights: Path, whole: dict, tmp_path: Path) -> None:
    recipe = Recipe.from_dict(GOAL | {"weights": str(weights), "frames": "7:8", "context": 9})
    stopped = Run(prepare(smoke, recipe, tmp_path / "out"), progress=False)
    next(stopped)
    stopped.close()
    for _ in Run(prepare(smoke, recipe, tmp_path / "out", resume=True), progress=False):
        pass
    for _ in Run(prepare(smoke, recipe, tmp_path / "out", resume=True), progress=False):
        raise AssertionError("nothing is left to do")
    for number in (7, 8):
        with np.load(tmp_path / "out" / "density" / f"s_{number:03d}.npz") as file:
            np.testing.assert_array_equal(file["density"], whole[number])
