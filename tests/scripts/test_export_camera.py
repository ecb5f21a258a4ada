"""scripts/export_camera.py against the projection by which Blender renders the same cameras."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import export_camera
import numpy as np
import pytest

from tnst_mi.io.cameras.reading import read_cameras

SCRIPT = Path(export_camera.__file__)
needs_blender = pytest.mark.skipif(shutil.which("blender") is None, reason="the program blender is not installed")

#: A scene with a camera on a turned and scaled rig that moves and zooms, a still orthographic one, and a turned box;
#: and what Blender says of points: where they are in the picture, and in the box's axes.
SCENE = """
import json, math, sys
import bpy
from mathutils import Vector
out, told = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.frame_start, scene.frame_end = 3, 5
scene.render.resolution_x, scene.render.resolution_y = 640, 400
scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = 1.0, 1.25
def camera(name, kind, fit):
    data = bpy.data.cameras.new(name)
    data.type, data.sensor_fit = kind, fit
    data.sensor_width, data.sensor_height = 36.0, 20.0
    data.shift_x, data.shift_y = 0.1, -0.05
    item = bpy.data.objects.new(name, data)
    scene.collection.objects.link(item)
    return item
rig = bpy.data.objects.new("rig", None)
rig.rotation_euler, rig.scale = (0.2, -0.1, 0.4), (2.0, 2.0, 2.0)
scene.collection.objects.link(rig)
moving = camera("moving", "PERSP", "AUTO")
moving.parent = rig
moving.rotation_euler = (math.radians(75), 0.1, 0.3)
for frame, place, lens in ((3, (2.0, -6.0, 3.0), 30.0), (5, (3.0, -4.0, 2.0), 50.0)):
    moving.location, moving.data.lens = place, lens
    moving.keyframe_insert("location", frame=frame)
    moving.data.keyframe_insert("lens", frame=frame)
flat = camera("flat", "ORTHO", "VERTICAL")
flat.data.ortho_scale = 7.0
flat.location, flat.rotation_euler = (5.0, -5.0, 4.0), (1.0, 0.1, 0.7)
tall = camera("tall", "PERSP", "VERTICAL")
tall.location, tall.rotation_euler = (5.0, -5.0, 4.0), (1.0, 0.1, 0.7)
wide = camera("wide", "PANO", "AUTO")
box = bpy.data.objects.new("box", bpy.data.meshes.new("box"))
box.location, box.rotation_euler, box.scale = (1.0, 1.0, 1.5), (0.0, 0.0, 0.5), (2.0, 3.0, 4.0)
scene.collection.objects.link(box)
scene.camera = moving
points = [Vector(p) for p in ((0, 0, 0), (1, 0.5, 2), (-1, 2, 1), (0.3, -0.7, 1.1))]
def in_picture(item, point):
    render = scene.render
    onto = item.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(), x=render.resolution_x, y=render.resolution_y,
        scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y)
    clip = onto @ item.matrix_world.normalized().inverted() @ point.to_4d()
    return [0.5 + clip.x / clip.w / 2, 0.5 + clip.y / clip.w / 2]
seen = {}
for frame in (3, 4, 5):
    scene.frame_set(frame)
    bpy.context.view_layer.update()
    for item in (moving, flat, tall):
        seen[f"{item.name} {frame}"] = [in_picture(item, p) for p in points]
inside = box.matrix_world.normalized().inverted()
json.dump({"points": [list(p) for p in points], "in_box": [list(inside @ p) for p in points], "seen": seen},
          open(told, "w"))
bpy.ops.wm.save_as_mainfile(filepath=out)
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("scene")
    script, out, told = folder / "scene.py", folder / "scene.blend", folder / "told.json"
    script.write_text(SCENE, "utf-8")
    command = ["blender", "--background", "--factory-startup", "--python-exit-code", "1", "--python", str(script)]
    subprocess.run([*command, "--", str(out), str(told)], check=True, capture_output=True, timeout=300)
    return out, json.loads(told.read_text("utf-8"))


def export(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def in_picture(camera: Any, points: np.ndarray) -> np.ndarray:
    """Oracle: coordinates of points in the picture as Blender gives them: 0 at the lower left, 1 at the upper right."""
    local = (np.linalg.inv(camera.to_scene) @ np.concatenate([points, np.ones((len(points), 1))], axis=1).T).T[:, :3]
    half = np.full(len(points), camera.field / 2)
    if camera.perspective:
        half = np.tan(np.radians(camera.field) / 2) * -local[:, 2]
    from_middle = local[:, :2] / (2 * half[:, None]) + camera.shift
    return from_middle / [camera.aspect, 1.0] + 0.5


@needs_blender
@pytest.mark.parametrize("name", ["moving", "flat", "tall"])
def test_exported_cameras_see_points_where_blender_sees_them(
    scene: tuple[Path, dict[str, Any]], tmp_path: Path, name: str
) -> None:
    blend, told = scene
    chosen = [] if name == "moving" else ["--camera", name]
    done = export(blend, "--out", tmp_path / "shot.json", *chosen)
    words = "3 frames" if name == "moving" else "one for all frames"
    assert (done.returncode, done.stdout.strip()) == (0, f"cameras   {tmp_path / 'shot.json'}: {words}"), done.stderr
    cameras = read_cameras(str(tmp_path / "shot.json"))
    for frame in (3, 4, 5):
        seen = in_picture(cameras.at(frame, "z"), np.array(told["points"]))
        np.testing.assert_allclose(seen, told["seen"][f"{name} {frame}"], atol=2e-5)


@needs_blender
def test_cameras_relative_to_a_domain_see_what_is_in_its_axes(
    scene: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    blend, told = scene
    done = export(blend, "--out", tmp_path / "shot.json", "--relative-to", "box", "--frames", "4:5")
    assert done.returncode == 0, done.stderr
    cameras = read_cameras(str(tmp_path / "shot.json"))
    seen = in_picture(cameras.at(4, "z"), np.array(told["in_box"]))
    np.testing.assert_allclose(seen, told["seen"]["moving 4"], atol=2e-5)
    assert set(json.loads((tmp_path / "shot.json").read_text("utf-8"))["frames"]) == {"4", "5"}


@needs_blender
@pytest.mark.parametrize(
    ("flags", "line"),
    [
        (["--camera", "none"], "--camera none: no such object, the scene has "),
        (["--camera", "rig"], "rig: is no camera, but empty"),
        (["--camera", "wide"], "wide: is pano, expected a perspective or an orthographic camera"),
        (["--frames", "9:4"], "--frames 9:4: expected a first and a last frame, such as 1:120"),
    ],
)
def test_what_cannot_be_exported_is_one_line(
    scene: tuple[Path, dict[str, Any]], tmp_path: Path, flags: list[str], line: str
) -> None:
    done = export(scene[0], "--out", tmp_path / "shot.json", *flags)
    assert done.returncode == 2 and done.stderr.startswith(f"export_camera.py: {line}"), done.stderr
    assert done.stderr.count("\n") == 1 and not (tmp_path / "shot.json").exists()


def test_without_a_scene_or_blender_it_says_so(tmp_path: Path) -> None:
    done = export("--out", tmp_path / "shot.json")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1) and "no such file" in done.stderr
    (tmp_path / "a.blend").touch()
    done = export(tmp_path / "a.blend", "--out", tmp_path / "shot.json", "--blender", "no-such-blender")
    assert done.returncode == 2 and "no program no-such-blender: install Blender" in done.stderr
