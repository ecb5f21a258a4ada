"""Cameras by the rays of their pixels, and several pictures in a file, as the ScalarFlow data set has them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from render_views import FOV, camera_at, places, radius_around

import tnst_mi
from tnst_mi.cli import main
from tnst_mi.io.pictures.exr import read_exr
from tnst_mi.reconstruction.camera_sets.pixel_rays import read_ray_camera
from tnst_mi.reconstruction.preparation import prepare

#: Of the rays' pictures: (width, height); those of the pixels have half as many of each.
SIZE = (40, 40)


def rays_of(camera: tnst_mi.Camera, bent: float = 0.0, size: tuple[int, int] = SIZE) -> np.ndarray:
    """The lines of a file: rays of a scene whose z points the other way, as the authors have it; `bent` by a lens."""
    y, x = (n.ravel() for n in np.indices(size[::-1]))
    across = (x + 0.5 - size[0] / 2) * 2 / size[1], (y + 0.5 - size[1] / 2) * 2 / size[1]
    slope = math.tan(math.radians(FOV / 2)) * (1 + bent * (across[0] ** 2 + across[1] ** 2))
    own = np.stack([across[0] * slope, across[1] * slope, -np.ones(len(x))], axis=1)
    pose = np.array(camera.to_world)
    direction = own @ pose[:3, :3].T * [1, 1, -1]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    place = pose[:3, 3] * [1, 1, -1]
    start = place - direction * (place[2] / direction[:, 2:])
    return np.stack([x, y, start[:, 1], start[:, 0], direction[:, 1], direction[:, 0], direction[:, 2]], axis=1)


def write_rays(path: Path, rays: np.ndarray, size: tuple[int, int] = SIZE) -> Path:
    with path.open("w") as file:
        file.write(f"{size[0]} {size[1]}\n")
        np.savetxt(file, rays, "%d %d" + " %.9g" * 5)
    return path


@pytest.fixture(scope="module")
def captured(views, cloud, tmp_path_factory) -> Path:
    """The views of the cloud as a set of that layout, in files of twelve pictures, upside down; the depth is turned."""
    out = tmp_path_factory.mktemp("captured")
    text = "up_axis = 'y'\n[reconstruction]\nbox = [-5, -8, -6, 5, 8, 6]\ncells = 16\ngamma = 0.3\n"
    pictures = []
    for number, place in enumerate(places(12, radius_around(cloud.shape))):
        write_rays(out / f"{number + 1}_rays.txt", rays_of(camera_at(place)))
        pictures.append(read_exr(views.with_name(f"view_{number:02d}.exr"))[::-1, :, None])
        text += f"[views.cam{number + 1}]\nrays = '{number + 1}_rays.txt'\n"
        text += f"image = 'imgs_######.npz'\nlayer = {number}\n"
    np.savez_compressed(out / "imgs_000004.npz", data=np.array(pictures, np.float32))
    (out / "cameras.toml").write_text(text)
    return out / "cameras.toml"


def test_a_captured_set_has_the_same_cameras_and_pictures(captured, views, cloud):
    prepared = prepare(captured, {}, "4:4", None)
    photographs = prepared.photographs(4)
    for number, place in enumerate(places(12, radius_around(cloud.shape))):
        photograph, known = photographs[number], camera_at(place)
        assert np.allclose(photograph.camera.to_world, known.to_world, atol=1e-4)
        assert photograph.camera.field == pytest.approx(FOV, abs=1e-4) and photograph.camera.aspect == 1
        assert np.allclose(photograph.values, read_exr(views.with_name(f"view_{number:02d}.exr")), rtol=1e-6)
    assert any("left-handed, and its z is turned round" in remark for remark in prepared.remarks)


def test_the_pinhole_of_rays(tmp_path):
    """Of a camera off the middle that is turned about its axis; pixels may be missing, and some rays quite wrong."""
    known = camera_at(np.array([7.0, 5.0, -30.0]))
    turn = np.eye(4)
    turn[:2, :2] = [[0.6, -0.8], [0.8, 0.6]]
    known = tnst_mi.Camera(np.array(known.to_world) @ turn, True, FOV, 1.0)
    rays = rays_of(known)
    rng = np.random.default_rng(0)
    rays[rng.choice(len(rays), 40, replace=False), 4:] += rng.normal(0, 0.3, (40, 3))
    found = read_ray_camera(write_rays(tmp_path / "1_rays.txt", rays[rng.random(len(rays)) < 0.7]))
    assert found.turned and found.error < 1e-3
    assert np.allclose(found.camera.to_scene, known.to_world, atol=1e-3)
    assert found.camera.field == pytest.approx(FOV, abs=1e-3) and np.allclose(found.camera.shift, 0, atol=1e-4)
    # A part of the picture is the same camera with its axis elsewhere.
    part = rays[rays[:, 0] >= 20]
    part[:, 0] -= 20
    found = read_ray_camera(write_rays(tmp_path / "2_rays.txt", part, (20, 40)))
    assert np.allclose(found.camera.to_scene, known.to_world, atol=1e-3)
    assert found.camera.aspect == 0.5 and np.allclose(found.camera.shift, (-0.25, 0), atol=1e-4)


def test_how_far_a_lens_is_from_a_pinhole_is_told(tmp_path):
    camera = camera_at(np.array([0.0, 3.0, 30.0]))
    found = read_ray_camera(write_rays(tmp_path / "rays.txt", rays_of(camera, bent=0.02)))
    assert 0.02 < found.error < 0.4
    with pytest.raises(tnst_mi.InputError, match=r"pixels \(RMS\) from those of any pinhole"):
        read_ray_camera(write_rays(tmp_path / "rays.txt", rays_of(camera, bent=2.0)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rays = '2_rays.txt'", "rays = 'no.txt'", "no.txt: no such file"),
        ("layer = 3", "layer = 12", "imgs_000004.npz: holds 12 pictures, say which is the view's by layer, from 0"),
        ("layer = 3", "", "imgs_000004.npz: holds 12 pictures, say which is the view's by layer, from 0"),
        ("layer = 3", "layer = -1", "layer = -1: expected the number of a picture in its file, from 0"),
        ("layer = 3", "fov = 3", "fov: is of another camera than rays"),
        ("rays = '2_rays.txt'", "position = [0, 0, 40]\ntarget = [0, 0, 0]\nfov = 30", "mirror its picture"),
    ],
)
def test_mistakes_in_tables_are_told(captured, old, new, message, tmp_path, capsys):
    text = captured.read_text()
    assert f"{old}\n" in text
    wrong = captured.with_name("wrong.toml")
    wrong.write_text(text.replace(f"{old}\n", f"{new}\n", 1))
    assert main(["reconstruct", str(wrong), "--frames", "4:4", "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert message in told and told.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1080 many\n", "its first line is no width and height"),
        ("40 40\n1 2 3\n", "line 2: expected a pixel and its ray, seven numbers"),
        ("40 40\n1 2 0 0 0 0 0\n", "line 2: expected a pixel and its ray"),
        ("40 40\n1 2 0 0 0 0 nan\n", "line 2: expected a pixel and its ray"),
        ("40 40\n" + "1 2 0 0 0 0 1\n" * 5, "has 5 rays, expected at least 12"),
        ("40 40\n" + "40 2 0 0 0 0 1\n" * 20, "has pixels beyond its 40 × 40"),
        ("40 40\n1 2 0 0 0 1e-320 0\n", "line 2: its direction is 1e-320 long, expected about 1"),
        ("40 40\n1 2 0 0 1e200 1e300 -1e300\n", "line 2: its direction is 1.41e+300 long, expected about 1"),
        ("40 40\n1 2 0 -1e300 0 0 1\n", "line 2: its ray starts at 0, -1e+300, expected metres from the scene"),
        ("40 40\n" + "1 2 1e6 1e-6 1e-6 0 0\n" * 20, "from those of any pinhole"),
        ("40 40\n" + "1 2 0 0 0 0 1\n" * 20, "from those of any pinhole"),
    ],
)
def test_what_is_no_file_of_rays(text, message, tmp_path):
    (tmp_path / "rays.txt").write_text(text)
    with pytest.raises(tnst_mi.InputError, match=re.escape(message)):
        read_ray_camera(tmp_path / "rays.txt")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "line",
    [
        "{x} {y} {sy} {sx} 0 0 -1",  # parallel rays
        "{x} {y} 0 0 0 0 1",  # one ray for all pixels
        "1 1 0 0 {sy} {sx} -1",  # one pixel for all rays
        "{x} 0 0 0 0 {sx} -1",  # one line of pixels
        "{x} {y} 1e5 {x}e4 1e-6 {sx} 1e-5",
        "{x} {y} 0 0 {sy} {sx} 0",  # no ray leaves a plane
    ],
)
def test_rays_of_no_camera_are_refused_in_one_line_and_without_warnings(line, tmp_path, capfd):
    lines = [line.format(x=x, y=y, sx=(x - 8) / 20 or 1e-3, sy=(y - 8) / 20) for x in range(16) for y in range(16)]
    (tmp_path / "rays.txt").write_text("16 16\n" + "\n".join(lines))
    with pytest.raises(tnst_mi.InputError, match=r"rays\.txt: ") as told:
        read_ray_camera(tmp_path / "rays.txt")
    assert "\n" not in str(told.value) and capfd.readouterr() == ("", "")
