"""Recipes and command lines of the Blender add-on: what tnst_mi takes them for."""

from __future__ import annotations

import os
import shutil
import tomllib
from pathlib import Path

import blender_addon  # noqa: F401  (makes tnst_mi_blender importable)
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from tnst_mi_blender.problems import CannotStylizeError
from tnst_mi_blender.recipes.commands import (
    Box,
    Goal,
    MaskFile,
    MaskGrid,
    Region,
    Shot,
    Sphere,
    batch_command,
    batch_folder,
    recipe_text,
    resume_command,
    stylize_command,
    write_recipe,
)
from tnst_mi_blender.recipes.parameters import parameters
from tnst_mi_blender.recipes.plan import Part, Plan, new_identifier, read_plan, require_in_place, write_plan
from tnst_mi_blender.recipes.toml import assignment

import tnst_mi
from tnst_mi.batch.jobs import jobs_of
from tnst_mi.cli import _parsed
from tnst_mi.recipe.targets import targets_of

texts = some.text(some.characters(exclude_categories=["Cs"]))
values = some.recursive(
    texts | some.integers(-(2**63), 2**63 - 1) | some.floats(allow_nan=False, allow_infinity=False) | some.booleans(),
    lambda inner: some.lists(inner, max_size=3) | some.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)


@given(texts, values)
def test_values_are_read_as_they_were_written(key: str, value: object) -> None:
    assert tomllib.loads(assignment(key, value)) == {key: value}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), None, b"bytes", "a lone \ud800"])
def test_what_toml_cannot_hold_is_refused(value: object) -> None:
    with pytest.raises(ValueError):
        assignment("key", value)


def test_numbers_of_numpy_are_numbers() -> None:
    assert assignment("eta", np.float64(0.004)) == "eta = 0.004"


def recipe_of(shot: Shot, folder: Path) -> tnst_mi.Recipe:
    write_recipe(shot, folder / "new" / "recipe.toml")
    assert [file.name for file in (folder / "new").iterdir()] == ["recipe.toml"]
    return tnst_mi.Recipe.from_toml(folder / "new" / "recipe.toml")


def test_a_shot_is_the_recipe_that_was_meant(tmp_path: Path) -> None:
    picture = tmp_path / 'Söhne\'s "fire" \\ 火.png'
    camera = tmp_path / "shot.json"
    for file in (picture, camera):
        file.touch()
    shot = Shot(
        goals=(Goal("style", str(picture)), Goal("style", "spirals"), Goal("tag", "brush strokes")),
        quality="draft",
        frames=(-3, 12),
        camera=camera,
        origin=(-1.0125, 0.0, 2),
        voxel_size=0.075,
        weights="patterns",
        keys={"octaves": 2, "gamma": {1: 0.1, 12: 1.0}, "reach": "5%", "azimuth": [-20, 20], "style_layers": None},
    )
    recipe = recipe_of(shot, tmp_path)
    assert recipe.style[0] == str(picture) and Path(recipe.style[1]).name == "spirals.png"
    assert recipe.tag == ("brush strokes",)
    assert (recipe.quality, recipe.frames, recipe.format) == ("draft", "-3:12", "vdb")
    assert (recipe.camera, recipe.weights) == (str(camera), "patterns")
    assert (recipe.origin, recipe.voxel_size) == ((-1.0125, 0.0, 2.0), 0.075)
    assert (recipe.octaves, recipe.azimuth) == (2, (-20.0, 20.0))
    assert dict(recipe.keyframes["gamma"]) == {1: 0.1, 12: 1.0}


def test_pictures_named_from_where_blender_was_started_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("fire.png").write_bytes(b"")
    assert recipe_of(Shot(goals=(Goal("style", "fire.png"),)), tmp_path).style == (str(tmp_path / "fire.png"),)


def test_regions_are_the_targets_that_were_meant(tmp_path: Path) -> None:
    shot = Shot(
        regions=(
            Region(
                Goal("style", "flames", {"style_layers": {"conv2/3x3": 1.0}}),
                (Sphere({57: (0, 1, 0), 65: (0.5, 2, 0)}, 0.5, 0.1), MaskGrid("flame", (0.2, 0.8))),
                weight=0.5,
                strength={57: 0, 63: 1},
            ),
            Region(Goal("tag", "net"), (Box((-1, -1, 0), (1, 1, 2)),), invert=True, follow=True),
            Region(Goal("semantic", "inception_4b/pool_proj:16"), (MaskFile(tmp_path / "mask_####.npz"),)),
            Region(Goal("tag", "spiral"), strength=0.25),
            Region(Goal("tag", "spiral")),
        ),
        keys={"window": 3},
    )
    targets = targets_of(recipe_of(shot, tmp_path))
    assert [target.weight(None) for target in targets] == [0.5, 1.0, 1.0, 1.0, 1.0]
    assert all(target.recipe.window == 3 for target in targets)
    sphere = {"shape": "sphere", "centre": {57: (0.0, 1.0, 0.0), 65: (0.5, 2.0, 0.0)}, "radius": 0.5, "edge": 0.1}
    assert targets[0].mask == (
        sphere | {"strength": {57: 0.0, 63: 1.0}},
        {"grid": "flame", "range": (0.2, 0.8)},
    )
    box = {"shape": "box", "low": (-1.0, -1.0, 0.0), "high": (1.0, 1.0, 2.0), "edge": 0.0}
    assert targets[1].mask == (box | {"invert": True, "follow": True},)
    assert targets[2].mask == ({"file": str(tmp_path / "mask_####.npz")},)
    assert targets[3].mask == ({"strength": 0.25},) and targets[4].mask == ()


def test_a_shot_without_a_goal_or_with_two_kinds_is_refused(tmp_path: Path) -> None:
    region = Region(Goal("tag", "net"))
    for shot in (Shot(), Shot(goals=(region.goal,), regions=(region,))):
        with pytest.raises(ValueError, match="choose"):
            write_recipe(shot, tmp_path / "recipe.toml")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("key", [key for key, each in parameters().items() if each.default is not None])
def test_every_key_of_the_panel_may_be_given(key: str, tmp_path: Path) -> None:
    default = parameters()[key].default
    goals = () if key == "target" else (Goal("tag", "net"),)
    regions = (Region(Goal("tag", "net")),) if key == "target" else ()
    shot = Shot(goals, regions, keys={} if key in ("target", "tag") else {key: default})
    assert recipe_of(shot, tmp_path).octaves == 3


def test_command_lines_are_understood(tmp_path: Path) -> None:
    program, source, recipe = Path("/env/bin/tnst-mi"), Path("smoke_####.vdb"), Path("one.toml")
    first, name, *words = stylize_command(program, source, recipe, tmp_path / "out")
    given = _parsed(name, words)
    assert (first, given.input, given.recipe, given.out) == (
        "/env/bin/tnst-mi",
        Path.cwd() / source,
        Path.cwd() / recipe,
        tmp_path / "out",
    )
    assert not given.overwrite and not given.resume
    assert _parsed("stylize", stylize_command(program, source, recipe, tmp_path, overwrite=True)[2:]).overwrite
    resumed = _parsed("stylize", resume_command(program, tmp_path)[2:])
    assert (resumed.resume, resumed.input, resumed.recipe, resumed.out) == (True, None, None, tmp_path)
    batch = _parsed("batch", batch_command(program, source, [recipe, Path("two.toml")], tmp_path)[2:])
    assert batch.files == tuple(Path.cwd() / name for name in ("one.toml", "two.toml", "smoke_####.vdb"))


@pytest.mark.parametrize("source", ["cache", "smoke_####.vdb", "a b.vdb"])
def test_the_runs_of_a_batch_are_where_they_are_looked_for(tmp_path: Path, source: str) -> None:
    (tmp_path / "cache").mkdir()
    recipe = tmp_path / "Shot 1: Söhne.toml"
    (job,) = jobs_of({recipe: tnst_mi.Recipe()}, [tmp_path / source], tmp_path / "out")
    assert batch_folder(tmp_path / "out", recipe, tmp_path / source) == job.out


def test_a_relative_mask_file_is_found_from_anywhere() -> None:
    text = recipe_text(Shot(regions=(Region(Goal("tag", "net"), (MaskFile(Path("m.npz")),)),)))
    assert tomllib.loads(text)["target"][0]["mask"]["file"] == os.path.abspath("m.npz")


def test_plans_are_read_as_they_were_written_and_not_resumed_elsewhere(tmp_path: Path) -> None:
    folder, moved = tmp_path / "project", tmp_path / "moved"
    parts = (Part("close", str(folder / "draft" / "close")),)
    plan = Plan(
        "Smoke", "/smoke.vdb", str(folder / "draft"), ("/close.toml",), parts, new_identifier(), "a.blend", ("b",)
    )
    write_plan(plan, folder)
    assert read_plan(folder) == plan and new_identifier() != plan.identifier
    require_in_place(plan, folder)
    (tmp_path / "link").symlink_to(folder)
    require_in_place(plan, tmp_path / "link")
    shutil.copytree(folder, moved)
    for _ in range(2):  # a copy, and then what was moved
        with pytest.raises(
            CannotStylizeError, match=f"{moved}: was started as {folder}, and cannot be resumed elsewhere"
        ):
            require_in_place(read_plan(moved), moved)
        shutil.rmtree(folder, ignore_errors=True)
