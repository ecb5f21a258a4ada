"""Real runs of tnst-mi by the Blender add-on's recipes and jobs: followed, cancelled, resumed, several as a batch."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import blender_addon  # noqa: F401  (makes tnst_mi_blender importable)
import pytest
from jobs import frames
from tnst_mi_blender.processes.job import Job
from tnst_mi_blender.processes.progress import Progress
from tnst_mi_blender.recipes import commands
from tnst_mi_blender.recipes.commands import Goal, Region, Shot, Sphere

from tnst_mi.io import save_frames

SHORT = {"octaves": 2, "views": 1, "iterations": 2, "weights": "patterns"}


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """`tnst-mi` of this checkout, whichever is installed."""
    script = tmp_path / "program" / "tnst-mi"
    script.parent.mkdir()
    script.write_text(f'#!/bin/sh\nexec {sys.executable} -m tnst_mi "$@"\n')
    script.chmod(0o755)
    return script


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    """A folder with three frames, 7 to 9, as .vdb."""
    save_frames(tmp_path / "cache", frames(0.2, 0.4, 0.3), format="vdb")
    return tmp_path / "cache"


def followed(job: Job, until: str = "") -> list[Progress]:
    """What a job says until its end, or until its text begins so."""
    job.start()
    seen = [job.poll()]
    while not job.finished and not (until and seen[-1].text.startswith(until)):
        time.sleep(0.01)
        seen.append(job.poll())
    seen.append(job.poll())
    return list(dict.fromkeys(seen))


def test_a_run_is_followed_to_its_results(program: Path, cache: Path, tmp_path: Path) -> None:
    regions = (Region(Goal("tag", "net"), (Sphere((0, 0, 0), 50.0, 1.0),)), Region(Goal("style", "spirals")))
    commands.write_recipe(Shot(regions=regions, frames=(7, 8), keys=SHORT | {"iterations": 15}), tmp_path / "shot.toml")
    out = tmp_path / "out"
    job = Job(commands.stylize_command(program, cache, tmp_path / "shot.toml", out), tmp_path / "job.log")
    seen = followed(job)
    assert (job.exit_code, job.error) == (0, None), job.log.read_text()
    assert sorted(file.suffix for file in (out / "density").iterdir()) == [".vdb", ".vdb"]
    assert seen[0].fraction is None and (seen[-1].fraction, seen[-1].text) == (1.0, "writing results")
    fractions = [progress.fraction for progress in seen if progress.fraction is not None]
    assert fractions == sorted(fractions) and any(0 < fraction < 1 for fraction in fractions)
    assert any(progress.text.startswith("octave ") and ", frame " in progress.text for progress in seen)


def test_a_cancelled_run_is_resumed(program: Path, cache: Path, tmp_path: Path) -> None:
    keys = SHORT | {"iterations": 5000, "octaves": 1}
    commands.write_recipe(Shot((Goal("tag", "net"),), frames=(7, 7), keys=keys), tmp_path / "shot.toml")
    out = tmp_path / "out"
    job = Job(commands.stylize_command(program, cache, tmp_path / "shot.toml", out), tmp_path / "job.log")
    followed(job, until="octave 1/1, frame 7")
    job.cancel()
    while not job.finished:
        time.sleep(0.01)
    assert job.exit_code == 3 and job.error is None
    assert json.loads((out / "run.json").read_text())["status"] == "interrupted"
    resumed = Job(commands.resume_command(program, out), tmp_path / "resumed.log")
    followed(resumed, until="octave 1/1, frame 7")
    resumed.cancel()
    while not resumed.finished:
        time.sleep(0.01)
    assert resumed.exit_code == 3


def test_a_batch_is_followed_to_its_results(program: Path, cache: Path, tmp_path: Path) -> None:
    """Shots as timeline markers make them."""
    recipes = []
    for name, last in (("one", 7), ("two", 9)):
        recipes.append(tmp_path / f"{name}.toml")
        commands.write_recipe(Shot((Goal("tag", "net"),), frames=(last, last), keys=SHORT), recipes[-1])
    out = tmp_path / "out"
    job = Job(commands.batch_command(program, cache, recipes, out), tmp_path / "job.log")
    seen = followed(job)
    assert (job.exit_code, job.error) == (0, None), job.log.read_text()
    assert any(progress.text.startswith("run 2/2, ") for progress in seen)
    fractions = [progress.fraction for progress in seen if progress.fraction is not None]
    assert fractions == sorted(fractions)
    for recipe in recipes:
        assert len(list((commands.batch_folder(out, recipe, cache) / "density").glob("*.vdb"))) == 1
