"""Files of cameras with pictures: what they say, and what is wrong with them in one line."""

from __future__ import annotations

import json
import math
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from render_views import FOV, camera_at, places, radius_around

import tnst_mi
from tnst_mi.cli import main
from tnst_mi.io.pictures.exr import read_exr, write_exr
from tnst_mi.reconstruction.preparation import prepare

BOX = (-5.0, -8.0, -6.0, 5.0, 8.0, 6.0)


def cameras_of(path: Path, box=BOX, **settings) -> list[tnst_mi.Camera]:
    """The cameras of a file, in cells."""
    prepared = prepare(path, {"box": list(box), "cells": 16, **settings}, None, None)
    return [photograph.camera for photograph in prepared.photographs(None)]


def test_our_tables_say_where_the_pictures_were_taken(views, cloud):
    expected = [camera_at(place) for place in places(12, radius_around(cloud.shape))]
    for camera, known in zip(cameras_of(views), expected, strict=False):
        assert np.allclose(camera.to_world, known.to_world, atol=1e-5)
        assert (camera.field, camera.aspect) == (known.field, known.aspect)


def test_a_nerf_gives_the_same_density_in_its_own_axes(views, cloud, tmp_path):
    """Its scene has z up: (x, y, z) of ours is (x, −z, y) there. The principal point is off the middle."""
    to_z_up = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    frames = []
    for number, place in enumerate(places(12, radius_around(cloud.shape))):
        image = read_exr(views.with_name(f"view_{number:02d}.exr"))
        # Two columns of nothing on the left, of which the principal point is two pixels farther.
        write_exr(tmp_path / f"{number}.exr", np.pad(image, ((0, 0), (2, 0))), {})
        matrix = to_z_up @ np.array(camera_at(place).to_world)
        frames.append({"file_path": f"{number}.exr", "transform_matrix": matrix.tolist()})
    focal = 10 / math.tan(math.radians(FOV / 2))
    values = {"fl_x": focal, "w": 22, "h": 20, "cx": 12, "cy": 10, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    keys = {"box": [-5, -6, -8, 5, 6, 8], "cells": 16, "gamma": 0.3, "iterations": 60, "levels": 1, "batch": 3}
    found = tnst_mi.reconstruct(tmp_path / "transforms.json", tmp_path / "out", keys, format="vdb", progress=False)
    (frame,) = tnst_mi.load_frames(found.densities[0])
    near = np.argwhere(frame.density > 0.5).mean(axis=0)
    placed = frame.placement.to_scene(frame.density.shape)(near[::-1])
    middle = np.argwhere(cloud > 0.5).mean(axis=0)[::-1] - (np.array(cloud.shape[::-1]) - 1) / 2
    assert np.allclose(placed, to_z_up[:3, :3] @ middle, atol=0.3)
    assert any("z up" in remark for remark in found.remarks)


def test_sensors_of_a_scene_see_what_their_cameras_see(tmp_path):
    """A point of light in front of Mitsuba's own sensors is where the camera has it."""
    (tmp_path / "scene.xml").write_text(
        """<scene version="3.0.0">
        <sensor type="perspective" id="left"><float name="fov" value="50"/><float name="principal_point_offset_x"
        value="0.1"/><transform name="to_world"><lookat origin="9,4,20" target="1,0,-1" up="0,1,0"/></transform>
        <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/></film></sensor>
        <sensor type="orthographic" id="top"><transform name="to_world"><scale value="12"/>
        <lookat origin="2,30,3" target="0,0,0" up="0,0,1"/></transform>
        <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/></film></sensor>
        </scene>"""
    )
    for name in ("left", "top"):
        write_exr(tmp_path / f"{name}.exr", np.ones((32, 48), np.float32), {})
    ball = {"type": "sphere", "center": [2.0, 3.0, 1.0], "radius": 0.4, "e": {"type": "area", "radiance": 1.0}}
    sensors = mi.load_file(str(tmp_path / "scene.xml")).sensors()
    for camera, sensor in zip(cameras_of(tmp_path / "scene.xml"), sensors, strict=True):
        scene = mi.load_dict({"type": "scene", "integrator": {"type": "direct"}, "ball": ball})
        seen = np.array(mi.render(scene, sensor=sensor, spp=16))[..., 0]
        rows, columns = np.nonzero(seen > 0.5)
        d = np.zeros((12, 16, 10), np.float32)
        d[(1 + 6), (3 + 8), (2 + 5)] = 1
        ours = tnst_mi.render(d, camera=camera, quadrature="exact", size=(32, 48))
        place = [(ours * n).sum() / ours.sum() for n in np.indices(ours.shape)]
        # The cell's middle is half a cell from the ball along each axis.
        assert np.hypot(place[0] - rows.mean(), place[1] - columns.mean()) < 2.0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("image = ", "# image = ", "view view_00: image: is not there, expected a file"),
        ("held_out = true", "heldout = true", "view held_out_00: unknown key 'heldout'; did you mean 'held_out'?"),
        ("fov = ", "fovv = ", "unknown key 'fovv'; did you mean 'fov'?"),
        (
            "image = ",
            "picture = ",
            "unknown key 'picture'; expected one of image, mask, background, held_out, rays, layer",
        ),
        ("fov = 36.0", "fov = 300", "fov = 300: expected a number from 0.01 to 179"),
        ("cells = 16", "cell = 16", "reconstruction: unknown key 'cell'; did you mean 'cells'?"),
        ("cells = 16", "cells = 1", "reconstruction: cells = 1: expected an integer from 4 to 2048"),
        ("box = ", "# box = ", "does not say where the smoke is; give the box around it"),
        ('"view_03.exr"', '"nowhere.exr"', "nowhere.exr: no such file"),
        ("resolution = [20, 20]", "resolution = [20, 30]", "view view_00: its camera has an aspect of 0.6667"),
        ("gamma = 0.3", 'gamma = "auto"\nbrightness = 2', "γ is found by the brightness 1/γ alone"),
        (
            "gamma = 0.3",
            'quadrature = "paper"\nbackground = "auto"',
            "no transmittance that a background could be seen",
        ),
        ("gamma = 0.3", 'channel = "alpha"', "view_00.exr: has no alpha"),
        ("[reconstruction]", "[[reconstruction]]", "reconstruction: is [{"),
        ("held_out = true", "held_out = 1", "held_out = 1: expected true or false"),
    ],
)
def test_mistakes_are_told_in_one_line(views, old, new, message, tmp_path, capsys):
    text = views.read_text()
    assert old in text
    (views.parent / "wrong.toml").write_text(text.replace(old, new))
    assert main(["reconstruct", str(views.parent / "wrong.toml"), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert message in told and told.count("\n") == 1
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").glob("*"))


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--hold-out", "1"], "--hold-out 1: leaves none of 15 views to use"),
        (["--frames", "3:1"], "--frames 3:1: expected FIRST:LAST"),
        (["--frames", "3:4"], "is the same picture for all frames; write ####"),
        (["--resume"], "no reconstruction to resume there"),
        (["--box", "0,0,0,1,1"], "--box 0,0,0,1,1: expected six numbers"),
        (["--format", "png"], "format = 'png': expected one of npz, vol, uni, vdb"),
        (["--integrator", "prbvolpath", "--background", "auto"], "background = auto: is of emission_absorption"),
    ],
)
def test_wrong_flags_are_told_in_one_line(views, flags, message, tmp_path, capsys):
    assert main(["reconstruct", str(views), "--out", str(tmp_path / "out"), *flags]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"k1": 0.1}, "k1 = 0.1: the lens distorts"),
        ({"fl_x": None}, "fl_x = None: expected a number"),
        ({"frames": {}}, 'expected the transforms.json of a NeRF, with a list "frames"'),
        ({"frames": [{"file_path": "a.png", "transform_matrix": [[1, 2]]}]}, "transform_matrix: expected 4 rows"),
    ],
)
def test_what_a_nerf_cannot_say(change, message, tmp_path, capsys):
    frames = [{"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}]
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 30, "w": 20, "h": 20, "frames": frames} | change))
    assert main(["reconstruct", str(tmp_path / "transforms.json"), "--out", str(tmp_path / "o"), "--cells", "8"]) == 2
    assert message in capsys.readouterr().err
