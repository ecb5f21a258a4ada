"""Files of cameras: what they mean, what they refuse, and USD against Pixar's own projection."""

from __future__ import annotations

import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.io.cameras.reading import file_and_name, read_cameras
from tnst_mi.io.cameras.scene_camera import SceneCamera

EYE = {"position": [3.0, -4.0, 2.0], "target": [0.0, 0.0, 1.0], "fov": 40.0, "aspect": 1.5}
MATRIX = [[0.0, 0.0, 1.0, 7.0], [1.0, 0.0, 0.0, 8.0], [0.0, 1.0, 0.0, 9.0], [0.0, 0.0, 0.0, 1.0]]


def written(folder: Path, values: Any, name: str = "shot.json") -> str:
    path = folder / name
    path.write_text(values if isinstance(values, str) else json.dumps(values), "utf-8")
    return str(path)


def one(folder: Path, table: Any, up: str = "z") -> SceneCamera:
    return read_cameras(written(folder, table)).at(1, up)


def seen(camera: SceneCamera, point: np.ndarray) -> np.ndarray:
    """Oracle: where a point is in the picture, right and up of its middle, in parts of its height."""
    local = np.linalg.inv(camera.to_scene) @ [*point, 1.0]
    half = math.tan(math.radians(camera.field) / 2) * -local[2] if camera.perspective else camera.field / 2
    return local[:2] / (2 * half) + camera.shift


def test_a_camera_looks_at_its_target_with_up_upwards(tmp_path: Path) -> None:
    camera = one(tmp_path, EYE)
    np.testing.assert_allclose(seen(camera, np.array([0.0, 0.0, 1.0])), 0, atol=1e-12)
    above, right = seen(camera, np.array([0.0, 0.0, 1.1])), seen(camera, np.array([0.08, 0.06, 1.0]))
    assert above[0] == pytest.approx(0, abs=1e-12) and above[1] > 0
    assert right[1] == pytest.approx(0, abs=1e-12) and right[0] > 0
    np.testing.assert_allclose(camera.to_scene[:3, 3], EYE["position"])


def test_the_vertical_field_of_view_ends_at_the_edge_of_the_picture(tmp_path: Path) -> None:
    camera = one(tmp_path, {"matrix": np.eye(4).tolist(), "fov": 40.0, "aspect": 1.5})
    assert seen(camera, np.array([0.0, math.tan(math.radians(20)), -1.0]))[1] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("lens", "degrees"),
    [
        ({"focal_length": 50, "sensor_height": 24, "aspect": 1.5}, 2 * math.degrees(math.atan(12 / 50))),
        (
            {"focal_length": 50, "sensor_width": 36, "resolution": [1920, 1080]},
            2 * math.degrees(math.atan(10.125 / 50)),
        ),
    ],
)
def test_a_focal_length_and_a_sensor_are_a_field_of_view(tmp_path: Path, lens: dict[str, Any], degrees: float) -> None:
    assert one(tmp_path, {"matrix": MATRIX} | lens).field == pytest.approx(degrees, abs=1e-6)


def test_an_orthographic_camera_has_a_height_and_a_shift(tmp_path: Path) -> None:
    camera = one(tmp_path, {"matrix": MATRIX, "height": 4, "aspect": 2, "shift": [0.25, -0.5]})
    assert (camera.perspective, camera.field, camera.aspect, camera.shift) == (False, 4.0, 2.0, (0.25, -0.5))


def test_matrices_lose_scale_and_rounding_alone(tmp_path: Path) -> None:
    turned = np.array(MATRIX)
    turned[:3, :3] *= 2.5
    turned[0, 0] = 1e-5
    camera = one(tmp_path, {"matrix": turned.tolist(), "fov": 30, "aspect": 1})
    rotation = camera.to_scene[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(camera.to_scene, MATRIX, atol=1e-5)


def test_axes_of_another_scene_are_turned(tmp_path: Path) -> None:
    """A camera in front (y up: at +z, looking along −z) is in front where z is up: at −y, looking along +y."""
    table = {"up_axis": "y", "position": [1, 2, 10], "target": [1, 2, 0], "fov": 30, "aspect": 1}
    camera = one(tmp_path, table, up="z")
    np.testing.assert_allclose(camera.to_scene[:3, 3], [1, -10, 2], atol=1e-12)
    np.testing.assert_allclose(-camera.to_scene[:3, 2], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(camera.to_scene[:3, 1], [0, 0, 1], atol=1e-12)
    back = camera.turned("z", "y")
    np.testing.assert_allclose(back.to_scene, one(tmp_path, table, up="y").to_scene, atol=1e-12)


def test_toml_and_json_are_the_same_and_frames_have_what_they_share(tmp_path: Path) -> None:
    toml = """
        up_axis = "z"
        fov = 40
        aspect = 1.5
        [frames.49]
        position = [3, -4, 2]
        target = [0, 0, 1]
        [frames."49.5"]
        position = [3, -4, 2.5]
        target = [0, 0, 1]
        fov = 30
    """
    cameras = read_cameras(written(tmp_path, toml, "shot.toml"))
    np.testing.assert_array_equal(cameras.at(49, "z").to_scene, one(tmp_path, EYE).to_scene)
    assert [cameras.at(number, "z").field for number in (49, 49.5)] == [40.0, 30.0]


def test_a_frame_without_a_camera_names_the_nearest(tmp_path: Path) -> None:
    cameras = read_cameras(written(tmp_path, {"frames": {"72": EYE, "49": EYE}}))
    for number, words in ((57, "nearest are 49 and 72"), (3, "nearest is 49"), (80, "nearest is 72")):
        with pytest.raises(InputError, match=rf"no camera for frame {number}; the {words}"):
            cameras.at(number, "z")
    with pytest.raises(InputError, match="have no numbers"):
        cameras.at(None, "z")
    assert read_cameras(written(tmp_path, EYE)).at(None, "z").field == 40.0


def test_the_example_of_the_docs_is_a_shot(tmp_path: Path) -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "cameras.md"
    (text,) = re.findall(r"```toml\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    cameras = read_cameras(written(tmp_path, text, "shot.toml"))
    assert [cameras.at(number, "z").field for number in (49, 50)] == [35.0, 36.0]


def test_a_camera_that_looks_along_the_axis_that_may_be_up(tmp_path: Path) -> None:
    """Where the file does not say which is, the smoke's files do."""
    level = {"position": [0.7, -9, 1], "target": [0.7, 0, 1], "fov": 30, "aspect": 1}
    camera = read_cameras(written(tmp_path, level)).at(None, "z")
    np.testing.assert_allclose(camera.to_scene[:3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-12)
    with pytest.raises(InputError, match="up = 0, 1, 0: is 0, or along the line from position to target"):
        read_cameras(written(tmp_path, level)).at(None, "y")
    with pytest.raises(InputError, match="up = 0, 1, 0"):
        read_cameras(written(tmp_path, level | {"up_axis": "y"}))


@pytest.mark.parametrize(
    ("table", "line"),
    [
        (EYE | {"zoom": 2}, "unknown key 'zoom'; the keys of a camera are matrix, "),
        (EYE | {"postion": 2}, "unknown key 'postion'; did you mean 'position'?"),
        (EYE | {"up_axs": "y"}, "unknown key 'up_axs'; did you mean 'up_axis'?"),
        ({"frame": {"1": EYE}}, "unknown key 'frame'; did you mean 'frames'?"),
        ({key: EYE[key] for key in ("position", "fov", "aspect")}, "has position, expected matrix, or position and"),
        (EYE | {"matrix": MATRIX}, "has matrix and position and target, expected matrix, or"),
        (EYE | {"focal_length": 50}, "has fov and focal_length, expected fov, or focal_length and"),
        ({key: EYE[key] for key in EYE if key != "fov"}, "has none of these, expected fov, or"),
        (EYE | {"resolution": [4, 3]}, "expected either aspect"),
        (EYE | {"fov": 180}, "fov = 180: expected a number from 0.01 to 179"),
        (EYE | {"fov": float("nan")}, "fov = nan: expected a number"),
        (EYE | {"fov": True}, "fov = True: expected a number"),
        (EYE | {"shift": [1]}, "shift = [1]: expected 2 numbers"),
        (EYE | {"target": [3, -4, 2]}, "are the same place"),
        (EYE | {"target": [3, -4, 0]}, "along the line from position to target; give another"),
        (EYE | {"position": [0, 10**400, 0]}, "expected a number"),
        ({"matrix": np.array(MATRIX).T.tolist(), "fov": 30, "aspect": 1}, "it is transposed"),
        ({"matrix": np.diag([1.0, 1, -1, 1]).tolist(), "fov": 30, "aspect": 1}, "mirrors"),
        ({"matrix": np.diag([1.0, 0, 1, 1]).tolist(), "fov": 30, "aspect": 1}, "expected lengths above 0"),
        ({"matrix": (np.eye(4) + np.eye(4, k=1) * [0, 0.1, 0, 0]).tolist(), "fov": 30, "aspect": 1}, "perpendicular"),
        ({"matrix": MATRIX[:3], "fov": 30, "aspect": 1}, "expected 4 rows of 4 numbers"),
        (EYE | {"up_axis": "x"}, "up_axis = 'x': expected"),
        ({"frames": {"one": EYE}}, "'one' is no number of a frame"),
        ({"frames": {"1": EYE, "1.0": EYE}}, "frame 1.0 is there twice"),
        ({"frames": {}}, "frames: is empty"),
        ({"frames": {"7": EYE | {"fov": 0}}}, "frame 7: fov = 0: expected"),
        ([EYE], "expected a table of keys"),
        ("[" * 100_000, "not a file of cameras"),
        ("{", "not a file of cameras"),
    ],
)
def test_what_is_no_camera_is_refused_in_one_line(tmp_path: Path, table: Any, line: str) -> None:
    with pytest.raises(InputError) as caught:
        one(tmp_path, table)
    message = str(caught.value)
    assert line in message and "shot.json" in message and "\n" not in message and len(message) <= 300


def test_files_of_other_kinds_say_what_to_do(tmp_path: Path) -> None:
    for name, line in (
        ("shot.abc", "export the camera as USD"),
        ("a.blend", "export_camera.py"),
        ("a.txt", "expected"),
    ):
        with pytest.raises(InputError, match=line):
            read_cameras(written(tmp_path, "x", name))
    with pytest.raises(InputError, match="have no names; leave out #main"):
        read_cameras(written(tmp_path, EYE) + "#main")
    with pytest.raises(InputError, match="no such file"):
        read_cameras(str(tmp_path / "none.json"))
    (tmp_path / "large.toml").write_bytes(b"#" * (1 << 21))
    with pytest.raises(InputError, match="expected a file of cameras of at most"):
        read_cameras(str(tmp_path / "large.toml"))


def test_a_name_follows_the_last_hash_of_what_is_no_file(tmp_path: Path) -> None:
    hashed = written(tmp_path, EYE, "shot#2.json")
    assert file_and_name(hashed) == (Path(hashed), None)
    assert file_and_name("shot.usd#/rig/main") == (Path("shot.usd"), "/rig/main")
    assert file_and_name("shot.usd") == (Path("shot.usd"), None)


def test_usd_without_its_library_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(InputError, match=r"pip install 'tnst_mi\[usd\]'"):
        read_cameras(written(tmp_path, "#usda 1.0\n", "shot.usda"))


def stage_of(path: Path, up: str, metres: float) -> Any:
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import UsdGeom

    stage = usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    return stage


@pytest.mark.parametrize("perspective", [True, False])
def test_usd_cameras_see_what_pixars_frustum_sees(tmp_path: Path, perspective: bool) -> None:
    """A camera with offsets on a moving, turned and scaled rig; between two samples, in centimetres."""
    stage = stage_of(tmp_path / "shot.usda", "Z", 0.01)
    from pxr import Gf, Usd, UsdGeom

    rig = UsdGeom.Xform.Define(stage, "/rig")
    move, turn = rig.AddTranslateOp(), rig.AddRotateXYZOp()
    for time in (10, 20):
        move.Set(Gf.Vec3d(30.0 * time, -500, 120), time)
        turn.Set(Gf.Vec3f(70, 2.0 * time, 15), time)
    rig.AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    prim = UsdGeom.Camera.Define(stage, "/rig/main")
    gf = Gf.Camera(
        projection=Gf.Camera.Perspective if perspective else Gf.Camera.Orthographic,
        horizontalAperture=36.0 if perspective else 4000.0,
        verticalAperture=20.25 if perspective else 2250.0,
        horizontalApertureOffset=4.0 if perspective else 300.0,
        verticalApertureOffset=-3.0 if perspective else -200.0,
        focalLength=35.0,
    )
    prim.SetFromCamera(gf, Usd.TimeCode.Default())
    stage.GetRootLayer().Save()
    cameras = read_cameras(str(tmp_path / "shot.usda"))
    camera = cameras.at(13, "z")
    evaluated = UsdGeom.Camera(stage.GetPrimAtPath("/rig/main")).GetCamera(13.0)
    # The rig's scale changes no picture; it would only turn up in Pixar's units of an orthographic camera.
    evaluated.transform = evaluated.transform.RemoveScaleShear()
    frustum = evaluated.frustum
    project = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    toward = np.array(frustum.ComputeViewDirection())
    for offset in np.random.default_rng(0).uniform(-60, 60, (8, 3)):
        point = np.array(frustum.position) + 300 * toward + offset
        x, y, _ = project.Transform(Gf.Vec3d(*point.tolist()))
        expected = np.array([x * camera.aspect, y]) / 2
        np.testing.assert_allclose(seen(camera, point * 0.01), expected, atol=1e-6)
    with pytest.raises(InputError, match="no camera for frame 21; it goes from 10 to 20, of which 20 is the nearest"):
        cameras.at(21, "z")


def test_one_of_several_usd_cameras_is_named(tmp_path: Path) -> None:
    path = tmp_path / "shot.usda"
    stage = stage_of(path, "Y", 1.0)
    from pxr import UsdGeom

    for name in ("/left", "/rig/right"):
        UsdGeom.Camera.Define(stage, name)
    stage.GetRootLayer().Save()
    with pytest.raises(InputError, match=r"has /left, /rig/right; name one: shot.usda#/left"):
        read_cameras(str(path))
    with pytest.raises(InputError, match=r"has no camera 'up', but has /left, /rig/right"):
        read_cameras(f"{path}#up")
    for name in ("right", "/rig/right"):
        camera = read_cameras(f"{path}#{name}").at(None, "y")
        assert camera.field == pytest.approx(math.degrees(2 * math.atan(15.2908 / 100)), abs=1e-4)
    assert read_cameras(f"{path}#left").at(1000, "y").perspective, "a camera that rests is there in all frames"


def test_a_damaged_stage_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    with pytest.raises(InputError) as caught:
        read_cameras(written(tmp_path, "#usda 1.0\ndef Camera {", "shot.usda"))
    assert "\n" not in str(caught.value) and "shot.usda" in str(caught.value)
