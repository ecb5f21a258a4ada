"""`tnst-mi show`: which panels are shown, where they are written, and what is said before."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from command_line import Run as RunCommand
from command_line import refused, run, smoke
from jobs import optimiser
from PIL import Image

import tnst_mi
from tnst_mi.commands import show
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.machine import blender
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.camera import Viewpoint
from tnst_mi.rendering.pictures import PathTracedPainter
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare

__all__ = ["optimiser", "run", "smoke"]

QUICK = ("--spp", "2", "--resolution", "40x40", "--look", "thick")
RECIPE = Recipe(style=("spirals",), gamma=0.3, octaves=1, iterations=1)


def stylized(source: Path, out: Path, recipe: Recipe = RECIPE) -> Path:
    """A run that doubles densities."""
    list(Run(prepare(source, recipe, out), progress=False))
    return out


def through(folder: Path, **place: tuple[float, float, float]) -> Recipe:
    """A recipe with a camera that looks at the middle of the grid, from a place for frame 9, in cells from there."""
    middle = (np.array([5, 6, 4]) - 1) / 2
    lines = ["fov = 30", "aspect = 1"]
    for number in (7, 8, 9):
        position = middle + place.get(f"frame_{number}", (0.0, 0.0, 60.0))
        lines += [f"[frames.{number}]", f"position = {position.tolist()}", f"target = {middle.tolist()}"]
    (folder / "shot.toml").write_text("\n".join(lines), "utf-8")
    return replace(RECIPE, camera=str(folder / "shot.toml"))


def panels(file: Path, count: int) -> list[np.ndarray]:
    """The pictures of 40 × 40 pixels in a row."""
    with Image.open(file) as opened:
        sheet = np.asarray(opened, np.float32) / 255
    assert sheet.shape == (40 + 14, count * 40 + (count - 1) * 2, 3)
    return [sheet[14:, 42 * i : 42 * i + 40] for i in range(count)]


@pytest.mark.usefixtures("optimiser")
def test_a_run_is_shown_before_and_after(run: RunCommand, smoke: Path, tmp_path: Path) -> None:
    runs, out = [stylized(smoke, tmp_path / name) for name in "ab"], tmp_path / "shown.png"
    # The second run has taken the smoke away.
    for frame in tnst_mi.load_frames(smoke):
        save_frames(runs[1] / "density", replace(frame, density=0 * frame.density, velocity=None))
    ran = run("show", *runs, "--out", out, *QUICK)
    assert ran.code == 0, ran.errors
    assert ran.out == f"picture   {out}\n"
    (time,) = (line for line in ran.errors if line.startswith("3 × 40x40 in about "))
    assert time.endswith(f" s, written to {out}") and ran.errors.index(time) < len(ran.errors) - 1
    # One input before two runs; the last frame of all, which is the densest.
    before, after, empty = panels(out, 3)
    assert before[:, 20].std() > 1.2 * empty[:, 20].std()
    assert abs(after - empty).mean() > abs(before - empty).mean() > 0.01
    refused(run, tmp_path, ["show", *runs, "--out", out, *QUICK], "shown.png: is there already; .* --overwrite")
    assert run("show", runs[0], "--out", out, "--overwrite", *QUICK).code == 0
    panels(out, 2)


@pytest.mark.usefixtures("optimiser")
def test_frames_and_turntables_are_films(run: RunCommand, smoke: Path, tmp_path: Path) -> None:
    out = stylized(smoke, tmp_path / "a")
    for flags, count in ((("--frames", "7:8"), 2), (("--turntable", "3", "--frames", "7:9"), 3)):
        film = tmp_path / f"film{count}.mp4"
        ran = run("show", out, "--out", film, *QUICK, *flags)
        assert ran.code == 0, ran.errors
        assert ran.out == f"video   {film}\n"
        assert any(line.startswith(f"2 × 40x40, {count} pictures in about ") for line in ran.errors)
        reader = imageio_ffmpeg.read_frames(str(film))
        assert next(reader)["size"] == (82, 54) and len(list(reader)) == count
    refused(run, tmp_path, ["show", out, "--frames", "7:8", "--out", "x.png"], r"x\.png: expected .* \.mp4, for 2 pict")
    refused(run, tmp_path, ["show", out, "--out", "x.mp4"], r"x\.mp4: expected a name that ends in \.png, for one pic")
    refused(run, tmp_path, ["show", out, "--frames", "20:30"], "--frames 20:30: selects none; .* are 7, 8, 9")


@pytest.fixture
def viewpoints(monkeypatch: pytest.MonkeyPatch) -> list[Viewpoint]:
    """From where the pictures of the last command are rendered."""
    seen: list[Viewpoint] = []

    class Watched(PathTracedPainter):
        def paint(self, frame: Frame, viewpoint: Viewpoint, number: int) -> np.ndarray:
            seen.append(viewpoint)
            return super().paint(frame, viewpoint, number)

    monkeypatch.setattr(show, "PathTracedPainter", Watched)
    return seen


@pytest.mark.usefixtures("optimiser")
def test_a_run_is_shown_from_where_the_camera_of_its_shot_stands(
    run: RunCommand, smoke: Path, tmp_path: Path, viewpoints: list[Viewpoint]
) -> None:
    angle = math.radians(70)
    recipe = through(tmp_path, frame_8=(14 * math.sin(angle), 5.0, 14 * math.cos(angle)))
    folder = stylized(smoke, tmp_path / "a", recipe)
    assert run("show", folder, "--out", tmp_path / "film.mp4", *QUICK, "--frames", "7:8").code == 0
    first, second = (0.0, 0.0, 60.0), (70.0, math.degrees(math.atan2(5, 14)), math.hypot(5, 14))
    assert len(viewpoints) == 4, "before and after, twice"
    for found, expected in zip(viewpoints, (first, first, second, second), strict=True):
        assert found == pytest.approx(expected, abs=1e-9)
    viewpoints.clear()
    # A turn begins there, at the distance of the studio.
    turn = ("--turntable", "2", "--frames", "8:8")
    assert run("show", folder, "--out", tmp_path / "turn.mp4", *QUICK, *turn).code == 0
    for found, azimuth in zip(viewpoints[::2], (70, 250), strict=True):
        assert found == pytest.approx((azimuth, second[1]))


@pytest.mark.usefixtures("optimiser")
def test_a_shot_that_cannot_be_taken_in_the_studio_is_shown_from_its_distance(
    run: RunCommand, smoke: Path, tmp_path: Path, viewpoints: list[Viewpoint]
) -> None:
    recipe = through(tmp_path, frame_8=(0.0, -30.0, 30.0), frame_9=(2.01, 1.0, 2.01))
    folder = stylized(smoke, tmp_path / "a", recipe)
    ran = run("show", folder, "--out", tmp_path / "film.mp4", *QUICK, "--frames", "7:9")
    assert ran.code == 0, ran.errors
    assert [line for line in ran.errors if line.startswith("note: f_")] == [
        "note: f_08 and 1 more: the shot's camera is below the studio's ground, or too near to show all of the grid; "
        "shown from its azimuth, at the studio's distance"
    ]
    assert viewpoints[2] == pytest.approx((0.0, 0.0))
    assert viewpoints[4] == pytest.approx((45.0, math.degrees(math.atan(1 / math.hypot(2.01, 2.01)))))
    record = json.loads((folder / "run.json").read_text("utf-8"))
    (folder / "run.json").write_text(json.dumps(record | {"shots": {"f_07": [1, 2, -3]}}), "utf-8")
    refused(run, tmp_path, ["show", folder, "--out", tmp_path / "x.png", *QUICK], r"run\.json: damaged")


def test_fire_is_shown_unless_it_is_put_out(run: RunCommand, tmp_path: Path) -> None:
    flame = np.zeros((5, 6, 5), np.float32)
    flame[2, 2, 2] = 1.0
    save_frames(tmp_path / "f.npz", Frame(np.full(flame.shape, 0.1), grids={"flame": flame}))
    shown = []
    for choice in ((), ("--fire", "none")):
        ran = run(
            "show", tmp_path / "f.npz", "--out", tmp_path / f"{len(choice)}.png", *QUICK, "--look", "thin", *choice
        )
        assert ran.code == 0, ran.errors
        assert ("fire: grid flame as a flame, up to 1" in ran.errors) == (not choice)
        shown += panels(tmp_path / f"{len(choice)}.png", 1)
    assert (shown[0] - shown[1])[..., 0].max() > 0.1


def test_smoke_is_shown_in_its_colour(run: RunCommand, tmp_path: Path) -> None:
    smoke = np.full((5, 6, 5), 0.5, np.float32)
    colour = np.broadcast_to(np.float32([1, 0, 0]), (*smoke.shape, 3))
    save_frames(tmp_path / "f.npz", Frame(smoke, grids={"Cd": colour}))
    shown = []
    for choice in ((), ("--colour", "none")):
        ran = run("show", tmp_path / "f.npz", "--out", tmp_path / f"{len(choice)}.png", *QUICK, *choice)
        assert ran.code == 0, ran.errors
        assert any(line.startswith("colour: grid Cd times") for line in ran.errors) == (not choice)
        shown += panels(tmp_path / f"{len(choice)}.png", 1)
    assert (shown[1] - shown[0])[..., 2].max() > 0.3


def test_what_cannot_be_shown(run: RunCommand, smoke: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save_frames(tmp_path / "flat.npz", Frame(np.ones((1, 6, 5)), name="f_09"))
    for arguments, message in (
        ([], "show: expected one or more runs or densities"),
        (["nowhere"], "nowhere: no such file"),
        ([smoke / "f_09.npz", "flat.npz"], r"flat: has grids of \(1, 6, 5\) cells .* beside it \(4, 6, 5\): show them"),
        ([smoke, "--look", "sooty"], "--look sooty: expected"),
        ([smoke, "--resolution", "9"], "--resolution 9: expected WIDTHxHEIGHT"),
        ([smoke, "--fire", "flame"], "--fire flame: no frame has such a grid"),
        ([smoke, "--colour", "Cd"], "--colour Cd: no frame has such a grid"),
    ):
        refused(run, tmp_path, ["show", *arguments], message)
    monkeypatch.setattr(blender.shutil, "which", lambda program: None)
    refused(run, tmp_path, ["show", smoke, "--blender"], "no program blender: install Blender")


@pytest.mark.skipif(shutil.which("blender") is None, reason="Blender is not installed")
def test_blender_shows_the_same_panels(run: RunCommand, tmp_path: Path) -> None:
    density = np.zeros((8, 9, 8), np.float32)
    density[2:6, 3:7, 2:5] = 1.0
    save_frames(tmp_path / "f.npz", Frame(density))
    shown = []
    for name, flags in (("studio", ()), ("blender", ("--blender",))):
        out = tmp_path / f"{name}.png"
        ran = run("show", tmp_path / "f.npz", "--out", out, *QUICK, "--look", "thin", "--spp", "32", *flags)
        assert ran.code == 0, ran.errors
        shown += panels(out, 1)
    np.testing.assert_allclose(shown[0].mean((0, 1)), shown[1].mean((0, 1)), rtol=0.05)
