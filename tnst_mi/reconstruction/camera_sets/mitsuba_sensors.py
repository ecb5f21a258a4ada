"""The sensors of a Mitsuba scene file; the picture of each is beside the file and has its id as its name."""

from __future__ import annotations

import math
from pathlib import Path

import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.cameras.scene_camera import SceneCamera, rigid
from tnst_mi.machine.backend import activate
from tnst_mi.reconstruction.camera_sets.posed_view import CameraSet, PosedView

#: Mitsuba's sensors look along +z with x to the left, our cameras along −z with x to the right.
_AXES = np.diag([-1.0, 1.0, -1.0, 1.0])

_EXTENSIONS = (".exr", ".png", ".jpg")

#: How far the axes of an orthographic sensor may differ in length.
_EVEN = 1e-4


def read_sensors(path: Path) -> CameraSet:
    """Read a scene file, with all that it needs, for its sensors.

    Raises:
        InputError: it cannot be loaded, or a sensor is neither a pinhole nor an orthographic one, or has no picture.
    """
    activate()
    try:
        scene = mi.load_file(str(path))
    except Exception as error:  # Mitsuba's parser and plugins raise RuntimeError, TypeError, …, on many lines
        reason = str(error).strip().splitlines()
        raise InputError(f"{path}: cannot be read as a Mitsuba scene ({reason[0] if reason else error})") from None
    if not (sensors := scene.sensors()):
        raise InputError(f"{path}: the scene has no sensor, expected one for each view")
    views = [_view(sensor, path) for sensor in sensors]
    return CameraSet(path, "y", views, remarks=("its scene is taken with y up, as Mitsuba has it",))


def _view(sensor: mi.Sensor, path: Path) -> PosedView:
    name = sensor.id()
    image = next((found for e in _EXTENSIONS if (found := path.parent / f"{name}{e}").is_file()), None)
    if image is None:
        looked = ", ".join(f"{name}{extension}" for extension in _EXTENSIONS)
        raise InputError(f"{path}: sensor {name!r} has no picture, expected one of {looked} beside the file")
    camera = _camera(sensor, f"{path}: sensor {name!r}")
    return PosedView(name, image, lambda size: camera)


def _camera(sensor: mi.Sensor, where: str) -> SceneCamera:
    parameters, kind = mi.traverse(sensor), str(sensor).split("[")[0]
    width, height = (int(n) for n in sensor.film().size())
    if tuple(sensor.film().crop_size()) != (width, height):
        raise InputError(f"{where}: its film is cropped, expected a whole one; give the size of the picture instead")
    aspect = width / height
    if kind not in ("PerspectiveCamera", "OrthographicCamera"):
        raise InputError(f"{where}: is a {kind}, expected perspective or orthographic")
    to_world = np.array(parameters["to_world"].matrix, np.float64).reshape(4, 4) @ _AXES
    if kind == "PerspectiveCamera":
        slope = math.tan(math.radians(_value(parameters["x_fov"])) / 2) / aspect
        shift = (
            -_value(parameters["principal_point_offset_x"]) * aspect,
            _value(parameters["principal_point_offset_y"]),
        )
        return SceneCamera(rigid(to_world), True, 2 * math.degrees(math.atan(slope)), aspect, shift)
    across, down = (float(np.linalg.norm(to_world[:3, axis])) for axis in (0, 1))
    if abs(across - down) > _EVEN * across:
        raise InputError(f"{where}: is scaled by {across:g} across and {down:g} down, expected the same")
    # The picture is 2 wide before it is scaled.
    return SceneCamera(rigid(to_world), False, 2 * across / aspect, aspect)


def _value(parameter: object) -> float:
    return float(np.ravel(np.array(parameter, np.float64))[0])
