"""Stylizations, pictures and comparisons through the camera of a shot."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from command_line import Run, refused, run
from moving_smoke import moving_smoke
from PIL import Image

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.geometry.placement import Placement
from tnst_mi.io import save_frames
from tnst_mi.io.cameras.scene_camera import looking
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.camera import Camera
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer
from tnst_mi.rendering.studio import Smoke, Studio
from tnst_mi.run.difference_pictures import MainViews, write_pictures
from tnst_mi.run.job import Run as Job
from tnst_mi.run.prepare import prepare

__all__ = ["run"]

RECIPE = {"style": ["spirals"], "weights": "patterns", "octaves": 1, "iterations": 2, "views": 2, "gamma": 0.3}


def smoke(corner: float = 0.0) -> list[Frame]:
    """Two frames in a scene whose z is up, 0.1 units a cell."""
    return [
        Frame(
            frame.density, frame.velocity, name=frame.name, number=frame.number, placement=Placement(0.1, (corner,) * 3)
        )
        for frame in moving_smoke(2)
    ]


def orbit(frame: Frame, degrees: float, height: float, radius: float) -> tuple[list[float], list[float]]:
    """A place around the middle of a frame's grid, in its scene, and that middle."""
    depth, rows, columns = frame.density.shape
    corner = frame.placement.corner
    middle = np.array(corner) + 0.05 * (np.array([columns, depth, rows]) - 1)
    angle = math.radians(degrees)
    place = middle + np.array([radius * math.sin(angle), -radius * math.cos(angle), height])
    return place.tolist(), middle.tolist()


def shot(folder: Path, frames: list[Frame], lens: dict[str, float], **keys: Any) -> str:
    """A camera that goes from 30° to 40°, and looks at the middle unless told otherwise."""
    tables = {}
    for frame, degrees in zip(frames, (30.0, 40.0), strict=True):
        position, target = orbit(frame, degrees, 2.0, 8.0)
        tables[str(frame.number)] = {"position": position, "target": target, "aspect": 1.25} | lens | keys
    (folder / "shot.json").write_text(json.dumps({"up_axis": "z", "frames": tables}), "utf-8")
    return str(folder / "shot.json")


def test_an_orthographic_shot_is_a_view_by_its_angles(tmp_path: Path) -> None:
    """Oracle: the same views as ranges of angles."""
    frames = smoke()
    elevation = math.degrees(math.atan2(2, 8))
    through = tnst_mi.stylize(frames, RECIPE | {"camera": shot(tmp_path, frames, {"height": 3.0})}, progress=False)
    for index, azimuth in enumerate((30.0, 40.0)):
        angles = {"azimuth": [azimuth - 10, azimuth + 10], "elevation": [elevation - 5, elevation + 5]}
        alone = tnst_mi.stylize(frames[index], RECIPE | angles, progress=False)
        factor = through.run["density_scale"] / alone.run["density_scale"]
        assert factor == pytest.approx(1, abs=0.05)
        assert through.run["shots"][frames[index].name] == pytest.approx([azimuth, elevation])
    angles = {"azimuth": {"5": [20, 40], "6": [30, 50]}, "elevation": [elevation - 5, elevation + 5]}
    typed = tnst_mi.stylize(frames, RECIPE | angles, progress=False)
    assert "shots" not in typed.run
    for seen, expected, frame in zip(through.densities, typed.densities, frames, strict=True):
        change = np.abs(expected - frame.density).max()
        assert change > 0.01
        np.testing.assert_allclose(seen, expected, atol=1e-3 * change)


def test_zoom_pan_roll_and_shift_leave_the_stylization_alone(tmp_path: Path) -> None:
    """Paper 4.1: the smoke is framed and centred in every view, so only where the camera stands counts."""
    frames = smoke()
    plain = tnst_mi.stylize(frames, RECIPE | {"camera": shot(tmp_path, frames, {"fov": 30.0})}, progress=False)
    other = {"target": [0.3, 0.2, 1.9], "up": [0.5, 0.1, 1.0], "shift": [0.2, -0.1]}
    again = tnst_mi.stylize(frames, RECIPE | {"camera": shot(tmp_path, frames, {"fov": 55.0}, **other)}, progress=False)
    for one, two in zip(plain.densities, again.densities, strict=True):
        np.testing.assert_array_equal(one, two)


def test_images_of_a_run_are_the_perspective_view_from_the_camera(tmp_path: Path) -> None:
    frames = smoke()
    recipe = RECIPE | {"camera": shot(tmp_path, frames, {"fov": 30.0})}
    result = tnst_mi.stylize(frames, recipe, tmp_path / "out", progress=False)
    distance = math.hypot(2, 8) / 0.1
    for frame, azimuth, record in zip(frames, (30.0, 40.0), result.run["frames"], strict=True):
        view = azimuth, math.degrees(math.atan2(2, 8)), distance
        assert result.run["shots"][frame.name] == pytest.approx(view)
        density = frame.density * np.float32(result.run["density_scale"])
        renderer = EmissionAbsorptionRenderer(density.shape, 0.3, "paper", 1.0)
        expected = record["exposure"] * renderer.render(mi.TensorXf(density), [view]).numpy()[0]
        with OpenEXR.File(str(tmp_path / "out" / "images" / f"{frame.name}_before.exr")) as file:
            image = np.array(file.channels()["Y"].pixels)
            assert file.header()["view"] == pytest.approx(view, rel=1e-6)
        np.testing.assert_allclose(image, expected, atol=1e-5)


def test_a_run_is_resumed_with_the_same_camera_and_place_alone(tmp_path: Path) -> None:
    frames, out = smoke(), tmp_path / "out"
    recipe = Recipe.from_dict(RECIPE | {"camera": shot(tmp_path, frames, {"fov": 30.0})})
    job = Job(prepare(frames, recipe, out), progress=False)
    next(job)
    job.close()
    assert Recipe.from_toml(out / "recipe.toml").camera == recipe.camera
    with pytest.raises(InputError, match="saw the smoke from elsewhere"):
        prepare(smoke(0.5), recipe, out, resume=True)
    (tmp_path / "still.json").write_text((tmp_path / "shot.json").read_text("utf-8"), "utf-8")
    with pytest.raises(InputError, match="its run had camera = "):
        prepare(frames, Recipe.from_dict(RECIPE | {"camera": str(tmp_path / "still.json")}), out, resume=True)
    list(Job(prepare(frames, recipe, out, resume=True), progress=False))
    shot(tmp_path, frames, {"fov": 31.0})
    with pytest.raises(InputError, match=r"its run had another .*shot\.json"):
        prepare(frames, recipe, out, resume=True)


def test_a_camera_is_found_from_the_recipes_folder_and_named_after_a_hash(tmp_path: Path) -> None:
    shot(tmp_path, smoke(), {"fov": 30.0})
    (tmp_path / "r.toml").write_text('camera = "shot.json"\n', "utf-8")
    assert Recipe.from_toml(tmp_path / "r.toml").camera == str(tmp_path / "shot.json")
    (tmp_path / "r.toml").write_text('camera = "shot.json#main"\n', "utf-8")
    assert Recipe.from_toml(tmp_path / "r.toml").camera == f"{tmp_path / 'shot.json'}#main"
    (tmp_path / "r.toml").write_text('camera = "none.json"\n', "utf-8")
    with pytest.raises(InputError, match=r"camera = 'none\.json': no such file"):
        Recipe.from_toml(tmp_path / "r.toml")


def stored(folder: Path) -> Path:
    """The same frames as files without a place in a scene, in cells with y up, and a camera for them."""
    frames = [Frame(frame.density, name=frame.name, number=frame.number) for frame in moving_smoke(2)]
    save_frames(folder / "smoke", frames)
    tables = {}
    for frame, degrees in zip(frames, (30.0, 40.0), strict=True):
        middle = (np.array(frame.density.shape[::-1]) - 1) / 2
        angle = math.radians(degrees)
        place = middle + np.array([50 * math.sin(angle), 20, 50 * math.cos(angle)])
        tables[str(frame.number)] = {"position": place.tolist(), "target": middle.tolist()}
    (folder / "shot.json").write_text(json.dumps({"fov": 40, "aspect": 1.5, "frames": tables}), "utf-8")
    return folder / "smoke"


def test_render_shows_the_framing_of_the_shot(run: Run, tmp_path: Path) -> None:
    folder, out = stored(tmp_path), tmp_path / "out"
    ran = run("render", folder, "--out", out, "--camera", tmp_path / "shot.json", "--resolution", "60x40")
    assert ran.code == 0, ran.errors
    names = [frame.name for frame in moving_smoke(2)]
    assert {path.name for path in out.iterdir()} == {
        f"{name}_camera.{ending}" for name in names for ending in ("png", "exr")
    }
    images = []
    for name in names:
        with OpenEXR.File(str(out / f"{name}_camera.exr")) as file:
            images.append(np.array(file.channels()["Y"].pixels))
    assert images[0].shape == (40, 60) and max(image.max() for image in images) == pytest.approx(1)
    # Smoke that fills the view at a distance of 54 cells: its middle is in the middle, and its size that of its angle.
    rows, columns = np.indices((40, 60))
    density = moving_smoke(2)[0].density
    z, y, x = (np.arange(n) - (n - 1) / 2 for n in density.shape)
    mass = density.sum()
    centre = np.array([(density * c).sum() / mass for c in (x, y[:, None], z[:, None, None])])
    angle, rise = math.radians(30), math.atan2(20, 50)
    right = np.array([math.cos(angle), 0, -math.sin(angle)])
    up = np.array([-math.sin(angle) * math.sin(rise), math.cos(rise), -math.cos(angle) * math.sin(rise)])
    ahead = math.hypot(20, 50) - centre @ np.cross(right, up)
    per_pixel = 2 * ahead * math.tan(math.radians(20)) / 40
    seen = [float((images[0] * c).sum() / images[0].sum()) for c in (columns - 29.5, 19.5 - rows)]
    np.testing.assert_allclose(seen, [centre @ right / per_pixel, centre @ up / per_pixel], atol=0.6)


def test_a_look_is_lit_in_the_framing_of_the_shot(run: Run, tmp_path: Path) -> None:
    """Oracle: the studio, with the camera of each frame worked out here."""
    folder, out = stored(tmp_path), tmp_path / "out"
    few = ("--look", "thin", "--spp", 2, "--density-scale", 1, "--integrator", "prbvolpath")
    ran = run("render", folder, "--out", out, "--camera", tmp_path / "shot.json", "--resolution", "60x40", *few)
    assert ran.code == 0, ran.errors
    (time,) = (line for line in ran.errors if line.startswith("2 pictures in about "))
    assert time.endswith(f", written to {out}")
    frames = moving_smoke(2)
    cameras = []
    for degrees in (30.0, 40.0):
        angle = math.radians(degrees)
        place = np.array([50 * math.sin(angle), 20.0, 50 * math.cos(angle)])
        cameras.append(Camera(looking(place, np.zeros(3), np.array([0.0, 1.0, 0.0])), True, 40.0, 1.5))
    studio = Studio("thin", "prbvolpath", Smoke.of([frame.density for frame in frames]), cameras, (60, 40))
    assert len(list(out.iterdir())) == 4
    for number, (frame, camera) in enumerate(zip(frames, cameras, strict=True)):
        with OpenEXR.File(str(out / f"{frame.name}_camera.exr")) as file:
            image, header = np.array(file.channels()["RGB"].pixels), dict(file.header())
        expected = studio.render(frame.density, camera, 2, (0, number))
        np.testing.assert_allclose(image, expected, rtol=1e-3, atol=1e-5)
        assert header["camera"] == str(tmp_path / "shot.json")
        assert header["look"] == "thin" and header["integrator"] == "prbvolpath" and "view" not in header
        assert (out / f"{frame.name}_camera.png").exists()
    # Without --resolution a picture has the rows of the grid.
    arguments = ("--frames", "5", "--camera", tmp_path / "shot.json", "--out", tmp_path / "small", *few)
    assert run("render", folder, *arguments).code == 0
    (small,) = (tmp_path / "small").glob("*.exr")
    with OpenEXR.File(str(small)) as file:
        rows = frames[0].density.shape[1]
        assert np.array(file.channels()["RGB"].pixels).shape == (rows, round(1.5 * rows), 3)


@pytest.mark.parametrize(
    ("place", "line"),
    [
        ([6, 6, 6], r"the camera is inside the box of the smoke.*; move it away, or leave the look out"),
        ([6, -20, 60], r"the camera is below the studio's ground, which lies under the grid; raise it"),
    ],
)
def test_a_camera_that_cannot_stand_in_the_studio_is_refused_with_its_frame(
    run: Run, tmp_path: Path, place: list[float], line: str
) -> None:
    folder = stored(tmp_path)
    shot = json.loads((tmp_path / "shot.json").read_text("utf-8"))
    shot["frames"]["6"]["position"], shot["frames"]["6"]["target"] = place, [7, 7, 7]
    (tmp_path / "shot.json").write_text(json.dumps(shot), "utf-8")
    name, file = moving_smoke(2)[1].name, tmp_path / "shot.json"
    refused(
        run,
        tmp_path,
        ["render", folder, "--out", tmp_path / "out", "--look", "thin", "--camera", file],
        rf"^tnst-mi: {file}: {name}: {line}",
    )


@pytest.mark.parametrize(
    ("flags", "line"),
    [
        (["--resolution", "60x60"], "the camera's pictures are 1.5 times as wide as high, such as 90x60"),
        (["--resolution", "89x60"], "the camera's pictures are 1.5 times as wide as high, such as 90x60"),
        (["--views", "10,0"], "both say from where; give one"),
        (["--fit"], "a shot has its own framing"),
        (["--turntable", "3"], "a shot has its own framing"),
    ],
)
def test_render_refuses_what_a_shot_decides(run: Run, tmp_path: Path, flags: list[str], line: str) -> None:
    folder = stored(tmp_path)
    ran = run("render", folder, "--out", tmp_path / "out", "--camera", tmp_path / "shot.json", *flags)
    assert ran.code == 2 and line in ran.errors[-1] and not (tmp_path / "out").exists()


def test_compare_takes_the_view_of_a_stylization(run: Run, tmp_path: Path) -> None:
    folder, out = stored(tmp_path), tmp_path / "out"
    few = ("--quick", "--spp", 32, "--directions", 3, "--gamma", 0.3)
    ran = run("compare", folder, "--out", out, "--camera", tmp_path / "shot.json", *few)
    assert ran.code in (0, 1), ran.errors
    (view,) = json.loads((out / "report.json").read_text("utf-8"))["settings"]["views"]
    assert view == pytest.approx([30.0, math.degrees(math.atan2(20, 50)), math.hypot(20, 50)])
    ran = run("compare", folder, "--out", tmp_path / "b", "--camera", tmp_path / "shot.json", "--flip", "x", *few)
    assert ran.code == 2 and "flip = 'x' mirrors the smoke" in ran.errors[-1]


def test_a_run_says_that_its_camera_is_inside_the_grid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = smoke()
    depth, rows, columns = frames[0].density.shape
    middle = 0.05 * (np.array([columns, depth, rows]) - 1)
    keys = {
        "position": (middle + np.array([0.2, -0.3, 0.1])).tolist(),
        "target": middle.tolist(),
        "fov": 60,
        "aspect": 1,
    }
    (tmp_path / "in.json").write_text(json.dumps(keys), "utf-8")
    result = tnst_mi.stylize(frames[0], RECIPE | {"camera": str(tmp_path / "in.json")}, progress=True)
    said = capsys.readouterr().err
    assert (
        f"warning: {frames[0].name}: the camera is inside the grid; the smoke is seen from where its direction" in said
    )
    # Along (0.2, 0.1, 0.3) in our axes, the side z of the grid is reached first.
    (view,) = result.run["shots"].values()
    assert view[2] == pytest.approx(depth / 2 * math.sqrt(0.2**2 + 0.1**2 + 0.3**2) / 0.3)


def test_two_runs_are_compared_from_where_the_shot_saw_them(run: Run, tmp_path: Path) -> None:
    """The wipe of a run with itself is its main view, which is not the front; without the camera's file, it is said."""
    frames = smoke()
    camera, out = shot(tmp_path, frames, {"fov": 30.0}), tmp_path / "a"
    tnst_mi.stylize(frames, RECIPE | {"camera": camera}, out, progress=False)
    assert run("diff", out, out, "--out", tmp_path / "d").code == 0
    record = json.loads((out / "run.json").read_text())
    with Image.open(tmp_path / "d" / f"{frames[1].name}_wipe.png") as picture:
        wiped = np.asarray(picture.convert("L"))
    pictures = {}
    result = tnst_mi.load_frames(out / "density")[1]
    for view in (tuple(record["shots"][frames[1].name]), None):
        views = MainViews(Recipe.from_toml(out / "recipe.toml"), record["density_scale"])
        for index, frame in enumerate(tnst_mi.load_frames(out / "density")):
            views.add(frame, frame, view if index == 1 else tuple(record["shots"][frame.name]))
        density = record["density_scale"] * result.density
        expected = tnst_mi.render(density, view or (0.0, 0.0), record["frames"][1]["gamma"])
        np.testing.assert_allclose(views.pairs[1][0], expected, rtol=1e-5, atol=1e-6)
        names = [frame.name for frame in frames]
        (tmp_path / str(view)).mkdir()
        write_pictures(tmp_path / str(view), ("a", "a"), names, views, 24.0)
        with Image.open(tmp_path / str(view) / f"{names[1]}_wipe.png") as picture:
            pictures[view] = np.asarray(picture.convert("L"))
    shown, front = (picture[-400:] for picture in pictures.values())
    assert np.array_equal(wiped[-400:], shown) and not np.array_equal(shown, front)
    Path(camera).unlink()
    refused(run, tmp_path, ["diff", out, out], "shot.json.*: no such file")


def test_going_on_notices_that_the_smoke_stands_elsewhere(tmp_path: Path) -> None:
    frames = smoke()
    keys = RECIPE | {"camera": shot(tmp_path, frames, {"fov": 30.0}), "octaves": 2}
    tnst_mi.stylize(frames, keys | {"quality": "draft"}, tmp_path / "draft", progress=False)
    with pytest.raises(InputError, match="draft: its run saw the smoke from elsewhere than the camera does now"):
        tnst_mi.stylize(smoke(0.2), keys, tmp_path / "final", start_from=tmp_path / "draft", progress=False)
